"""Seams of a scan: lines of the left image that the 3-D data confirm (paper §3.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrology.cloud import PixelFlag, Reconstruction
from metrology.results import RivetDetection, SeamLine
from metrology.seams.finding.bridges import bridged
from metrology.seams.finding.image_line import ImageLine
from metrology.seams.finding.laps import band_of, is_beside, with_laps
from metrology.seams.finding.lines import detect_lines
from metrology.seams.finding.raised import NO_SEAM, is_level_beyond
from metrology.seams.finding.relief import MOST_PIECES, Relief, examine_relief
from metrology.seams.finding.rough import RoughLine
from metrology.seams.finding.scratches import scratches_of
from metrology.seams.places import head_mask, panel_mask
from metrology.seams.settings import SeamSettings

# A line without relief is worth showing to a person if it is as long and as marked as a seam.
_SHOWN_LENGTH_PX = 400.0
_SHOWN_CONTRAST = 0.3
# Relief that a first look sees over this share of the length may turn out to be a seam's.
_PROMISING_SHARE = 0.3
# A head's rim and countersink reach so far beyond its ellipse, px.
_HEAD_MARGIN_PX = 6.0


def detect_seams(
    reconstruction: Reconstruction, rivets: Sequence[RivetDetection], settings: SeamSettings | None = None
) -> list[SeamLine]:
    """Seams, numbered S01 … from left to right and top to bottom, and conspicuous lines without relief after them.

    A scratch is neither: it is a defect of the skin.

    Parameters
    ----------
    rivets : sequence of RivetDetection
        Their rims are no parts of lines and their heads no skin; a seam runs on across them.
    """
    settings = settings or SeamSettings()
    heads = head_mask(rivets, reconstruction.flags.shape, _HEAD_MARGIN_PX)
    # Points that an edge or a highlight may have mixed are good enough to tell skin by: nothing nearer to the line than
    # the guard is looked at, and outliers are left out.
    usable = reconstruction.valid & ~heads
    # A highlight in either camera hides points, not the panel.
    lit = (reconstruction.flags & np.uint16(PixelFlag.LOW_MODULATION)) == 0
    hidden = heads | ~panel_mask(lit)

    def worth(rough: RoughLine) -> bool:
        relief = examine_relief(rough.points, rough.width_px, reconstruction, usable, settings, MOST_PIECES // 2)
        return relief.between_skins and (relief.share >= _PROMISING_SHARE or _is_shown(rough))

    seams, others = [], []
    for line in detect_lines(reconstruction.left.texture, settings.lines, hidden, worth):
        relief = examine_relief(line.centre_px, float(np.median(line.width_px)), reconstruction, usable, settings)
        painted = not relief.is_groove and is_level_beyond(line.centre_px, relief.step_mm, reconstruction, usable)
        if relief.is_seam and not painted:
            seams.append((SeamLine("", line.centre_px, line.width_px, _confidence(line, relief), True), relief))
        elif relief.between_skins and _is_shown(line):
            others.append(SeamLine("", line.centre_px, line.width_px, NO_SEAM, False))
    seams = bridged(seams, reconstruction, usable, settings)
    scratches = scratches_of(seams, reconstruction.valid, heads)
    lines = with_laps(seams, reconstruction, usable, settings)
    raised = [line for line in lines if not line.relief]
    # The picture may show what lies on the skin as a line, too.
    bands = [band_of(line) for line in raised]
    others = [line for line in others if not is_beside(line.centre_px[::4], bands)] + raised
    found = [line for line in lines if line.relief and all(line is not scratch for scratch in scratches)]
    found.sort(key=lambda line: tuple(line.centre_px.mean(axis=0)))
    return [replace(line, seam_id=f"S{number:02d}") for number, line in enumerate([*found, *others], start=1)]


def _is_shown(line: RoughLine | ImageLine) -> bool:
    """Whether a line is conspicuous."""
    return line.length_px > _SHOWN_LENGTH_PX and abs(line.contrast) > _SHOWN_CONTRAST


def _confidence(line: ImageLine, relief: Relief) -> float:
    """How sure it is a seam: relief along its length, and a line that is there all along."""
    return float(np.clip(relief.share * (0.5 + 0.5 * line.support), 0.0, 1.0))
