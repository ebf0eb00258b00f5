"""Fasteners and what is left where they are not: rivet heads and open holes of a scan, found together."""

from __future__ import annotations

from dataclasses import dataclass

from metrology.cloud import Reconstruction
from metrology.holes import Opening, find_openings
from metrology.results import RivetDetection
from metrology.rivets.ground import ground_of
from metrology.rivets.rivet_detection import detect_rivets
from metrology.rivets.settings import RivetSettings


@dataclass(frozen=True)
class Fasteners:
    """Heads, and holes without one."""

    rivets: list[RivetDetection]
    openings: list[Opening]


def detect_fasteners(reconstruction: Reconstruction, settings: RivetSettings | None = None) -> Fasteners:
    """Find the rivet heads and the open holes of a scan."""
    settings = settings or RivetSettings()
    ground = ground_of(reconstruction, settings)
    if ground is None:
        return Fasteners(detect_rivets(reconstruction, settings), [])
    openings = find_openings(reconstruction, ground.relief, ground.shapes, ground.pixels_per_mm, settings.max_sunk_mm)
    return Fasteners(detect_rivets(reconstruction, settings, ground, [o.ellipse for o in openings]), openings)
