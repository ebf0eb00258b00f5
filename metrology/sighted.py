"""What is known of a scan when the rivets and seams in it are measured: what a further kind of feature starts from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from metrology.cloud import Reconstruction
from metrology.results import Features, RivetDetection, SeamLine


@dataclass(frozen=True)
class Sighted:
    """A scan with what was found in it so far.

    Attributes
    ----------
    reconstruction : Reconstruction
    detections : sequence of RivetDetection
    lines : sequence of SeamLine
    features : mapping
        What was measured already, by kind.
    """

    reconstruction: Reconstruction
    detections: Sequence[RivetDetection]
    lines: Sequence[SeamLine]
    features: Features
