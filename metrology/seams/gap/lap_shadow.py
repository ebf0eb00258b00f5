"""Whether a dark line beside a step is a gap, or no more than the step's own wall and shadow.

Blur spreads what is dark without changing how much there is of it: the brightness missing across the line, in
millimetres of black. Of the edge of a sheet of height t a camera on the low side sees a wall ``t tan θ_camera`` wide,
and a projector on the high side leaves a shadow of ``t tan θ_projector`` on the low skin; where that is enough for all
that is missing, there is no sign of a gap. Joints whose sheets differ by a sheet's thickness are lap joints. A widely
broken or rounded edge may be as dark as a narrow gap: up to there the picture leaves it open.
"""

from __future__ import annotations

import numpy as np

from metrology.arrays import Array
from metrology.seams.finding.step_edges import LEAST_STEP_MM
from metrology.seams.gap.profiles import BLUR_PX, Profiles

# Why a lap joint has no width.
NO_GAP = "lap joint: no gap"
# A broken or rounded edge of half a millimetre that sends back two thirds of the skin's light looks this dark, mm.
_EDGE_MM = 0.17
# Edges are broken over 0.6 mm at most, or over the sheet's thickness, and keep three tenths of the light at least.
_WIDEST_EDGE_MM, _DARKEST_EDGE = 0.6, 0.7


def shadow_alone(profiles: Profiles, edge_mm: float = _EDGE_MM) -> float | None:
    """None where the picture shows a gap; else how wide one might be and not show, mm.

    Parameters
    ----------
    edge_mm : float
        How dark the sheet's edge may be, mm of black.
    """
    if abs(float(np.median(_steps(profiles)))) < LEAST_STEP_MM:
        return None
    most = wall_and_shadow(profiles) + edge_mm
    missing = _missing(profiles)
    seen = np.isfinite(missing)
    views = [c for c in range(missing.shape[1]) if seen[:, c].any()]
    if not views:
        return None
    excess = [float(np.median((missing - most)[seen[:, c], c])) for c in views]
    return max(float(np.median(missing[seen[:, c], c])) for c in views) + _EDGE_MM if max(excess) < 0 else None


def gap_or_edge(profiles: Profiles) -> float | None:
    """How wide a gap may be where the widest and darkest edge of a lap looks as dark, mm; else None."""
    thickness = abs(float(np.median(_steps(profiles))))
    return shadow_alone(profiles, _DARKEST_EDGE * min(_WIDEST_EDGE_MM, thickness))


def _steps(profiles: Profiles) -> Array:
    """(n,) height of skin B above skin A, mm."""
    return np.asarray(-2.0 * profiles.tilts[:, 0])


def wall_and_shadow(profiles: Profiles) -> Array:
    """(n, k) width of a step's visible wall and of the shadow beside it, mm."""
    step = _steps(profiles)
    towards_low = -np.sign(step)[:, None]
    camera = towards_low * profiles.eyes[..., 0] / profiles.eyes[..., 1]
    lamp = towards_low * (profiles.lamps[:, :1] / profiles.lamps[:, 1:])
    wall, hidden = np.maximum(camera, 0.0), np.maximum(-camera, 0.0)
    return np.asarray(np.abs(step)[:, None] * (wall + np.maximum(np.maximum(-lamp, 0.0) - hidden, 0.0)))


def _missing(profiles: Profiles) -> Array:
    """(n, k) brightness missing across the line, mm of black; NaN where a camera does not see it."""
    n, k = profiles.sizes.shape
    missing = np.full((n, k), np.nan)
    for station, camera in np.ndindex(n, k):
        size = profiles.sizes[station, camera]
        x, grey = profiles.x[station, camera, :size], profiles.grey[station, camera, :size]
        reach = profiles.half_widths[station] + BLUR_PX / profiles.px_mm[station, camera]
        a, b = x < -reach, x > reach
        if not (a.any() and b.any()):
            continue
        # Both skins may differ in brightness; the line is taken against their mean.
        skin = 0.5 * (grey[a].mean() + grey[b].mean())
        line = ~a & ~b
        missing[station, camera] = float(np.trapezoid(1.0 - grey[line] / skin, x[line]))
    return missing
