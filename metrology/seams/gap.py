"""Step and width of a gap from its edges and skin lines (paper §4.2, eqs 6–11)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.fits import SectionFit, SkinLine
from metrology.seams.sections import Section

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GapEdge:
    """One side's edge in a section.

    Attributes
    ----------
    ideal_mm : float
        x of the ideal edge, D′ on side A and G′ on side B: the projection of the inflection point onto the skin line.
    depth_mm : float
        How deep the inflection point, D or G, lies under it.
    """

    ideal_mm: float
    depth_mm: float


@dataclass(frozen=True)
class Gap:
    """Both edges at one station, and the standard deviation of the width between them, mm."""

    a: GapEdge
    b: GapEdge
    sigma_width_mm: float


def signed_distance(x: float, h: float, line: SkinLine) -> float:
    """Distance of a point from a skin line, positive outside the skin: eqs 7 and 8 with a sign, curved lines too."""
    return (h - line.height(x)) / float(np.hypot(1.0, line.slope(x)))


def step_height(section: Section | SectionFit, a: float, b: float) -> float:
    """H_gap, eq 6 with a sign: how much higher side B lies than side A, as the mean of what both edges say."""
    d_prime = -signed_distance(a, section.a.height(a), section.b)
    g_prime = signed_distance(b, section.b.height(b), section.a)
    return 0.5 * (d_prime + g_prime)


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


def step_gradient(a: float, b: float) -> Array:
    """(5,) derivative of the step by a's c_0, c_1, b's c_0, c_1, c_2: how the skin lines' covariance enters."""
    middle = 0.5 * (a + b)
    # Both curves share c_2, which cancels in their difference.
    return np.array([-1.0, -middle, 1.0, middle, 0.0])


def midpoint(section: Section, a: float, b: float) -> Array:
    """(3,) rig-frame midpoint of the ideal edges."""
    points = np.stack([section.point(a, section.a.height(a)), section.point(b, section.b.height(b))])
    return np.asarray(points.mean(axis=0))
