"""Fasteners and what is left where they are not: rivet heads and holes of a scan, found together."""

from __future__ import annotations

import math
from dataclasses import dataclass

from metrology.cloud import Reconstruction
from metrology.holes import Opening, find_openings
from metrology.holes.filled import filled_openings
from metrology.results import RivetDetection
from metrology.rivets.ground import ground_of
from metrology.rivets.patch import ellipse_of
from metrology.rivets.rivet_detection import detect_rivets
from metrology.rivets.settings import RivetSettings


@dataclass(frozen=True)
class Fasteners:
    """Heads, and holes without one."""

    rivets: list[RivetDetection]
    openings: list[Opening]


def detect_fasteners(reconstruction: Reconstruction, settings: RivetSettings | None = None) -> Fasteners:
    """Find the rivet heads and the holes of a scan, open and filled."""
    settings = settings or RivetSettings()
    ground = ground_of(reconstruction, settings)
    if ground is None:
        return Fasteners(detect_rivets(reconstruction, settings), [])
    openings = find_openings(reconstruction, ground.relief, ground.shapes, ground.pixels_per_mm, settings.max_sunk_mm)
    rivets = detect_rivets(reconstruction, settings, ground, [o.ellipse for o in openings])
    # A hole in the middle of a head is its recess.
    openings = [o for o in openings if not any(_lies_in(o, head) for head in rivets)]
    taken = [*(o.ellipse for o in openings), *map(ellipse_of, rivets)]
    openings += filled_openings(reconstruction, ground.discs, taken)
    return Fasteners(rivets, sorted(openings, key=lambda o: (o.ellipse.v, o.ellipse.u)))


def _lies_in(opening: Opening, head: RivetDetection) -> bool:
    away = math.hypot(opening.ellipse.u - head.u_px, opening.ellipse.v - head.v_px)
    return away < 0.5 * head.minor_px
