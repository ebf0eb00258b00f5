"""Both edges of a gap from the section's points alone, by the paper's piecewise fit (`edges: points`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import Reconstruction
from metrology.seams.image_edges import Edge
from metrology.seams.piecewise import project_onto, side_of_section
from metrology.seams.sections import Section, strip

Mask = NDArray[np.bool_]


def point_edges(
    sections: Sequence[Section | None], reconstruction: Reconstruction, clear: Mask, half_length: float, extent: float,
    tolerance_sigmas: float, angle: float,
) -> list[tuple[Edge | None, Edge | None]]:  # fmt: skip
    """Edges A and B of every station.

    Parameters
    ----------
    clear : (h, w) ndarray of bool
        Pixels with a point, mixed ones too, off the rivets.
    extent : float
        Largest |x|, mm.
    tolerance_sigmas, angle : float
        ε in units of the points' median σ, and θ in radians.
    """
    edges: list[tuple[Edge | None, Edge | None]] = []
    for section in sections:
        if section is None:
            edges.append((None, None))
            continue
        pixel = reconstruction.rig.left.project(section.frame.origin)
        points = strip(reconstruction, clear, pixel, section.frame, half_length, extent)
        points = points[np.argsort(points[:, 0])]
        x, h, sigma = points[:, 0], points[:, 2], float(np.median(points[:, 3]))
        a = side_of_section(x, h, tolerance_sigmas * sigma, angle)
        b = side_of_section(-x[::-1], h[::-1], tolerance_sigmas * sigma, angle)
        spacing = float(np.median(np.diff(x[:: max(1, len(x) // 100)]))) if len(x) > 200 else 0.2
        edges.append(
            tuple(  # type: ignore[arg-type]
                None
                if fit is None
                else Edge(
                    border_mm=sign * project_onto(fit)[0],
                    ideal_mm=sign * project_onto(fit)[0],
                    depth_mm=max(project_onto(fit)[1] - fit.inflection[1], 0.0),
                    sigma_border_mm=spacing,
                    sigma_chamfer_mm=0.0,
                )
                for fit, sign in ((a, 1.0), (b, -1.0))
            )
        )
    return edges
