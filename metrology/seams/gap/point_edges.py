"""Both edges of a gap from the section's points alone, by the paper's piecewise fit (`edges: points`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrology.arrays import Array, Mask
from metrology.cloud import Reconstruction
from metrology.robust import MAD
from metrology.seams.gap.piecewise import SideFit, project_onto, side_of_section
from metrology.seams.gap.width import Gap, GapEdge
from metrology.seams.skins.sections import Section, strip

# Points this near to an edge are mixed across it, about two blur radii, px: they round both corners the same way, by an
# unknown part of that.
_MIXED_PX = 1.5
# Standard deviation of an evenly spread error, relative to its largest.
_EVEN = 3.0**-0.5
_FLOOR = 0.95  # share of a gap's points that are no deeper than its floor


def point_edges(
    sections: Sequence[Section | None], reconstruction: Reconstruction, clear: Mask, half_length: float, extent: float,
    tolerance_sigmas: float, angle: float,
) -> list[Gap | str]:  # fmt: skip
    """The gap at every station, or why it is not known.

    Parameters
    ----------
    clear : (h, w) ndarray of bool
        Pixels with a point, mixed ones too, off the rivets.
    extent : float
        Largest |x|, mm.
    tolerance_sigmas, angle : float
        ε in units of the points' median σ, and θ in radians.
    """
    gaps: list[Gap | str] = []
    for section in sections:
        if section is None:
            gaps.append("no section")
            continue
        pixel = reconstruction.rig.left.project(section.frame.origin)
        points = strip(reconstruction, clear, pixel, section.frame, half_length, extent)
        points = points[np.argsort(points[:, 0])]
        x, h, sigma = points[:, 0], points[:, 2], float(np.median(points[:, 3]))
        a = side_of_section(x, h, tolerance_sigmas * sigma, angle)
        b = side_of_section(-x[::-1], h[::-1], tolerance_sigmas * sigma, angle)
        if a is None or b is None:
            missing = " and ".join(name for name, fit in (("A", a), ("B", b)) if fit is None)
            gaps.append(f"edge {missing} not seen in the points")
            continue
        pixel_mm = section.frame.origin[2] / reconstruction.rig.left.K[0, 0]
        of_a, of_b = to_the_wall(x, h, a, -b.inflection[0]), to_the_wall(-x[::-1], h[::-1], b, -a.inflection[0])
        spread = float(np.hypot(2 * _MIXED_PX * pixel_mm, 0.5 * (of_a + of_b)))
        gaps.append(Gap(_edge(a, 1.0, of_a), _edge(b, -1.0, of_b), _EVEN * spread))
    return _with_scatter(gaps)


def to_the_wall(x: Array, h: Array, fit: SideFit, other: float) -> float:
    """How far into the gap the edge may lie beyond its inflection point, mm: to where the points are half-way down.

    Mixed points round the corner, and a chamfer passes for skin or for wall; where nothing was measured beyond the
    inflection point, the edge may lie anywhere up to the next point.

    Parameters
    ----------
    x, h : (n,) ndarray
        The section, x rising from the side's skin into the gap.
    other : float
        x of the other side's inflection point.
    """
    beyond = (x > fit.inflection[0]) & (x < other)
    if not beyond.any():
        return max(other - fit.inflection[0], 0.0)
    depth = fit.slope * x[beyond] + fit.intercept - h[beyond]
    down = x[beyond][depth >= 0.5 * float(np.quantile(depth, _FLOOR))]
    return float(down[0] - fit.inflection[0])


def _with_scatter(gaps: list[Gap | str]) -> list[Gap | str]:
    """Corners jump from one piece's end to another's, station by station: the widths' scatter comes in addition."""
    found = [gap for gap in gaps if isinstance(gap, Gap)]
    if len(found) < 2:
        return gaps
    jumps = np.diff([gap.b.ideal_mm - gap.a.ideal_mm for gap in found])
    scatter = MAD * float(np.median(np.abs(jumps))) / np.sqrt(2.0)
    return [
        replace(gap, sigma_width_mm=float(np.hypot(gap.sigma_width_mm, scatter))) if isinstance(gap, Gap) else gap
        for gap in gaps
    ]


def _edge(fit: SideFit, sign: float, to_wall: float) -> GapEdge:
    """The edge, half-way between the inflection point and where it can be at most."""
    ideal = project_onto(fit)
    return GapEdge(sign * (ideal[0] + 0.5 * to_wall), max(ideal[1] - fit.inflection[1], 0.0))
