"""Circles of the skin inside which nothing lies at its height: open holes, and what stands far out of the skin."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array, Mask
from metrology.cloud import PixelFlag, Reconstruction
from metrology.rivets.ellipse import Ellipse, ellipse_of_shape
from metrology.rivets.relief import ReliefMap
from metrology.rivets.shapes import CircleShapes, log_shape

_STRIDE = 2  # pixels between those that are looked at
_OFF_MM = 0.5  # from the skin: no head within any limit, and far beyond noise
_LEAST_DIAMETER_MM = 2.0
_MOST_DIAMETER_MM = 25.0
_LEAST_RADIUS_PX = 4.0
_ROUND = 0.3  # elongation against a circle's on this skin: shadows and walls make it longer to one side
_FILLED = 0.75  # of the ellipse of the same moments that a patch must fill
_LONG = 0.9  # the same of what stands far out: both cameras and the projector lose what lies behind it
_SURROUNDED = 0.75  # of the pixels round a hole, those too bright left out, must lie on the skin
_KNOWN = 0.3  # of the pixels round a hole must not be too bright
_SUNK_SHARE = 0.35  # of the diameter: a head sunk deeper has left its place
_DARK_SUNK_MM = 1.2  # what lies deeper and is dark, too, is another sheet behind a hole
_BRIGHT = 0.5  # of the skin's brightness: no hole into which no light falls, nor black paint
_AS_SKIN = 0.75  # of the brightness about it: no hole, though nothing was measured there
_EMPTY = 0.5  # share of pixels without a point that makes a hole empty
# Diameters of the discs that part a hole from what it touches: a shadow, a chip, a stroke of paint without points.
_PARTED_BY_MM = (0.0, 1.5, 3.0, 6.0)


@dataclass(frozen=True)
class Opening:
    """A circle with nothing at the skin's height inside."""

    ellipse: Ellipse
    """About where it is in the left image."""
    inside_mm: float | None
    """Median height over the skin of what is seen inside; None where hardly anything is."""
    filled: bool = False
    """Whether sealant fills it."""


def find_openings(
    reconstruction: Reconstruction, relief: ReliefMap, shapes: CircleShapes, pixels_per_mm: Array, sunk_mm: float
) -> list[Opening]:
    """Open holes and things that stand far out of the skin, from the top down.

    Parameters
    ----------
    shapes : CircleShapes
        What a circle on the skin looks like where.
    pixels_per_mm : (rows, columns) ndarray
    sunk_mm : float
        What lies less deep is a sunk head.
    """
    scale = float(np.median(pixels_per_mm))
    height = _heights(reconstruction, relief)
    skin = np.abs(height) < _OFF_MM
    texture = reconstruction.left.texture[::_STRIDE, ::_STRIDE]
    saturated = (reconstruction.flags[::_STRIDE, ::_STRIDE] & np.uint16(PixelFlag.SATURATED)) != 0
    # Where the other camera saturates, what this one sees is as bright as the skin about it.
    reach = int(_MOST_DIAMETER_MM * scale / _STRIDE) | 1
    dazzled = (saturated | (texture > _AS_SKIN * cv2.blur(np.nan_to_num(texture), (reach, reach)))) & np.isnan(height)
    # A pixel that matches by chance, at a wall or in the dark, does not part a hole. No hole is too bright.
    away = (~skin & ~dazzled).astype(np.uint8)
    away = np.asarray(cv2.morphologyEx(away, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)), np.uint8)
    view = _View(height, texture, skin, skin | ~(saturated | dazzled), shapes, scale, sunk_mm)
    found: list[Opening] = []
    for diameter in _PARTED_BY_MM:
        size = int(diameter * scale / _STRIDE) | 1
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
        parted = np.asarray(cv2.morphologyEx(away, cv2.MORPH_OPEN, disc), np.uint8) if size > 1 else away
        for opening in _round_openings(parted, view):
            away[opening.ellipse.level(*_pixels(away.shape)) < 1.5] = 0
            found.append(opening)
    return sorted(found, key=lambda opening: (opening.ellipse.v, opening.ellipse.u))


@dataclass(frozen=True)
class _View:
    """Every second pixel of a scan: heights over the skin (mm), brightness, what lies on it, what is known of."""

    height: NDArray[np.float32]
    texture: NDArray[np.float32]
    skin: Mask
    known: Mask
    shapes: CircleShapes
    scale: float
    sunk_mm: float


def _pixels(shape: tuple[int, ...]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """u and v of every second pixel."""
    v, u = np.mgrid[: shape[0], : shape[1]]
    return _STRIDE * u, _STRIDE * v


def _round_openings(away: NDArray[np.uint8], view: _View) -> list[Opening]:
    """The connected patches that are circles with nothing at the skin's height inside."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(away, connectivity=4)
    least = max(0.5 * _LEAST_DIAMETER_MM * view.scale, _LEAST_RADIUS_PX) / _STRIDE
    most = 0.5 * _MOST_DIAMETER_MM * view.scale / _STRIDE
    found = []
    for k in range(1, count):
        u0, v0, columns, rows, area = stats[k]
        if not np.pi * least**2 < area < np.pi * most**2 or max(columns, rows) > 3 * most:
            continue
        window = np.s_[v0 : v0 + rows, u0 : u0 + columns]
        opening = _opening(labels[window] == k, window, view)
        if opening is not None:
            found.append(opening)
            away[window][labels[window] == k] = 0
    return found


def _opening(patch: Mask, window: tuple[slice, slice], view: _View) -> Opening | None:
    """What a patch is; None where it is neither round nor far out of the skin."""
    corner = window[1].start, window[0].start
    height = view.height[window]
    proud = patch & (height > view.sunk_mm)
    if proud.sum() > (1 - _EMPTY) * np.isfinite(height[patch]).sum():
        standing = _round_patch(patch, corner, view.shapes, _LONG)
        top = _round_patch(proud, corner, view.shapes, np.inf)
        if standing is not None and _in_skin(view, standing):
            return Opening(top or standing, float(np.median(height[proud])))
    ellipse = _round_patch(patch, corner, view.shapes, _ROUND)
    if ellipse is None or not _in_skin(view, ellipse):
        return None
    inside = height[patch & _core(ellipse, window)]
    seen = inside[np.isfinite(inside)]
    middle = float(np.median(seen)) if len(seen) > (1 - _EMPTY) * len(inside) and len(seen) else None
    if middle is None:
        return Opening(ellipse, None) if brightness(ellipse, view.texture, _STRIDE) < _BRIGHT else None
    dark = brightness(ellipse, view.texture, _STRIDE) < _BRIGHT
    deepest = min(_DARK_SUNK_MM if dark else view.sunk_mm, _SUNK_SHARE * 2 * ellipse.radius / view.scale)
    return Opening(ellipse, middle) if middle < -deepest or middle > view.sunk_mm else None


def brightness(ellipse: Ellipse, texture: NDArray[np.float32], stride: int = 1) -> float:
    """Brightness inside an ellipse as a share of that round it, in every `stride`-th pixel of a picture."""
    reach = int(1.6 * ellipse.a / stride) + 2
    v0, u0 = (max(0, int(c / stride) - reach) for c in (ellipse.v, ellipse.u))
    part = texture[v0 : v0 + 2 * reach + 1, u0 : u0 + 2 * reach + 1]
    v, u = np.mgrid[v0 : v0 + part.shape[0], u0 : u0 + part.shape[1]]
    level = ellipse.level(stride * u, stride * v)
    inside, outside = (
        values[np.isfinite(values)] for values in (part[level < 0.6], part[(level > 1.2) & (level < 1.6)])
    )
    return float(np.median(inside) / np.median(outside)) if len(inside) and len(outside) else 1.0


def _heights(reconstruction: Reconstruction, relief: ReliefMap) -> NDArray[np.float32]:
    """(h/2, w/2) heights over the smoothed skin, mm; NaN without a point."""
    z = reconstruction.points[::_STRIDE, ::_STRIDE, 2]
    smooth = cv2.resize(relief.skin, (z.shape[1], z.shape[0]), interpolation=cv2.INTER_LINEAR)
    return np.asarray((1 / z - smooth) * z**2, np.float32)


def _round_patch(patch: Mask, corner: tuple[int, int], shapes: CircleShapes, longest: float) -> Ellipse | None:
    """The circle on the skin that a patch is, in pixels of the image; None where it is none."""
    v, u = np.nonzero(patch)
    if len(u) < 3:
        return None
    du, dv = u - u.mean(), v - v.mean()
    moments = np.array([[(du * du).mean(), (du * dv).mean()], [(du * dv).mean(), (dv * dv).mean()]])
    if np.linalg.det(moments) <= 0:
        return None
    blob = ellipse_of_shape(0.0, 0.0, 4 * moments)
    if len(u) < _FILLED * np.pi * blob.a * blob.b:
        return None
    centre = _STRIDE * (u.mean() + corner[0]), _STRIDE * (v.mean() + corner[1])
    expected = shapes.ellipse(centre[0], centre[1], _STRIDE * float(np.sqrt(len(u) / np.pi)))
    return expected if np.linalg.norm(log_shape(blob) - log_shape(expected)) < longest else None


def _core(ellipse: Ellipse, window: tuple[slice, slice]) -> Mask:
    """Pixels of a window in the inner half of an ellipse."""
    v, u = np.mgrid[window]
    return np.asarray(ellipse.level(_STRIDE * u, _STRIDE * v) < 0.6)


def _in_skin(view: _View, ellipse: Ellipse) -> bool:
    """Whether skin surrounds a circle; the panel's border and seams are no holes."""
    reach = int(1.6 * ellipse.a / _STRIDE) + 4
    u0, v0 = int(ellipse.u / _STRIDE) - reach, int(ellipse.v / _STRIDE) - reach
    v, u = np.mgrid[v0 : v0 + 2 * reach + 1, u0 : u0 + 2 * reach + 1]
    level = ellipse.level(_STRIDE * u, _STRIDE * v)
    ring = (level > 1 + 4 / ellipse.b) & (level < 1.5 + 4 / ellipse.b)
    on_image = (u >= 0) & (v >= 0) & (u < view.skin.shape[1]) & (v < view.skin.shape[0])
    around = ring & on_image
    known = int(view.known[v[around], u[around]].sum()) + int((ring & ~on_image).sum())
    return known > _KNOWN * ring.sum() and bool(view.skin[v[around], u[around]].sum() > _SURROUNDED * known)
