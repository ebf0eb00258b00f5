"""Whether both cameras see the fringes with one contrast, as they should but for focus: a veil takes it from one alone.

The contrast (modulation over mean level) of a point is the skin's and the projector's, alike in both cameras whatever
the paint. Focus changes it smoothly over the field. Stray light in one lens lowers it in a part of the picture, and
bends the skin where the light ends.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from metrology.blocks import beyond_smooth, in_blocks
from metrology.cloud import Reconstruction
from metrology.third_view import BLOCK_PX

CONTRAST_LIMIT = 0.1
"""Relative; a sound scan's blocks leave 0.05 beyond what is smooth, single ones at glints more."""
# A region of so many blocks: glints and letters are smaller.
_LEAST_REGION = 6
_LEAST_BLOCKS = 24
_STRIDE = 16
_LEAST_PIXELS = 4


def contrast_apart(reconstruction: Reconstruction) -> float | None:
    """What the cameras' contrasts differ by in a region beyond what is smooth over the field; None: no such region."""
    if reconstruction.right is None:
        return None
    left, right, sample = reconstruction.left, reconstruction.right, np.s_[::_STRIDE, ::_STRIDE]
    good = reconstruction.valid[sample] & (reconstruction.flags[sample] == 0)
    v, u = np.nonzero(good)
    place = np.rint(reconstruction.rig.with_right().project(reconstruction.points[sample][good])).astype(int)
    height, width = right.texture.shape
    inside = ((place >= 0) & (place < (width, height))).all(-1)
    v, u, (column, row) = v[inside], u[inside], place[inside].T
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = np.log(
            left.modulation[sample][v, u]
            / left.texture[sample][v, u]
            * right.texture[row, column]
            / right.modulation[row, column]
        )
    v, u, apart = v[np.isfinite(apart)], u[np.isfinite(apart)], apart[np.isfinite(apart)]
    blocks = in_blocks(v, u, good.shape[1], BLOCK_PX // _STRIDE)
    told = blocks.count >= _LEAST_PIXELS
    if told.sum() < _LEAST_BLOCKS:
        return None
    row, column = blocks.row[told], blocks.column[told]
    field = np.zeros((int(row.max()) + 1, int(column.max()) + 1))
    field[row, column], _ = beyond_smooth(row, column, blocks.medians(apart.astype(np.float64))[told])
    worst = 0.0
    for sign in (-1, 1):
        label, number = ndimage.label(sign * field > CONTRAST_LIMIT, np.ones((3, 3)))
        for region in range(1, number + 1):
            if (label == region).sum() >= _LEAST_REGION:
                worst = max(worst, float(np.median(np.abs(field[label == region]))))
    return worst or None
