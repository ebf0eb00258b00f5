"""Seams of a scan: lines of the left image that the 3-D data confirm (paper §3.2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import Reconstruction
from metrology.results import RivetDetection, SeamLine
from metrology.seams.lines import ImageLine, detect_lines
from metrology.seams.relief import Relief, examine_relief
from metrology.seams.sections import usable_points
from metrology.seams.settings import SeamSettings

Array = NDArray[np.float64]

# A line without relief is worth showing to a person if it is as long and as marked as a seam.
_SHOWN_LENGTH_PX = 400.0
_SHOWN_CONTRAST = 0.3
_SHOWN_CONFIDENCE = 0.2


def detect_seams(
    reconstruction: Reconstruction, rivets: Sequence[RivetDetection], settings: SeamSettings | None = None
) -> list[SeamLine]:
    """Seams, numbered S01 … from left to right and top to bottom, and conspicuous lines without relief after them.

    Parameters
    ----------
    reconstruction : Reconstruction
    rivets : sequence of RivetDetection
        A line may run on across them.
    settings : SeamSettings, optional
    """
    settings = settings or SeamSettings()
    usable = usable_points(reconstruction)
    seams, others = [], []
    for line in detect_lines(reconstruction.left.texture, settings.lines):
        relief = examine_relief(line.centre_px, float(np.nanmedian(line.width_px)), reconstruction, usable, settings)
        if relief.is_seam:
            seams.append((line, _confidence(line, relief)))
        elif relief.between_skins and line.length_px > _SHOWN_LENGTH_PX and abs(line.contrast) > _SHOWN_CONTRAST:
            others.append((line, _SHOWN_CONFIDENCE))
    seams.sort(key=lambda found: tuple(found[0].centre_px.mean(axis=0)))
    numbered = [(line, confidence, True) for line, confidence in seams]
    numbered += [(line, confidence, False) for line, confidence in others]
    return [
        SeamLine(f"S{number:02d}", line.centre_px, line.width_px, confidence, relief)
        for number, (line, confidence, relief) in enumerate(numbered, start=1)
    ]


def _confidence(line: ImageLine, relief: Relief) -> float:
    """How sure it is a seam: relief along its length, and a line that is there all along."""
    return float(np.clip(max(relief.groove_share, relief.step_share) * (0.5 + 0.5 * line.support), 0.0, 1.0))
