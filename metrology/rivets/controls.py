"""Control places: bare skin near the rivets on which measuring must find nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from metrology.results import RivetDetection

_TRIALS = 12  # places tried per rivet
_MOST_BLOCKED = 0.02  # of a control's disc


def control_places(
    detections: Sequence[RivetDetection],
    blocked: NDArray[np.bool_],
    wanted: int,
    generator: np.random.Generator,
) -> list[RivetDetection]:
    """Copies of the detections moved onto bare skin, one to one and a half diameters from a rivet.

    Parameters
    ----------
    blocked : (h, w) bool
        Pixels without a trustworthy point.
    wanted : int
        At most this many.
    """
    places: list[RivetDetection] = []
    if not detections:
        return places
    for k in range(_TRIALS * max(wanted, 1)):
        if len(places) >= wanted:
            break
        model = detections[k % len(detections)]
        distance, direction = generator.uniform(1.0, 1.5) * model.major_px, generator.uniform(0, 2 * np.pi)
        moved = replace(
            model, u_px=model.u_px + distance * np.cos(direction), v_px=model.v_px + distance * np.sin(direction)
        )
        if _is_bare(moved, [*detections, *places], blocked):
            places.append(moved)
    return places


def _is_bare(place: RivetDetection, others: Sequence[RivetDetection], blocked: NDArray[np.bool_]) -> bool:
    radius = place.major_px / 2
    height, width = blocked.shape
    u, v = round(place.u_px), round(place.v_px)
    reach = int(radius) + 1
    if u < reach or v < reach or u >= width - reach or v >= height - reach:
        return False
    if any(np.hypot(place.u_px - o.u_px, place.v_px - o.v_px) < 1.1 * (radius + o.major_px / 2) for o in others):
        return False
    return bool(blocked[v - reach : v + reach + 1, u - reach : u + reach + 1].mean() < _MOST_BLOCKED)
