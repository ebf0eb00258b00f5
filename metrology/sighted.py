"""What is known of a scan when the rivets and seams in it are measured: what a further kind of feature starts from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from metrology.cloud import Reconstruction
from metrology.holes.find import Opening
from metrology.results import Features, RivetDetection, SeamLine


@dataclass(frozen=True)
class Sighted:
    """A scan with what was found in it so far."""

    reconstruction: Reconstruction
    detections: Sequence[RivetDetection]
    lines: Sequence[SeamLine]
    features: Features
    """What was measured already, by kind."""
    openings: Sequence[Opening] = ()
    """Circles of the skin inside which nothing lies at its height."""
