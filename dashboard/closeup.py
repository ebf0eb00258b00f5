"""Close-ups: what a rivet's height, or a seam station's step and width, was measured on.

The surfaces and lines are those that the inspection kept with its run, and its points are those of the stored cloud
(rounded to 1 µm). Nothing is fitted here: with the kept fit and the inspection's own functions the value must come out
as the table has it; where it does not, nothing is drawn.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dashboard.palette import quantity_words
from dashboard.words import N_, _
from metrology.arrays import Array, Mask
from metrology.cloud import MISSING, PixelFlag
from metrology.fits import HeadFit, SectionFit
from metrology.surfaces import monomials, tangent_rows
from storage.cloud import StoredCloud

Place = tuple[float, float]

_AIR = 1.15  # of what is drawn beyond the points that were used
_FEWEST = 40
# Tables are rounded to 0.01 µm; what differs by more was not computed like this.
_SAME_MM = 2e-5
_SKIN_BAND_MM = 3.0
NOT_KEPT = N_(
    "this run kept no fit of it (it is of an older version, or was not measured); inspect the scan again to see one"
)


@dataclass(frozen=True)
class RivetCloseUp:
    """A head and the skin around it, flattened onto the skin's reference surface."""

    u: NDArray[np.int64]
    v: NDArray[np.int64]
    """u, v: (n,) of int: pixels of the points."""
    x: Array
    y: Array
    """x, y: (n,): along the skin from the head's centre, mm."""
    deviation: Array
    """(n,): above the skin's surface as fitted, mm."""
    inner: Mask
    outer: Mask
    """inner, outer: (n,) of bool: points where those of head and skin were taken from."""
    fit: HeadFit
    height: float
    """Of the head as the fit gives it, mm."""
    along: float
    """Direction in which the head rises most, radians from x towards y."""

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

    def head(self, position: Array) -> Array:
        """(n,) the head's surface above the skin's at places along that line, mm."""
        x = self.fit.x + position * np.cos(self.along)
        y = self.fit.y + position * np.sin(self.along)
        return _height(self.fit.head, x, y) - _height(self.fit.skin, x, y)


def rivet_close_up(cloud: StoredCloud, rivet: Any, fit: HeadFit | None) -> RivetCloseUp | str:
    """The close-up of a row of `rivets` from the fit that its run kept, or why there is none."""
    from metrology.rivets.flushness import mean_height

    numbers = [rivet.u_px, rivet.v_px, rivet.major_px, rivet.height_mean_mm]
    if fit is None:
        return _(NOT_KEPT)
    if not all(_is_number(value) for value in numbers):
        return _("the head was not measured")
    u, v, major, stored = (float(value) for value in numbers)
    height = mean_height(fit.head, fit.skin, fit.x, fit.y, fit.radius)
    if abs(height - stored) > _SAME_MM:
        return _differs("height", height, stored)
    reach = _AIR * fit.outer_mm[1]
    window = _window(cloud, u, v, reach * major / (2 * fit.radius) + 3)
    if window is None:
        return _("the head lies outside the picture")
    rows, columns = window
    local = fit.frame.local(cloud.points[rows, columns])
    near = (np.hypot(local[:, 0], local[:, 1]) < reach) & (np.abs(local[:, 2]) < _SKIN_BAND_MM)
    rows, columns, (x, y, h) = rows[near], columns[near], local[near].T
    if len(x) < _FEWEST:
        return _("the stored cloud has {n} points there", n=len(x))
    usable = _usable(cloud, rows, columns)
    r = np.hypot(x, y)
    slopes = [tangent_rows(fit.x, fit.y, _order(c))[1:] @ c for c in (fit.head, fit.skin)]
    rise = slopes[0] - slopes[1]
    return RivetCloseUp(
        u=columns,
        v=rows,
        x=x - fit.x,
        y=y - fit.y,
        deviation=h - _height(fit.skin, x, y),
        inner=usable & (r < fit.inner_mm),
        outer=usable & (r > fit.outer_mm[0]) & (r < fit.outer_mm[1]),
        fit=fit,
        height=height,
        along=float(np.arctan2(rise[1], rise[0])),
    )


@dataclass(frozen=True)
class SeamSection:
    """A section across a seam in the frame of the paper's Fig. 8: x from side A to side B, h towards the rig."""

    x: Array
    h: Array
    """x, h: (n,): points near the section plane, mm."""
    used: Mask
    """(n,) of bool: points where those of the skin lines were taken from."""
    line_a: Array
    line_b: Array
    """line_a, line_b: (3,): L1 and L2: h = c0 + c1 x + c2 x², mm."""
    edge_a: Place
    edge_b: Place
    """edge_a, edge_b: (x, h): where the step was taken, on the lines: the ideal edges D′ and G′ where those are known.
    """
    inflection_a: Place | None
    inflection_b: Place | None
    """inflection_a, inflection_b: (x, h) or None: D and G; None where the width was not measured."""
    step: float
    """As the fit gives it, mm."""
    width: float | None


def seam_section(cloud: StoredCloud, station: Any, fit: SectionFit | None) -> SeamSection | str:
    """The section at a row of `seam_stations` from the fit that its run kept, or why there is none."""
    from metrology.seams.gap.width import GapEdge, gap_width, inflection
    from metrology.seams.skins.step import step_height

    numbers = [station.u_px, station.v_px, station.step_mm]
    if fit is None:
        return _(NOT_KEPT)
    if not all(_is_number(value) for value in numbers):
        return _("this place was not measured")
    u, v, stored = (float(value) for value in numbers)
    step, width = step_height(fit, *fit.edges_mm), None
    inflection_a: Place | None = None
    inflection_b: Place | None = None
    if abs(step - stored) > _SAME_MM:
        return _differs("step", step, stored)
    if fit.depths_mm is not None and _is_number(station.width_mm):
        a, b = (GapEdge(*edge) for edge in zip(fit.edges_mm, fit.depths_mm, strict=True))
        width = gap_width(fit, a, b)
        if abs(width - float(station.width_mm)) > _SAME_MM:
            return _differs("width", width, float(station.width_mm))
        inflection_a, inflection_b = _place(inflection(fit.a, a)[0]), _place(inflection(fit.b, b)[0])
    scale = _pixels_per_mm(cloud, u, v)
    window = _window(cloud, u, v, 1.2 * fit.outer_mm * scale) if scale else None
    if window is None:
        return _("there are no points around this place")
    rows, columns = window
    local = fit.frame.local(cloud.points[rows, columns])
    near = (np.abs(local[:, 1]) < fit.half_length_mm) & (np.abs(local[:, 0]) < _AIR * fit.outer_mm)
    rows, columns, (x, __, h) = rows[near], columns[near], local[near].T
    if len(x) < _FEWEST:
        return _("the stored cloud has {n} points there", n=len(x))
    away = np.abs(x)
    skin = (away > fit.inner_mm) & (away < fit.outer_mm) & (np.abs(h) < _SKIN_BAND_MM)
    (start, end) = fit.edges_mm
    return SeamSection(
        x=x,
        h=h,
        used=_usable(cloud, rows, columns) & skin,
        line_a=fit.a.coefficients,
        line_b=fit.b.coefficients,
        edge_a=(start, fit.a.height(start)),
        edge_b=(end, fit.b.height(end)),
        inflection_a=inflection_a,
        inflection_b=inflection_b,
        step=step,
        width=width,
    )


def _place(point: Array) -> Place:
    return float(point[0]), float(point[1])


def _differs(name: str, here: float, stored: float) -> str:
    return _(
        "this version gets a {name} of {here} mm from the run's own fit, the table says {stored} mm; "
        "inspect the scan again to see how it is measured now",
        name=quantity_words(name),
        here=format(here, "+.4f"),
        stored=format(stored, "+.4f"),
    )


def _order(coefficients: Array) -> int:
    return 1 if len(coefficients) == 3 else 2


def _height(coefficients: Array, x: Array, y: Array) -> Array:
    return np.asarray(monomials(x, y, _order(coefficients)) @ coefficients)


def _usable(cloud: StoredCloud, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> Mask:
    """(n,) points that are not beside an edge."""
    return np.asarray((cloud.flags[rows, columns] & np.uint16(MISSING | PixelFlag.EDGE)) == 0)


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


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float, np.number)) and bool(np.isfinite(float(value)))
