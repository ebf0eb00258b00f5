"""Sections through a defect, and its depth as the shop measures it: the gap under a straight-edge laid over it."""

from __future__ import annotations

import cv2
import numpy as np

from metrology.arrays import Array
from metrology.cloud import Reconstruction
from metrology.defects.cells import SIZE
from metrology.defects.patch import Patch
from metrology.defects.skin_map import SkinMap
from metrology.fits import DefectSection
from metrology.jit import kernel

_STEP_MM = 0.5


def sections(
    patch: Patch,
    depth: Array,
    skin: SkinMap,
    reconstruction: Reconstruction,
    at: tuple[float, float],
    turns: Array,
    length_mm: float,
) -> list[DefectSection]:
    """Lines through a point.

    Parameters
    ----------
    depth : (rows, columns) ndarray
        Of the patch, smoothed, mm; beyond it the lines are taken from the skin's cells.
    at : (x, y)
        mm in the patch's frame.
    turns : (m,) ndarray
        Directions of the lines, radians.
    length_mm : float
        `at` is in its middle.
    """
    half = int(0.5 * length_mm / _STEP_MM)
    t = np.asarray(_STEP_MM * np.arange(-half, half + 1), float)
    lines = np.stack([at[0] + np.outer(np.cos(turns), t), at[1] + np.outer(np.sin(turns), t)], axis=-1).reshape(-1, 2)
    reference = patch.reference
    x, y = np.ascontiguousarray(reference.frame.local(patch.frame.rig(np.pad(lines, ((0, 0), (0, 1)))))[:, :2].T)
    on_skin = reference.frame.rig(np.stack([x, y, reference.height(x, y)], axis=1))
    bare = patch.frame.local(on_skin)[:, 2]
    pixels = reconstruction.rig.left.project(on_skin)
    below = skin.depth_at(patch.number, (pixels - 0.5 * (SIZE - 1)) / SIZE)
    fine = _between(patch, depth, patch.grid_of(pixels))
    below = np.where(np.isfinite(below) & np.isfinite(fine), patch.sign * fine, below)
    shape = len(turns), len(t)
    return [_seen(t, *line) for line in zip(bare.reshape(shape), below.reshape(shape), strict=True)]


def _seen(t: Array, bare: Array, below: Array) -> DefectSection:
    """The section of a line, as far as it is known without a break to either side of its middle."""
    half = len(t) // 2
    gone = np.flatnonzero(~np.isfinite(below))
    first = int(gone[gone < half].max(initial=-1)) + 1
    end = int(gone[gone >= half].min(initial=len(t)))
    part = slice(first, max(end, first + 1))
    surface = np.asarray(np.nan_to_num(bare - below)[part], float)
    return DefectSection(t[part], surface, bare[part], _laid_on(t[part], surface))


def _between(patch: Patch, depth: Array, places: Array) -> Array:
    """(n,) depth at places (n, 2), column and row of the grid; NaN off the patch's plate."""
    column, row = places.astype(np.float32).T
    values = cv2.remap(
        np.where(patch.plate, depth, np.nan).astype(np.float32),
        column[:, None], row[:, None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan,
    )  # fmt: skip
    return np.asarray(values[:, 0], float)


def _laid_on(t: Array, surface: Array) -> Array:
    """The upper hull of a profile."""
    hull = np.empty(len(t), np.int64)
    hull = hull[: _upper_hull(t, surface, hull)]
    return np.asarray(np.interp(t, t[hull], surface[hull]))


@kernel
def _upper_hull(t, surface, hull):  # type: ignore[no-untyped-def]
    """Number of points of the upper hull of a profile, whose indices are written to `hull`; all (n,)."""
    count = 0
    for k in range(t.shape[0]):
        while count > 1:
            i, j = hull[count - 2], hull[count - 1]
            if (surface[j] - surface[i]) * (t[k] - t[i]) > (surface[k] - surface[i]) * (t[j] - t[i]):
                break
            count -= 1
        hull[count] = k
        count += 1
    return count
