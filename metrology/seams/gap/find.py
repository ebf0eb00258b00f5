"""The gap at every seam station of a seam, by the method that the joint and the settings ask for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrology.arrays import Mask
from metrology.cloud import Reconstruction
from metrology.results import Joint
from metrology.seams.gap.image_edges import image_edges
from metrology.seams.gap.lap_shadow import NO_GAP
from metrology.seams.gap.point_edges import point_edges
from metrology.seams.gap.width import Gap
from metrology.seams.settings import SeamSettings
from metrology.seams.skins.sections import Section


def find_gaps(
    sections: Sequence[Section | None],
    half_widths: Sequence[float],
    joint: Joint | None,
    reconstruction: Reconstruction,
    heads: Mask,
    settings: SeamSettings,
) -> tuple[list[Gap | str], Joint | None]:
    """The gap at every seam station, or why it is not known; and the joint's type.

    Parameters
    ----------
    sections : sequence of Section or None
        One per seam station, in order along the seam.
    half_widths : sequence of float
        Half the width of the line as detected, mm.
    joint : Joint, optional
        What detection knows it to be.
    heads : (h, w) ndarray of bool
        Rivet heads and what is close around them.
    """
    if joint == "lap":
        return [NO_GAP] * len(sections), joint
    projector = reconstruction.rig.screen
    # The grey-level model needs two views, and to know where the light is.
    if settings.edges == "image" and projector is not None and reconstruction.right is not None:
        return image_edges(
            sections, half_widths, reconstruction, projector, settings.half_length_mm, settings.chamfer_deg
        )
    gaps = point_edges(
        sections,
        reconstruction,
        reconstruction.valid & ~heads,
        settings.half_length_mm,
        max(half_widths) + settings.skin_extent_mm,
        settings.tolerance_sigmas,
        np.deg2rad(settings.merge_angle_deg),
    )
    return gaps, joint
