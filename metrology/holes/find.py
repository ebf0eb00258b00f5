"""Circles of the skin inside which nothing lies at its height: open holes, and what stands far out of the skin."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.cloud import Reconstruction
from metrology.rivets.ellipse import Ellipse, ellipse_of_shape
from metrology.rivets.relief import ReliefMap
from metrology.rivets.shapes import CircleShapes, log_shape

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_STRIDE = 2  # pixels between those that are looked at
_OFF_MM = 0.5  # from the skin: no head within any limit, and far beyond noise
_LEAST_DIAMETER_MM = 2.0
_MOST_DIAMETER_MM = 25.0
_LEAST_RADIUS_PX = 4.0
_ROUND = 0.3  # elongation against a circle's on this skin: shadows and walls make it longer to one side
_FILLED = 0.75  # of the ellipse of the same moments that a patch must fill
_SURROUNDED = 0.75  # of the pixels round a hole must lie on the skin
_SUNK_SHARE = 0.35  # of the diameter: a head sunk deeper has left its place
_EMPTY = 0.5  # share of pixels without a point that makes a hole empty


@dataclass(frozen=True)
class Opening:
    """A circle with nothing at the skin's height inside.

    Attributes
    ----------
    ellipse : Ellipse
        About where it is in the left image.
    inside_mm : float or None
        Median height over the skin of what is seen inside; None where hardly anything is.
    """

    ellipse: Ellipse
    inside_mm: float | None


def find_openings(
    reconstruction: Reconstruction, relief: ReliefMap, shapes: CircleShapes, pixels_per_mm: Array, sunk_mm: float
) -> list[Opening]:
    """Open holes and things that stand far out of the skin, from the top down.

    Parameters
    ----------
    reconstruction : Reconstruction
    relief : ReliefMap
    shapes : CircleShapes
        What a circle on the skin looks like where.
    pixels_per_mm : (rows, columns) ndarray
    sunk_mm : float
        What lies less deep is a sunk head.
    """
    height = _heights(reconstruction, relief)
    skin = np.abs(height) < _OFF_MM
    away = ~skin
    # A pixel that matches by chance, at a wall or in the dark, does not part a hole.
    closed = cv2.morphologyEx(away.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=4)
    scale = float(np.median(pixels_per_mm))
    least = max(0.5 * _LEAST_DIAMETER_MM * scale, _LEAST_RADIUS_PX) / _STRIDE
    most = 0.5 * _MOST_DIAMETER_MM * scale / _STRIDE
    found = []
    for k in range(1, count):
        u0, v0, columns, rows, area = stats[k]
        if not np.pi * least**2 < area < np.pi * most**2 or max(columns, rows) > 3 * most:
            continue
        window = np.s_[v0 : v0 + rows, u0 : u0 + columns]
        ellipse = _round_patch(labels[window] == k, (u0, v0), shapes)
        if ellipse is None or not _in_skin(skin, ellipse):
            continue
        inside = height[window][(labels[window] == k) & _core(ellipse, window)]
        seen = inside[np.isfinite(inside)]
        middle = float(np.median(seen)) if len(seen) > (1 - _EMPTY) * len(inside) and len(seen) else None
        deepest = min(sunk_mm, _SUNK_SHARE * 2 * ellipse.radius / scale)
        if middle is None or middle < -deepest or middle > sunk_mm:
            found.append(Opening(ellipse, middle))
    return sorted(found, key=lambda opening: (opening.ellipse.v, opening.ellipse.u))


def _heights(reconstruction: Reconstruction, relief: ReliefMap) -> NDArray[np.float32]:
    """(h/2, w/2) heights over the smoothed skin, mm; NaN without a point."""
    z = reconstruction.points[::_STRIDE, ::_STRIDE, 2]
    smooth = cv2.resize(relief.skin, (z.shape[1], z.shape[0]), interpolation=cv2.INTER_LINEAR)
    return np.asarray((1 / z - smooth) * z**2, np.float32)


def _round_patch(patch: Mask, corner: tuple[int, int], shapes: CircleShapes) -> Ellipse | None:
    """The circle on the skin that a patch is, in pixels of the image; None where it is none."""
    v, u = np.nonzero(patch)
    du, dv = u - u.mean(), v - v.mean()
    moments = np.array([[(du * du).mean(), (du * dv).mean()], [(du * dv).mean(), (dv * dv).mean()]])
    if np.linalg.det(moments) <= 0:
        return None
    blob = ellipse_of_shape(0.0, 0.0, 4 * moments)
    if len(u) < _FILLED * np.pi * blob.a * blob.b:
        return None
    centre = _STRIDE * (u.mean() + corner[0]), _STRIDE * (v.mean() + corner[1])
    expected = shapes.ellipse(centre[0], centre[1], _STRIDE * float(np.sqrt(len(u) / np.pi)))
    return expected if np.linalg.norm(log_shape(blob) - log_shape(expected)) < _ROUND else None


def _core(ellipse: Ellipse, window: tuple[slice, slice]) -> Mask:
    """Pixels of a window in the inner half of an ellipse."""
    v, u = np.mgrid[window]
    return np.asarray(ellipse.level(_STRIDE * u, _STRIDE * v) < 0.6)


def _in_skin(skin: Mask, ellipse: Ellipse) -> bool:
    """Whether skin surrounds a circle; the panel's border and seams are no holes."""
    reach = int(1.6 * ellipse.a / _STRIDE) + 4
    u0, v0 = int(ellipse.u / _STRIDE) - reach, int(ellipse.v / _STRIDE) - reach
    v, u = np.mgrid[v0 : v0 + 2 * reach + 1, u0 : u0 + 2 * reach + 1]
    level = ellipse.level(_STRIDE * u, _STRIDE * v)
    ring = (level > 1 + 4 / ellipse.b) & (level < 1.5 + 4 / ellipse.b)
    on_image = (u >= 0) & (v >= 0) & (u < skin.shape[1]) & (v < skin.shape[0])
    around = ring & on_image
    return bool(around.any() and skin[v[around], u[around]].sum() > _SURROUNDED * ring.sum())
