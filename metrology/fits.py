"""The fits that a result's values rest on, as they are kept with the run: what a close-up draws.

Those of rivets and seams hold no points, only surfaces and lines: with them a value can be had again by the function
that gave it. A defect's is its form as it was measured.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from metrology.arrays import Array
from metrology.defects.row import Defect
from metrology.results import Rivet, SeamStation
from metrology.surfaces import Frame

_SHOWN = 2.6  # radii at half depth: a bowl's foot is at two


@dataclass(frozen=True)
class HeadFit:
    """A head's surface and the skin's in one frame."""

    frame: Frame
    """Origin in the head, h along the skin's normal towards the rig."""
    skin: Array
    head: Array
    """skin, head: (k,): coefficients of `surfaces.monomials`, mm."""
    x: float
    y: float
    radius: float
    """x, y, radius: the head's circle, mm."""
    inner_mm: float
    """The head's points lie within this distance of the origin."""
    outer_mm: tuple[float, float]
    """The skin's points lie between these distances."""


@dataclass(frozen=True)
class SkinLine:
    """One side's skin in a section: ``h(x) = c_0 + c_1 x + c_2 x²``."""

    coefficients: Array
    """(3,): c_0 (mm), c_1, c_2 (1/mm)."""
    n: int
    """Points it rests on."""

    def height(self, x: float) -> float:
        """h at x, mm."""
        return float(self.coefficients @ (1.0, x, x * x))

    def slope(self, x: float) -> float:
        """dh/dx at x."""
        return float(self.coefficients[1] + 2 * self.coefficients[2] * x)


@dataclass(frozen=True)
class SectionFit:
    """Both skin lines of a section across a seam, and its edges."""

    frame: Frame
    """x across the seam from side A to side B, y along it, h along the skins' normal towards the rig."""
    a: SkinLine
    b: SkinLine
    edges_mm: tuple[float, float]
    """x at which the step was taken: of the ideal edges D′ and G′, or of the line's borders where those are unknown."""
    depths_mm: tuple[float, float] | None
    """(float, float) or None: how deep the inflection points D and G lie under D′ and G′; None where the width was not
    measured."""
    inner_mm: float
    outer_mm: float
    half_length_mm: float
    """inner_mm, outer_mm, half_length_mm: the lines' points lie between these distances from the origin across the
    seam, and so far along it."""

    def exchanged(self) -> SectionFit:
        """The same section with side A for B and B for A."""
        turn = np.array([[-1.0], [-1.0], [1.0]])
        a, b = (SkinLine(line.coefficients * (1, -1, 1), line.n) for line in (self.b, self.a))
        depths = None if self.depths_mm is None else (self.depths_mm[1], self.depths_mm[0])
        return replace(
            self,
            frame=Frame(self.frame.origin, self.frame.axes * turn),
            a=a,
            b=b,
            edges_mm=(-self.edges_mm[1], -self.edges_mm[0]),
            depths_mm=depths,
        )


@dataclass(frozen=True)
class FittedRivet(Rivet):
    """A rivet with the fit that its values rest on; None where it was not measured."""

    fit: HeadFit | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True)
class FittedStation(SeamStation):
    """A seam station with the fit that its values rest on; None where it was not measured."""

    fit: SectionFit | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True)
class DefectSection:
    """A line over a defect, as far as its plate goes."""

    t: Array
    """(n,): position, 0 at the deepest point, mm."""
    surface: Array
    skin: Array
    """surface, skin: (n,): heights of what is there and of the skin without the defect over the tangent plane, mm."""
    edge: Array
    """(n,): underside of a straight-edge as long as the line that lies on the surface: where it does not touch, it is
    above. (A rigid edge cannot bend round a curved skin: on one it rocks, and touches on either side of a dent.)"""

    def gap(self, reach: float) -> float:
        """Greatest gap under the straight-edge within `reach` of the deepest point, mm."""
        near = np.abs(self.t) <= reach
        return float((self.edge - self.surface)[near].max(initial=0.0))

    def within(self, reach: float) -> DefectSection:
        """The part within `reach` of the deepest point, over the straight-edge's line there."""
        middle = int(np.abs(self.t).argmin())
        before, after = max(middle - 1, 0), min(middle + 1, len(self.t) - 1)
        slope = (self.edge[after] - self.edge[before]) / max(self.t[after] - self.t[before], 1e-9)
        level = self.edge[middle] + slope * self.t
        part = np.abs(self.t) <= reach
        return DefectSection(self.t[part], *((h - level)[part] for h in (self.surface, self.skin, self.edge)))


@dataclass(frozen=True)
class DefectForm:
    """Heights above the skin as it would be without the defect, mm."""

    heights: Array
    """(rows, columns): round the defect as the left image shows it; NaN where no sound skin is."""
    corner: tuple[float, float]
    """(x, y): of the middle of its first cell from the deepest point, mm; x as the image's columns, y as its rows."""
    step_mm: float
    outline: Array
    """(n, 2): at half depth, mm on the map."""
    along: DefectSection
    across: DefectSection
    """along, across: through the deepest point; the line of `along` lies in the direction `turn` of the map, radians
    from x to y."""
    turn: float

    @property
    def reach_mm(self) -> float:
        """From the deepest point to the end of what a section shows: the foot and a bit of bare skin."""
        return _SHOWN * float(np.hypot(*self.outline.T).max())

    def shown(self) -> tuple[DefectSection, DefectSection]:
        """The sections along and across, as far as a close-up shows them, held so that the straight-edge is level."""
        return self.along.within(self.reach_mm), self.across.within(self.reach_mm)


@dataclass(frozen=True)
class FittedDefect(Defect):
    """A defect with its form; None where it has no depth."""

    form: DefectForm | None = field(default=None, compare=False, repr=False)
