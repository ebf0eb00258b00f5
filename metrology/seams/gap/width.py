"""Width of a gap from its edges and skin lines (paper §4.2, eqs 9–11)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrology.arrays import Array
from metrology.fits import SectionFit, SkinLine
from metrology.seams.skins.sections import Section


@dataclass(frozen=True)
class GapEdge:
    """One side's edge in a section."""

    ideal_mm: float
    """x of the ideal edge, D′ on side A and G′ on side B: the projection of the inflection point onto the skin line."""
    depth_mm: float
    """How deep the inflection point, D or G, lies under it."""


@dataclass(frozen=True)
class Gap:
    """Both edges at one station, and the standard deviation of the width between them, mm."""

    a: GapEdge
    b: GapEdge
    sigma_width_mm: float


def gap_width(section: Section | SectionFit, a: GapEdge, b: GapEdge) -> float:
    """W_gap, eqs 9–11: mean distance of D from line GG′ and of G from line DD′, which are normal to the skin lines."""
    d, d_tangent = inflection(section.a, a)
    g, g_tangent = inflection(section.b, b)
    return 0.5 * (float((g - d) @ g_tangent) + float((g - d) @ d_tangent))


def inflection(line: SkinLine, edge: GapEdge) -> tuple[Array, Array]:
    """The inflection point below the ideal edge, and the skin line's unit tangent there."""
    slope = line.slope(edge.ideal_mm)
    tangent = np.array([1.0, slope]) / np.hypot(1.0, slope)
    normal = np.array([-tangent[1], tangent[0]])
    point = np.array([edge.ideal_mm, line.height(edge.ideal_mm)]) - edge.depth_mm * normal
    return point, tangent
