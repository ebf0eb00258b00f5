"""What two overlapping scans share under a placement of one to the other: heads, skin and seams."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array, Ints
from metrology.assembly.scan import STRIDE, PanelScan
from metrology.panel import Placement, foot_on
from metrology.registration.rows import positions
from metrology.registration.search import alike
from metrology.results import SeamStation

HEAD_REACH_MM = 1.0
"""Heads farther apart than this under a placement are different ones."""
DIAMETER_RATIO = 1.1  # half the least step between standard sizes
_SKIN_REACH_MM = 3.0
_CELL_MM = 15.0
_SPARSER = 3  # samples of the thinned cloud from one looked-up point to the next
_FEWEST_IN_CELL = 8
_COURSE_REACH_MM = 3.0
_ALONG_MM = 1.5  # seam positions of two scans this near along the seam are compared


@dataclass(frozen=True)
class SkinTies:
    """Cells of the shared skin: a place on each scan (k, 3), and the normal (k, 3) of the first one, rig frames."""

    first: Array
    second: Array
    normal: Array
    sigma: Array

    def __len__(self) -> int:
        return len(self.first)


NO_SKIN = SkinTies(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3)), np.empty(0))


@dataclass(frozen=True)
class SeamTies:
    """Seam positions of the second scan beside the first one's course, rig frames."""

    first: Array
    second: Array
    """first, second: (k, 3): the foot on the first scan's course, and the position."""
    tangent: Array
    """(k, 3): of the first scan's course."""
    steps: Array
    """(k, 2): step of the first and the second, on the same sides, mm; NaN where not measured."""
    step_u95: Array
    """(k, 2)."""
    seams: tuple[tuple[str, str], ...] = ()
    """Names of the seams that belong together."""

    def __len__(self) -> int:
        return len(self.first)


NO_SEAM = SeamTies(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 2)), np.empty((0, 2)))


def head_partners(first: PanelScan, second: PanelScan, placement: Placement, reach_mm: float = HEAD_REACH_MM) -> Ints:
    """(m, 2) indices of heads that are each other's nearest within reach and of a size.

    Parameters
    ----------
    placement : Placement
        From the second scan's rig frame to the first one's.
    """
    a, b = first.pattern, second.pattern
    if len(a) == 0 or len(b) == 0:
        return np.empty((0, 2), np.intp)
    distance = np.linalg.norm(a.positions[:, None] - placement.to_panel(b.positions), axis=2)
    distance[~alike(a.diameters[:, None], b.diameters, DIAMETER_RATIO)] = np.inf
    to_b, to_a = distance.argmin(1), distance.argmin(0)
    rows = np.arange(len(a))
    mutual = (to_a[to_b] == rows) & (distance[rows, to_b] <= reach_mm)
    return np.column_stack([rows[mutual], to_b[mutual]])


def heads_expected(
    first: PanelScan, second: PanelScan, placement: Placement
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which heads of the first scan lie in the second one's field, and the other way round."""
    radius = [np.nan_to_num(scan.pattern.diameters) for scan in (first, second)]
    in_second = second.sees(placement.to_rig(first.pattern.positions), radius[0])
    in_first = first.sees(placement.to_panel(second.pattern.positions), radius[1])
    return in_second, in_first


def skin_ties(first: PanelScan, second: PanelScan, placement: Placement) -> SkinTies:
    """Cells of the shared skin: points of the second scan looked up in the first one's image grid, median by cell.

    Looking up by projection needs no search for neighbours, and finds nothing behind an edge.
    """
    points = second.skin.points[::_SPARSER, ::_SPARSER].reshape(-1, 3).astype(float)
    points = points[np.isfinite(points[:, 2])]
    at = placement.to_panel(points)
    pixels = first.rig.left.project(at)
    inside = (at[:, 2] > 0) & first.rig.left.inside(pixels)
    points, at, pixels = points[inside], at[inside], pixels[inside]
    gap = first.skin.under(pixels) - at[:, 2]
    near = np.abs(gap) < _SKIN_REACH_MM
    points, at, pixels, gap = points[near], at[near], pixels[near], gap[near]
    if len(points) == 0:
        return NO_SKIN
    normals = first.skin.normals
    rows, columns = np.clip((pixels[:, ::-1] / STRIDE).round().astype(int), 0, np.array(normals.shape[:2]) - 1).T
    return _cells(points, at, gap, normals[rows, columns].astype(float))


def _cells(points: Array, at: Array, gap: Array, normals: Array) -> SkinTies:
    """One tie for each cell of the field: where the gap has its median."""
    column, row = np.floor(at[:, :2] / _CELL_MM).astype(np.int64).T
    _, label = np.unique(column * 1_000_003 + row, return_inverse=True)
    order = np.lexsort((gap, label))
    label, gap = label[order], gap[order]
    start = np.flatnonzero(np.diff(label, prepend=-1))
    count = np.diff(start, append=len(label))
    known = np.isfinite(normals[order, 0])
    normal = np.add.reduceat(np.where(known[:, None], normals[order], 0.0), start)
    kept = (count >= _FEWEST_IN_CELL) & (np.linalg.norm(normal, axis=1) > 0)
    start, count, normal = start[kept], count[kept], normal[kept]
    median = gap[start + count // 2]
    spread = (gap[start + 3 * count // 4] - gap[start + count // 4]) / 1.349
    middle = order[start + count // 2]
    depth = at[middle, 2:]
    return SkinTies(
        at[middle] * (1 + median[:, None] / depth),
        points[middle],
        normal / np.linalg.norm(normal, axis=1, keepdims=True),
        spread * np.sqrt(np.pi / 2 / count),
    )


def seam_ties(first: PanelScan, second: PanelScan, placement: Placement) -> SeamTies:
    """Positions of the second scan's seams beside the first one's, where both run together."""
    parts: list[tuple[Array, ...]] = []
    named: list[tuple[str, str]] = []
    for one, rows in first.seams.items():
        course = positions(rows)
        for other, others in second.seams.items():
            part = _beside(first, second, rows, others, course, placement)
            if part is not None:
                parts.append(part)
                named.append((one, other))
    if not parts:
        return NO_SEAM
    first_places, seconds, tangents, steps, u95 = (np.concatenate(column) for column in zip(*parts, strict=True))
    return SeamTies(first_places, seconds, tangents, steps, u95, tuple(named))


def _beside(
    first: PanelScan, second: PanelScan, rows: list[SeamStation], others: list[SeamStation], course: Array,
    placement: Placement,
) -> tuple[Array, ...] | None:  # fmt: skip
    at = placement.to_panel(positions(others))
    foot = foot_on(course, at)
    within = (foot.s > 0) & (foot.s < np.linalg.norm(np.diff(course, axis=0), axis=1).sum())
    if within.sum() < 3 or np.median(foot.distance[within]) > _COURSE_REACH_MM:
        return None
    arc = foot_on(course, course).s
    nearest = np.abs(foot.s[:, None] - arc).argmin(1)
    within &= np.abs(arc[nearest] - foot.s) < _ALONG_MM
    sign = 1.0 if _same_sides(first, second, rows, others, nearest, within, placement) else -1.0
    steps = np.array([(rows[n].step_mm, other.step_mm) for n, other in zip(nearest, others, strict=True)], float)
    u95 = np.array([(rows[n].step_u95_mm, o.step_u95_mm) for n, o in zip(nearest, others, strict=True)], float)
    steps = np.column_stack([_along(rows, arc, foot.s), sign * steps[:, 1]])
    seconds = positions(others)
    return (at - foot.offset)[within], seconds[within], foot.tangent[within], steps[within], u95[within]


def _along(rows: list[SeamStation], arc: Array, s: Array) -> Array:
    """(n,) steps at arc lengths s, between the positions that were measured."""
    steps = np.array([row.step_mm for row in rows], float)
    known = np.isfinite(steps)
    return np.interp(s, arc[known], steps[known]) if known.any() else np.full(len(s), np.nan)


def _same_sides(
    first: PanelScan, second: PanelScan, rows: list[SeamStation], others: list[SeamStation], nearest: Ints,
    within: NDArray[np.bool_], placement: Placement,
) -> bool:  # fmt: skip
    """Whether both scans call the same side A."""
    agreement = 0.0
    for k in np.flatnonzero(within):
        row, other = rows[nearest[k]], others[k]
        one = first.across.get((row.seam_id, row.s_mm))
        two = second.across.get((other.seam_id, other.s_mm))
        if one is not None and two is not None:
            agreement += float(one @ placement.R @ two)
    return agreement >= 0
