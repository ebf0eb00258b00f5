"""Sections through a defect, and its depth as the shop measures it: the gap under a straight-edge laid over it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import Reconstruction
from metrology.defects.cells import SIZE
from metrology.defects.patch import Patch
from metrology.defects.skin_map import SkinMap
from metrology.jit import kernel

Array = NDArray[np.float64]

_STEP_MM = 0.5


@dataclass(frozen=True)
class Section:
    """A line over a defect, as far as its plate goes.

    Attributes
    ----------
    t : (n,) ndarray
        Position, 0 at the deepest point, mm.
    surface, skin : (n,) ndarray
        Heights of what is there and of the skin without the defect over the tangent plane, mm.
    edge : (n,) ndarray
        Underside of a straight-edge as long as the line that lies on the surface: where it does not touch, it is
        above. (A rigid edge cannot bend round a curved skin: on one it rocks, and touches on either side of a dent.)
    """

    t: Array
    surface: Array
    skin: Array
    edge: Array

    def gap(self, reach: float) -> float:
        """Greatest gap under the straight-edge within `reach` of the deepest point, mm."""
        near = np.abs(self.t) <= reach
        return float((self.edge - self.surface)[near].max(initial=0.0))


def section(
    patch: Patch, skin: SkinMap, reconstruction: Reconstruction, at: tuple[float, float], turn: float, length_mm: float
) -> Section:
    """The line through a point.

    Parameters
    ----------
    patch : Patch
    skin : SkinMap
    reconstruction : Reconstruction
    at : (x, y)
        mm in the patch's frame.
    turn : float
        Direction of the line, radians.
    length_mm : float
        `at` is in its middle.
    """
    half = int(0.5 * length_mm / _STEP_MM)
    t = np.asarray(_STEP_MM * np.arange(-half, half + 1), float)
    line = np.stack([at[0] + t * np.cos(turn), at[1] + t * np.sin(turn), np.zeros_like(t)], axis=1)
    reference = patch.reference
    x, y = np.ascontiguousarray(reference.frame.local(patch.frame.rig(line))[:, :2].T)
    on_skin = reference.frame.rig(np.stack([x, y, reference.height(x, y)], axis=1))
    bare = patch.frame.local(on_skin)[:, 2]
    places = (reconstruction.rig.left.project(on_skin) - 0.5 * (SIZE - 1)) / SIZE
    depth = skin.depth_at(patch.number, places)
    gone = np.flatnonzero(~np.isfinite(depth))
    first = int(gone[gone < half].max(initial=-1)) + 1
    end = int(gone[gone >= half].min(initial=len(t)))
    part = slice(first, max(end, first + 1))
    surface = np.asarray(np.nan_to_num(bare - depth)[part], float)
    return Section(t[part], surface, bare[part], _laid_on(t[part], surface))


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
