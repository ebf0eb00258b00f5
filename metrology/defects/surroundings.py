"""What lies round a defect: fasteners, whose own pull-in is no dent, and seams."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrology.arrays import Array
from metrology.defects.cells import SIZE
from metrology.defects.outline import Outline
from metrology.defects.patch import Patch
from metrology.defects.skin_map import SkinMap
from metrology.registration.rows import has_position, positions
from metrology.results import Feature, Rivet, SeamStation
from metrology.surfaces import Frame

_RING = (1.3, 2.0)  # radii of a head between which the skin shows its pull-in
_SAME_MIDDLE = 0.6  # head diameters between the middles of a fastener and of the dent that it has made itself
_OWN_SIZE = 3.5  # head diameters that such a dent is at most wide at half depth
_USUAL = 2.0  # times what is usual on the scan stands out


@dataclass(frozen=True)
class Distances:
    """From a defect's outline at half depth to the nearest rim and seam edge, mm; None without."""

    fastener: float | None
    seam: float | None


def distances(outline: Outline, frame: Frame, rivets: Sequence[Rivet], stations: Sequence[SeamStation]) -> Distances:
    """Distances along the tangent plane; 0 where an outline reaches them."""
    border = np.stack([outline.x, outline.y], axis=1)
    heads = [rivet for rivet in rivets if has_position(rivet) and rivet.diameter_mm is not None]
    seams = [station for station in stations if has_position(station)]
    rims = _from_border(border, frame, heads, [0.5 * (head.diameter_mm or 0.0) for head in heads])
    edges = _from_border(border, frame, seams, [0.5 * (station.width_mm or 0.0) for station in seams])
    if any(_encloses(border, middle) for middle in frame.local(positions(heads))[:, :2]):
        rims = np.zeros(1)
    return Distances(*(float(max(away.min(), 0.0)) if len(away) else None for away in (rims, edges)))


def _from_border(border: Array, frame: Frame, rows: Sequence[Feature], radii: Sequence[float]) -> Array:
    """(n,) distances of features of given radii from a curve in the tangent plane, mm."""
    middles = frame.local(positions(rows))[:, :2]
    away = np.hypot(middles[:, :1] - border[:, 0], middles[:, 1:] - border[:, 1])
    return np.asarray(away.min(axis=1, initial=np.inf) - radii)


def _encloses(border: Array, point: Array) -> bool:
    """Whether a closed curve goes round a point."""
    turn = np.unwrap(np.arctan2(*(border - point).T[::-1]))
    last = np.angle(np.exp(1j * (turn[0] - turn[-1])))
    return bool(abs(turn[-1] + last - turn[0]) > np.pi)


def pull_in(skin: SkinMap, rivets: Sequence[Rivet]) -> dict[str, float]:
    """How deep the skin lies round each fastener, mm, by its id."""
    found = {}
    rows, columns = skin.depth.shape
    for rivet in rivets:
        outer = _RING[1] * 0.5 * rivet.major_px / SIZE
        v, u = rivet.v_px / SIZE, rivet.u_px / SIZE
        top, left = max(0, int(v - outer)), max(0, int(u - outer))
        window = np.s_[top : min(rows, int(v + outer) + 2), left : min(columns, int(u + outer) + 2)]
        vv, uu = np.mgrid[window]
        away = np.hypot(vv - v, uu - u) / (0.5 * rivet.major_px / SIZE)
        ring = (away > _RING[0]) & (away < _RING[1]) & skin.cells.free[window] & np.isfinite(skin.depth[window])
        if ring.sum() >= 5:
            found[rivet.rivet_id] = float(np.median(skin.depth[window][ring]))
    return found


def is_pull_in(
    outline: Outline, depth: float, patch: Patch, rivets: Sequence[Rivet], usual: dict[str, float], most_mm: float
) -> bool:
    """Whether a dent is what a fastener's own clamping has made, and no deeper than is usual.

    Parameters
    ----------
    outline : Outline
        At half depth.
    depth : float
        mm, positive below.
    usual : mapping
        How deep the skin lies round each fastener of the scan.
    most_mm : float
        What no fastener may draw the skin in without its being a dent.
    """
    middle = np.array([outline.x.mean(), outline.y.mean()])
    for rivet in rivets:
        if not has_position(rivet) or rivet.diameter_mm is None:
            continue
        centre = patch.frame.local(positions([rivet]))[0, :2]
        concentric = np.linalg.norm(centre - middle) < _SAME_MIDDLE * rivet.diameter_mm
        if concentric and outline.length < _OWN_SIZE * rivet.diameter_mm:
            others = [value for name, value in usual.items() if name != rivet.rivet_id]
            typical = _USUAL * abs(float(np.median(others))) if others else 0.0
            return abs(depth) <= max(most_mm, typical)
    return False
