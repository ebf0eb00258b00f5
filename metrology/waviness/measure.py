"""Waviness of each piece of skin, along and across: the greatest gap under a straight-edge slid over it.

The skin's own curvature, a paraboloid, is left out, so that the edge lies as it would on a template of the skin. What
defects, fasteners and seams cover is left out as well; heads are bridged. A wave of 40 mm is measured whole, one of
25 mm to 94 %, and shorter ones less: they are defects.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array, Mask
from metrology.defects.cells import SIZE, CellMap, cell_map
from metrology.defects.reference import Reference, fit_contour
from metrology.defects.row import Defect
from metrology.results import COVERAGE_95, of_type
from metrology.robust import MAD, median
from metrology.sighted import Sighted
from metrology.waviness.row import Direction, Waviness, WavinessSettings
from metrology.waviness.sliding import sliding_gap

_STEP_MM = 2.0  # of the map of heights
_SMOOTH_MM = 3.0
_TWICED = 1.5  # times the noise of a Gaussian's mean has one with what it left out added
_KNOWN = 0.3  # of a Gaussian's weight
_MISSING = 0.4  # share of an edge's points that may be unknown
_GREATEST = 3.5  # standard deviations of a height: by about twice that noise lifts the greatest gap of a smooth skin
_FOOT = 2.2  # times its outline at half depth is what a defect covers
_FLAT = 2e-5  # 1/mm between the curvatures: nothing tells them apart


@dataclass(frozen=True)
class _Heights:
    """Heights over a plate's contour on a grid whose rows lie along.

    `corner` is the place of its first cell, `turn` the direction of its rows in the contour's frame.
    """

    values: Array
    corner: Array
    turn: float
    sd: float


def measure_waviness(sighted: Sighted, settings: WavinessSettings | None = None) -> list[Waviness]:
    """Two rows for each piece of skin."""
    settings = settings or WavinessSettings()
    cells = cell_map(sighted)
    bare = cells.free & ~_of_defects(of_type(sighted.features, Defect), cells.free.shape)
    rows = []
    for plate in cells.plates:
        use = np.flatnonzero((cells.plate == plate) & bare)
        contour = fit_contour(*cells.chosen(use))
        if contour is not None:
            heights = _heights(cells, use, contour)
            rows += [_row(plate, way, heights, contour, sighted, settings) for way in ("along", "across")]
    return rows


def _of_defects(defects: list[Defect], shape: tuple[int, ...]) -> Mask:
    """Cells that defects cover."""
    mask = np.zeros(shape, np.uint8)
    for defect in defects:
        if defect.major_px is None or defect.minor_px is None:
            continue
        size = _FOOT * defect.major_px / SIZE, _FOOT * defect.minor_px / SIZE
        cv2.ellipse(mask, ((defect.u_px / SIZE, defect.v_px / SIZE), size, defect.direction_deg or 0.0), 1, -1)
    return mask > 0


def _heights(cells: CellMap, use: NDArray[np.int64], contour: Reference) -> _Heights:
    x, y, h = contour.frame.local(cells.points.reshape(-1, 3)[use]).T
    turn = _straightest(contour)
    c, s = np.cos(turn), np.sin(turn)
    place = np.stack([c * x + s * y, c * y - s * x], axis=1)
    corner = place.min(axis=0)
    columns, rows = np.ptp(place, axis=0) // _STEP_MM + 1
    column, row = ((place - corner) / _STEP_MM).astype(int).T
    at, size = row * int(columns) + column, int(rows * columns)
    above = h - contour.height(np.ascontiguousarray(x), np.ascontiguousarray(y))
    shape = int(rows), int(columns)
    total = np.bincount(at, above, size).reshape(shape).astype(float)
    number = np.bincount(at, minlength=size).reshape(shape).astype(float)
    values, weight = _smoothed(total, number)
    # What smoothing has left out is smoothed and added: a wave of 40 mm keeps 99 % of its height.
    values += _smoothed(total - number * values, number)[0]
    known = weight > _KNOWN * len(at) / size
    seen = number > 0
    noise = MAD * median(np.abs((total - number * values)[seen]) / np.sqrt(number[seen]))
    cells_together = 4 * np.pi * (_SMOOTH_MM / _STEP_MM) ** 2 * len(at) / size
    return _Heights(np.where(known, values, np.nan), corner, turn, float(_TWICED * noise / np.sqrt(cells_together)))


def _smoothed(total: Array, number: Array) -> tuple[Array, Array]:
    """Gaussian means of totals over numbers, and the numbers smoothed."""
    sums, weight = (np.asarray(cv2.GaussianBlur(a, (0, 0), _SMOOTH_MM / _STEP_MM), float) for a in (total, number))
    return sums / np.maximum(weight, 1e-9), weight


def _straightest(contour: Reference) -> float:
    """Direction of least curvature; across the picture where there is none."""
    c, (ex, ey), e = contour.coefficients, contour.extents, contour.extent
    bend = e * np.array([[2 * c[3] / ex**2, c[4] / (ex * ey)], [c[4] / (ex * ey), 2 * c[5] / ey**2]])
    curvature, ways = np.linalg.eigh(bend)
    if abs(abs(curvature[1]) - abs(curvature[0])) < _FLAT:
        return 0.0
    x, y = ways[:, int(np.abs(curvature).argmin())]
    return float(np.arctan2(y, x))


def _row(
    plate: int, way: Direction, heights: _Heights, contour: Reference, sighted: Sighted, settings: WavinessSettings
) -> Waviness:
    edge = settings.straight_edge_mm
    window = round(edge / _STEP_MM) + 1
    values = heights.values if way == "along" else heights.values.T
    gap, row, column = sliding_gap(np.ascontiguousarray(values), window, _MISSING)
    middle = 0.5 * (np.array(heights.values.shape) - 1)
    at = middle if np.isnan(gap) else np.array([row, column] if way == "along" else [column, row], float)
    place = heights.corner + _STEP_MM * (at[::-1] + 0.5)
    c, s = np.cos(heights.turn), np.sin(heights.turn)
    x, y = (np.array([v]) for v in (c * place[0] - s * place[1], s * place[0] + c * place[1]))
    point = contour.frame.rig([float(x[0]), float(y[0]), float(contour.height(x, y)[0])])
    u, v = sighted.reconstruction.rig.left.project(point)
    found = Waviness(
        f"W{plate}-{way}", x_mm=float(point[0]), y_mm=float(point[1]), z_mm=float(point[2]), u_px=float(u),
        v_px=float(v), direction=way, edge_mm=edge,
    )  # fmt: skip
    if np.isnan(gap):
        reason = f"nowhere is the skin in view long enough for a straight-edge of {edge:g} mm"
        return replace(found, decision="not measured", reason=reason)
    # The greatest of many gaps is what noise has made greatest.
    sd = np.hypot(heights.sd, _GREATEST * heights.sd)
    return replace(found, waviness_mm=float(gap), waviness_u95_mm=COVERAGE_95 * float(sd))
