"""Both edges of a gap at every station from both cameras' images (`edges: image`).

One camera sees a wall of the gap, so the dark band's middle is not the gap's, and a chamfer looks wider to one camera
than to the other. All of it follows from one section, which is fitted to both images (`fit`). D and G, the
chamfers' lower ends, are projected onto the skin lines.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrology.cloud import Reconstruction
from metrology.results import Joint
from metrology.rig import Device
from metrology.seams.gap.fit import fit_gap
from metrology.seams.gap.floor import floor_depth, possible_floors
from metrology.seams.gap.lap_shadow import NO_GAP, gap_or_edge, shadow_alone
from metrology.seams.gap.profiles import collect
from metrology.seams.gap.views import both_views
from metrology.seams.gap.width import Gap, GapEdge
from metrology.seams.skins.sections import Section


def image_edges(
    sections: Sequence[Section | None],
    half_widths: Sequence[float],
    reconstruction: Reconstruction,
    projector: Device,
    half_length: float,
    chamfer_deg: float,
) -> tuple[list[Gap | str], Joint | None]:
    """The gap at every station, or why it is not known; and the joint's type.

    Parameters
    ----------
    sections : sequence of Section or None
        One per station, in order along the seam.
    half_widths : sequence of float
        Half the width of the line as detected, mm.
    projector : Device
        The lamp.
    half_length : float
        ε_d, mm.
    chamfer_deg : float
        Angle of the chamfers against the skin as drawn.
    """
    gaps: list[Gap | str] = ["edges not seen by a camera"] * len(sections)
    slope = float(np.tan(np.deg2rad(chamfer_deg)))
    views = both_views(reconstruction)
    profiles = collect(sections, half_widths, views, projector, half_length, slope)
    if profiles is None:
        return gaps, None
    if widest := shadow_alone(profiles):
        why = f"{NO_GAP} (what is dark is its edge's wall and shadow, or a gap under {widest:.2f} mm)"
        return [why] * len(sections), "lap"
    if widest := gap_or_edge(profiles):
        return [f"a lap joint with a broken edge, or a gap under {widest:.2f} mm: both look alike"] * len(
            sections
        ), None
    fit = fit_gap(profiles, possible_floors(floor_depth(sections, half_widths, reconstruction, half_length)))
    depths = fit.chamfer_slope * fit.chamfers_mm
    for row, station in enumerate(profiles.stations):
        if not fit.sound[row]:
            gaps[station] = "the gap looks unlike the rest of the seam: a hole, another seam or dirt"
            continue
        shift = fit.leans[row] * depths
        a = GapEdge(float(fit.borders[row, 0] + fit.chamfers_mm[0] + shift[0]), float(depths[0]))
        b = GapEdge(float(fit.borders[row, 1] - fit.chamfers_mm[1] + shift[1]), float(depths[1]))
        gaps[station] = Gap(a, b, float(np.hypot(fit.sigma_own_mm[row], fit.sigma_common_mm)))
    return gaps, "butt sealed" if fit.sealed else "butt"
