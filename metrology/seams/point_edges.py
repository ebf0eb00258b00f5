"""Both edges of a gap from the section's points alone, by the paper's piecewise fit (`edges: points`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import Reconstruction
from metrology.seams.gap import Gap, GapEdge
from metrology.seams.piecewise import SideFit, project_onto, side_of_section
from metrology.seams.sections import Section, strip

Mask = NDArray[np.bool_]


# A corner is found to the spacing of the points; both corners' errors add up, each spread evenly over it.
_SPREAD_OF_TWO = (2.0 / 12.0) ** 0.5


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
        # The strip's rows interleave: along one row the points lie this far apart.
        spacing = float(np.sqrt(extent * half_length * 4.0 / len(points)))
        gaps.append(Gap(_edge(a, 1.0), _edge(b, -1.0), _SPREAD_OF_TWO * spacing))
    return gaps


def _edge(fit: SideFit, sign: float) -> GapEdge:
    ideal = project_onto(fit)
    return GapEdge(sign * ideal[0], max(ideal[1] - fit.inflection[1], 0.0))
