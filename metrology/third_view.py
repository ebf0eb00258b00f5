"""The projector as a third view: the coordinate that was decoded at a point against the one the rig projects it to.

Over the whole field the difference tells whether the rig still fits (`metrology.rig_health`). Where it is off in one
place only, a lens bends light there otherwise than its calibration says: a drop, a fingerprint. Both cameras' rays then
meet at a wrong depth, as smooth as a dent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from metrology.arrays import Array
from metrology.blocks import beyond_smooth, in_blocks
from metrology.cloud import Reconstruction
from metrology.frame_doubts import Place
from metrology.fringe import Axis
from metrology.robust import MAD

BLOCK_PX = 64
"""Side of the blocks; wider than a fringe, so that the ripple that a projector's gamma leaves averages out."""
# A block's median is known well enough from every eighth row and column, at a sixty-fourth of the projections.
_STRIDE = 8
# Blocks that hold fewer of their points lie at borders, where a ripple does not average out.
_LEAST_PART = 0.25
_LEAST_BLOCKS = 24
# Locally off: by more than sound blocks are, as they scatter and by their own noise, and by this much at least.
_SIGMAS, _FLOOR_PX = 8.0, 0.03
# Where most of the picture is this far off, it is the rig that does not fit.
_RIG_PX = 0.5


@dataclass(frozen=True)
class BlocksOff:
    """Medians over square blocks of the left image, those without points left out."""

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    """row, column (n,): of the block."""
    off_px: Array
    """(n,) decoded minus projected coordinate, projector pixels."""
    sigma_px: Array
    """(n,) its standard deviation by noise."""
    part: Array
    """(n,) share of the block that has points."""
    side_px: int


@dataclass(frozen=True)
class BentPlace:
    """Where light goes another way than the rig says."""

    place: Place
    off_px: float
    """Largest deviation of the coordinate, projector pixels."""
    limit_px: float
    """What it is expected not to exceed."""


def third_view(reconstruction: Reconstruction, axis: Axis, block_px: int = BLOCK_PX) -> BlocksOff | None:
    """Decoded minus projected coordinate in blocks; None without a calibrated projector or any point."""
    device = reconstruction.rig.projector
    if device is None:
        return None
    sample = np.s_[::_STRIDE, ::_STRIDE]
    points = reconstruction.points[sample]
    good = np.isfinite(points[..., 2]) & (reconstruction.flags[sample] == 0)
    v, u = np.nonzero(good)
    if len(v) == 0:
        return None
    projected = device.project(points[good])[:, 0 if axis == "x" else 1]
    off = reconstruction.left.coordinate[sample][good] - projected
    side = max(1, block_px // _STRIDE)
    blocks = in_blocks(v, u, good.shape[1], side)
    middle = blocks.medians(off)
    scatter = blocks.medians(np.abs(off - middle[blocks.group]))
    # A median of n normal values scatters by 1.2533 σ / √n; neighbouring pixels share little noise.
    sigma = 1.2533 * MAD * scatter / np.sqrt(blocks.count)
    return BlocksOff(blocks.row, blocks.column, middle, sigma, blocks.count / side**2, side * _STRIDE)


def bent_places(reconstruction: Reconstruction, axis: Axis) -> tuple[BentPlace, ...]:
    """Places where the coordinate is off beyond what changes smoothly over the field.

    One camera alone tells none: its points lie where the coordinate puts them.
    """
    blocks = None if reconstruction.right is None else third_view(reconstruction, axis)
    if blocks is None:
        return ()
    inner = blocks.part >= _LEAST_PART
    if inner.sum() < _LEAST_BLOCKS or np.median(np.abs(blocks.off_px[inner])) > _RIG_PX:
        return ()
    row, column, sigma = blocks.row[inner], blocks.column[inner], blocks.sigma_px[inner]
    local, scatter = beyond_smooth(row, column, blocks.off_px[inner])
    limit = max(_FLOOR_PX, _SIGMAS * scatter)
    amount = np.zeros((int(row.max()) + 1, int(column.max()) + 1))
    amount[row, column] = np.where(np.abs(local) > np.maximum(limit, _SIGMAS * sigma), np.abs(local), 0)
    # A bump's shift has two lobes, and its foot reaches a block farther than it is seen.
    reach = ndimage.binary_dilation(amount > 0, np.ones((3, 3)))
    label, _ = ndimage.label(reach, np.ones((3, 3)))
    height, width = reconstruction.left.texture.shape
    places = []
    for number, (down, right) in enumerate(ndimage.find_objects(label), start=1):
        inside = np.where(label == number, amount, 0)
        if np.count_nonzero(inside) < 2:  # alone among sound ones: an edge within it
            continue
        u_px = float(right.start * blocks.side_px), float(min(right.stop * blocks.side_px, width))
        v_px = float(down.start * blocks.side_px), float(min(down.stop * blocks.side_px, height))
        places.append(BentPlace(Place(u_px, v_px), float(inside.max()), limit))
    return tuple(places)
