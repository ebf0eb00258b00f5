"""Close-ups: what the stored cloud shows at one rivet, or across a seam at one station.

Drawn from the stored cloud (rounded to 1 µm) with the same fits as the inspection; the values that count are the stored
ones, and the pages show those.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import MISSING, PixelFlag
from metrology.surfaces import Frame, Polynomial, fit_surface
from storage.cloud import StoredCloud

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_INNER, _OUTER = 0.85, (1.1, 2.0)
_LEAST_OUTER_MM = 4.0
_GUARD_PX = 2.0
_FEWEST = 40
_STRIP_MM = 1.5
_SECTION_REACH_MM = 10.0
_SKIN_BAND_MM = 1.0


@dataclass(frozen=True)
class RivetCloseUp:
    """A head and the skin around it, flattened onto the skin's reference surface.

    Attributes
    ----------
    u, v : (n,) ndarray of int
        Pixels of the points.
    x, y : (n,) ndarray
        Along the skin from the head's centre, mm.
    deviation : (n,) ndarray
        Above the skin's quadric, mm.
    inner, outer : (n,) ndarray of bool
        Points that head and skin were fitted to.
    radius : float
        Of the head, mm.
    head : Polynomial
        The head's plane, over the skin's quadric.
    along : float
        Direction in which the head rises most, radians from x towards y.
    """

    u: NDArray[np.int64]
    v: NDArray[np.int64]
    x: Array
    y: Array
    deviation: Array
    inner: Mask
    outer: Mask
    radius: float
    head: Polynomial
    along: float

    def section(self, half_width: float) -> tuple[Array, Array, Mask, Mask]:
        """Points within `half_width` of the line through the centre along the steepest rise.

        Returns
        -------
        position, deviation : (m,) ndarray
            mm.
        inner, outer : (m,) ndarray of bool
        """
        c, s = np.cos(self.along), np.sin(self.along)
        across = -s * self.x + c * self.y
        near = np.abs(across) < half_width
        return (c * self.x + s * self.y)[near], self.deviation[near], self.inner[near], self.outer[near]


def rivet_close_up(cloud: StoredCloud, rivet: Any) -> RivetCloseUp | str:
    """The close-up of a row of `rivets`, or why there is none."""
    numbers = [rivet.x_mm, rivet.y_mm, rivet.z_mm, rivet.diameter_mm, rivet.u_px, rivet.v_px, rivet.major_px]
    if not all(_is_number(value) for value in numbers):
        return "the head has no position in space"
    x, y, z, diameter, u, v, major = (float(value) for value in numbers)
    if diameter <= 0 or major <= 0:
        return "the head has no size"
    radius = diameter / 2
    scale = major / diameter
    reach = max(_OUTER[1] * radius, radius + _LEAST_OUTER_MM)
    window = _window(cloud, u, v, reach * scale + 3)
    if window is None:
        return "the head lies outside the picture"
    rows, columns = window
    points = cloud.points[rows, columns].astype(float)
    centre = np.array([x, y, z])
    distance = np.linalg.norm(points - centre, axis=1)
    near = distance < reach * 1.3
    rows, columns, points, distance = rows[near], columns[near], points[near], distance[near]
    skin_ring = (distance > _OUTER[0] * radius) & (distance < reach)
    if skin_ring.sum() < _FEWEST:
        return f"{int(skin_ring.sum())} points on the skin around the head"
    usable = (cloud.flags[rows, columns] & np.uint16(MISSING | PixelFlag.EDGE)) == 0
    frame = _frame_on(points[skin_ring], centre)
    local = frame.local(points)
    r = np.hypot(local[:, 0], local[:, 1])
    guard = _GUARD_PX / scale
    inner = usable & (r < max(min(_INNER * radius, radius - guard), 0.5 * radius))
    outer = usable & (r > max(_OUTER[0] * radius, radius + guard)) & (r < reach)
    sigma = np.maximum(np.nan_to_num(cloud.sigma_z[rows, columns].astype(float), nan=1e-3), 1e-5)
    generator = np.random.default_rng(0)
    skin = _fit(local, sigma, outer, 2, generator)
    if skin is None:
        return f"{int(outer.sum())} usable points on the skin around the head"
    deviation = local[:, 2] - skin.height(local[:, 0], local[:, 1])
    head = _fit(np.column_stack([local[:, :2], deviation]), sigma, inner, 1, generator)
    if head is None:
        return f"{int(inner.sum())} usable points on the head"
    along = float(np.arctan2(head.coefficients[2], head.coefficients[1]))
    return RivetCloseUp(columns, rows, local[:, 0], local[:, 1], deviation, inner, outer, radius, head, along)


@dataclass(frozen=True)
class SeamSection:
    """A section across a seam in the frame of the paper's Fig. 8: x from side A to side B, h towards the rig.

    Attributes
    ----------
    x, h : (n,) ndarray
        Points near the section plane, mm; the origin is the middle between the ideal edges.
    used : (n,) ndarray of bool
        Points that the skin lines were fitted to.
    line_a, line_b : (3,) ndarray
        L1 and L2: h = c0 + c1 x + c2 x², mm.
    edge_a, edge_b : (x, h) or None
        Ideal edges D′ and G′, on the lines.
    lip_a, lip_b : (x, h) or None
        D and G: the last measured point at each edge.
    """

    x: Array
    h: Array
    used: Mask
    line_a: Array
    line_b: Array
    edge_a: tuple[float, float] | None
    edge_b: tuple[float, float] | None
    lip_a: tuple[float, float] | None
    lip_b: tuple[float, float] | None


def seam_section(cloud: StoredCloud, station: Any, neighbours: Array) -> SeamSection | str:
    """The section at a row of `seam_stations`, or why there is none.

    Parameters
    ----------
    neighbours : (n, 3) ndarray
        Midpoints of the seam's stations near this one, itself among them, in the order of s; they give its direction.
    """
    from metrology.seams.sections import fit_skin_lines

    numbers = [station.x_mm, station.y_mm, station.z_mm, station.u_px, station.v_px]
    if not all(_is_number(value) for value in numbers):
        return "the station has no position in space"
    centre, (u, v) = np.array([float(value) for value in numbers[:3]]), (float(value) for value in numbers[3:])
    neighbours = neighbours[np.isfinite(neighbours).all(axis=1)]
    if len(neighbours) < 2:
        return "the seam has too few stations to tell its direction"
    direction = neighbours[-1] - neighbours[0]
    scale = _pixels_per_mm(cloud, u, v)
    window = _window(cloud, u, v, 1.2 * _SECTION_REACH_MM * scale) if scale else None
    if window is None:
        return "there are no points around the station"
    rows, columns = window
    points = cloud.points[rows, columns].astype(float)
    if len(points) < _FEWEST:
        return f"{len(points)} points around the station"
    frame = _across(_frame_on(points, centre), direction)
    local = frame.local(points)
    near = (np.abs(local[:, 1]) < _STRIP_MM) & (np.abs(local[:, 0]) < _SECTION_REACH_MM)
    local, rows, columns = local[near], rows[near], columns[near]
    usable = (cloud.flags[rows, columns] & np.uint16(MISSING | PixelFlag.EDGE)) == 0
    half = float(station.width_mm) / 2 if _is_number(station.width_mm) else 0.5
    inner = half + 0.8
    sigma = np.maximum(np.nan_to_num(cloud.sigma_z[rows, columns].astype(float), nan=1e-3), 1e-5)
    fitted = fit_skin_lines(np.column_stack([local, sigma])[usable], -inner, inner, _SKIN_BAND_MM)
    if fitted is None:
        across = local[usable, 0]
        left, right = (int(((side > inner) & (side < inner + _SKIN_BAND_MM)).sum()) for side in (-across, across))
        return f"{left} usable points on side A and {right} on side B"
    c = np.asarray(fitted[0], float)
    line_a, line_b = np.array([c[0], c[1], c[4]]), np.array([c[2], c[3], c[4]])
    x, h = local[:, 0], local[:, 1] * 0 + local[:, 2]
    known = _is_number(station.width_mm)
    return SeamSection(
        x=x,
        h=h,
        used=usable & (np.abs(x) > inner),
        line_a=line_a,
        line_b=line_b,
        edge_a=(-half, float(np.polyval(line_a[::-1], -half))) if known else None,
        edge_b=(half, float(np.polyval(line_b[::-1], half))) if known else None,
        lip_a=_lip(x, h, -half, line_a) if known else None,
        lip_b=_lip(x, h, half, line_b) if known else None,
    )


def _lip(x: Array, h: Array, edge: float, line: Array) -> tuple[float, float] | None:
    """The measured point next to an ideal edge, outside the gap and near its skin line."""
    outside = np.abs(x) >= abs(edge) - 0.05
    close = outside & (np.sign(x) == np.sign(edge)) & (np.abs(h - np.polyval(line[::-1], x)) < _SKIN_BAND_MM)
    if not close.any():
        return None
    nearest = int(np.flatnonzero(close)[np.abs(x[close] - edge).argmin()])
    return (float(x[nearest]), float(h[nearest])) if abs(x[nearest] - edge) < 1.0 else None


def _window(cloud: StoredCloud, u: float, v: float, reach: float) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Rows and columns of the points within `reach` pixels of (u, v) in both directions."""
    height, width = cloud.flags.shape
    reach = min(reach, max(height, width))
    v0, v1 = max(0, int(v - reach)), min(height, int(v + reach) + 2)
    u0, u1 = max(0, int(u - reach)), min(width, int(u + reach) + 2)
    if v0 >= v1 or u0 >= u1:
        return None
    rows, columns = np.nonzero(np.isfinite(cloud.points[v0:v1, u0:u1, 2]))
    return (rows + v0, columns + u0) if rows.size else None


def _pixels_per_mm(cloud: StoredCloud, u: float, v: float) -> float | None:
    """Scale of the picture around a place, from the cloud itself."""
    window = _window(cloud, u, v, 40)
    if window is None:
        return None
    rows, columns = window
    points = cloud.points[rows, columns].astype(float)
    spread_mm = np.hypot(points[:, 0].std(), points[:, 1].std())
    spread_px = np.hypot(rows.std(), columns.std())
    return float(spread_px / spread_mm) if spread_mm > 0 else None


def _frame_on(points: Array, origin: Array) -> Frame:
    """Frame on the plane that most points share, with the given origin."""
    keep = np.ones(len(points), bool)
    normal = np.array([0.0, 0.0, -1.0])
    for _ in range(4):
        middle = points[keep].mean(axis=0)
        normal = np.linalg.svd(points[keep] - middle, full_matrices=False)[2][2]
        off = np.abs((points - middle) @ normal)
        keep = off < 3 * 1.4826 * np.median(off) + 1e-9
    return Frame.on_plane(origin, normal)


def _across(frame: Frame, direction: Array) -> Frame:
    """The frame turned so that y runs along the seam and x from side A to side B (smaller u or v to larger)."""
    along = direction - (direction @ frame.axes[2]) * frame.axes[2]
    along = along / np.linalg.norm(along)
    across = np.cross(along, frame.axes[2])
    if (across[0] if abs(across[0]) > abs(across[1]) else across[1]) < 0:
        along, across = -along, -across
    return Frame(frame.origin, np.stack([across, along, frame.axes[2]]))


def _fit(local: Array, sigma: Array, members: Mask, order: Any, generator: np.random.Generator) -> Polynomial | None:
    if members.sum() < _FEWEST:
        return None
    x, y, h = local[members].T
    return fit_surface(x, y, h, sigma[members], order, generator)


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float, np.number)) and bool(np.isfinite(float(value)))
