"""The fits that a result's values rest on, as they are kept with the run: what a close-up draws.

They hold no points, only surfaces and lines: with them a value can be had again by the function that gave it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from metrology.results import Rivet, SeamStation
from metrology.surfaces import Frame

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HeadFit:
    """A head's surface and the skin's in one frame.

    Attributes
    ----------
    frame : Frame
        Origin in the head, h along the skin's normal towards the rig.
    skin, head : (k,) ndarray
        Coefficients of `surfaces.monomials`, mm.
    x, y, radius : float
        The head's circle, mm.
    inner_mm : float
        The head's points lie within this distance of the origin.
    outer_mm : (float, float)
        The skin's points lie between these distances.
    """

    frame: Frame
    skin: Array
    head: Array
    x: float
    y: float
    radius: float
    inner_mm: float
    outer_mm: tuple[float, float]


@dataclass(frozen=True)
class SkinLine:
    """One side's skin in a section: ``h(x) = c_0 + c_1 x + c_2 x²``.

    Attributes
    ----------
    coefficients : (3,) ndarray
        c_0 (mm), c_1, c_2 (1/mm).
    n : int
        Points it rests on.
    """

    coefficients: Array
    n: int

    def height(self, x: float) -> float:
        """h at x, mm."""
        return float(self.coefficients @ (1.0, x, x * x))

    def slope(self, x: float) -> float:
        """dh/dx at x."""
        return float(self.coefficients[1] + 2 * self.coefficients[2] * x)


@dataclass(frozen=True)
class SectionFit:
    """Both skin lines of a section across a seam, and its edges.

    Attributes
    ----------
    frame : Frame
        x across the seam from side A to side B, y along it, h along the skins' normal towards the rig.
    a, b : SkinLine
    edges_mm : (float, float)
        x at which the step was taken: of the ideal edges D′ and G′, or of the line's borders where those are unknown.
    depths_mm : (float, float) or None
        How deep the inflection points D and G lie under D′ and G′; None where the width was not measured.
    inner_mm, outer_mm, half_length_mm : float
        The lines' points lie between these distances from the origin across the seam, and so far along it.
    """

    frame: Frame
    a: SkinLine
    b: SkinLine
    edges_mm: tuple[float, float]
    depths_mm: tuple[float, float] | None
    inner_mm: float
    outer_mm: float
    half_length_mm: float

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
