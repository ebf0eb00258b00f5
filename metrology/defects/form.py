"""The form of a defect as a close-up draws it: a map of heights round it, and sections along and across it."""

from __future__ import annotations

import cv2
import numpy as np

from metrology.arrays import Array
from metrology.cloud import Reconstruction
from metrology.defects.bottom import Bottom
from metrology.defects.outline import Outline
from metrology.defects.patch import Patch
from metrology.fits import DefectForm, DefectSection

_MOST_CELLS = 96  # of a map along its longer side


def form_of(
    patch: Patch,
    reconstruction: Reconstruction,
    bottom: Bottom,
    outline: Outline,
    along: DefectSection,
    across: DefectSection,
) -> DefectForm:
    """The form of a defect whose sections are known."""
    here = np.array([bottom.x, bottom.y])
    way = np.array([np.cos(outline.angle), np.sin(outline.angle)])
    places = np.vstack([here, here + way, np.column_stack([outline.x, outline.y])])
    pixels = reconstruction.rig.left.project(patch.frame.rig(np.column_stack([places, np.zeros(len(places))])))
    middle, along_it, *border = patch.grid_of(pixels)
    share = max(1, -(-max(patch.depth.shape) // _MOST_CELLS))
    x, y = (0.5 * (share - 1) - middle) * patch.step_mm
    return DefectForm(
        heights=-patch.sign * _coarser(patch, share),
        corner=(float(x), float(y)),
        step_mm=share * patch.step_mm,
        outline=(np.array(border) - middle) * patch.step_mm,
        along=along,
        across=across,
        turn=float(np.arctan2(*(along_it - middle)[::-1])),
    )


def _coarser(patch: Patch, share: int) -> Array:
    """Means over squares of grid cells; NaN where hardly one of them is sound skin."""
    rows, columns = (n // share * share for n in patch.depth.shape)
    known = patch.skin[:rows, :columns].astype(float)
    values = np.where(known > 0, patch.depth[:rows, :columns], 0.0)
    size = columns // share, rows // share
    total, weight = (cv2.resize(part, size, interpolation=cv2.INTER_AREA) for part in (values, known))
    return np.where(weight >= 0.5, total / np.maximum(weight, 1e-9), np.nan)
