"""A seam's centre line laid onto the skin: a curve in space with arc length, on which the stations stand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import Reconstruction

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_NODE_STEP_PX = 8.0
_BAND_PX = 16
_MIN_POINTS = 25
_DIRECTION_NODES = 6


@dataclass(frozen=True)
class Track:
    """The centre line on the skin.

    Attributes
    ----------
    s : (n,) ndarray
        Arc length, mm.
    pixels : (n, 2) ndarray
        Left image.
    points : (n, 3) ndarray
        Rig frame, mm.
    directions : (n, 3) ndarray
        Unit tangents.
    width_px : (n,) ndarray
        Of the line in the left image.
    """

    s: Array
    pixels: Array
    points: Array
    directions: Array
    width_px: Array

    @property
    def length_mm(self) -> float:
        """From the first to the last node."""
        return float(self.s[-1])

    def at(self, s: float) -> tuple[Array, Array, Array, float]:
        """Point, unit tangent, pixel and line width at an arc length."""

        def interpolated(values: Array) -> Array:
            return np.array([np.interp(s, self.s, column) for column in values.T])

        direction = interpolated(self.directions)
        return (
            interpolated(self.points),
            direction / np.linalg.norm(direction),
            interpolated(self.pixels),
            float(np.interp(s, self.s, self.width_px)),
        )


def oriented(centre_px: Array) -> Array:
    """The line in its direction of growing arc length: downwards where it is nearer to vertical, else to the right."""
    chord = centre_px[-1] - centre_px[0]
    growing = chord[1] if abs(chord[1]) >= abs(chord[0]) else chord[0]
    return centre_px if growing >= 0 else centre_px[::-1]


def lay_on_skin(
    centre_px: Array, width_px: Array, reconstruction: Reconstruction, usable: Mask, guard_px: float
) -> Track | None:
    """Nodes on the skin along a centre line, or None where the skin beside it was not reconstructed.

    Each node's depth is that of the skin on both sides: over a plane 1/z is affine in the pixel, so 1/z is fitted there
    and evaluated at the node.
    """
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(centre_px, axis=0), axis=1))])
    count = max(2, int(arc[-1] / _NODE_STEP_PX) + 1)
    stops = np.linspace(0, arc[-1], count)
    pixels = np.stack([np.interp(stops, arc, column) for column in centre_px.T], axis=-1)
    known = np.isfinite(width_px)
    width = np.interp(stops, arc[known], width_px[known]) if known.any() else np.full(count, 4.0)
    tangents = np.gradient(pixels, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    depth = np.array(
        [
            _skin_depth(reconstruction.points[..., 2], usable, pixel, tangent, half + guard_px)
            for pixel, tangent, half in zip(pixels, tangents, width / 2, strict=True)
        ]
    )
    good = np.isfinite(depth)
    if good.sum() < 4:
        return None
    # Beyond the last good node the skin is not known; between good nodes it is smooth.
    inside = slice(int(np.argmax(good)), len(good) - int(np.argmax(good[::-1])))
    inverse = np.interp(stops, stops[good], 1.0 / depth[good])
    rays = reconstruction.rig.left.normalized(pixels)
    points = np.concatenate([rays, np.ones((count, 1))], axis=1) / inverse[:, None]
    points, pixels, width = points[inside], pixels[inside], width[inside]
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return Track(s, pixels, points, _directions(s, points), width)


def _skin_depth(z: NDArray[np.float32], usable: Mask, pixel: Array, tangent: Array, inner: float) -> float:
    """Depth of the skin at a node of the line, NaN where too few points lie beside it."""
    reach = int(inner + _BAND_PX + 2)
    u0, v0 = np.round(pixel).astype(int)
    rows = slice(max(0, v0 - reach), max(0, v0 + reach + 1))
    columns = slice(max(0, u0 - reach), max(0, u0 + reach + 1))
    v, u = np.nonzero(usable[rows, columns])
    du, dv = u + columns.start - pixel[0], v + rows.start - pixel[1]
    across = -du * tangent[1] + dv * tangent[0]
    along = du * tangent[0] + dv * tangent[1]
    near = (np.abs(along) < _BAND_PX / 2) & (np.abs(across) > inner) & (np.abs(across) < inner + _BAND_PX)
    sides = near & (across < 0), near & (across > 0)
    if min(side.sum() for side in sides) < _MIN_POINTS:
        return np.nan
    inverse = 1.0 / z[rows, columns][v, u].astype(float)
    estimates = []
    for side in sides:
        design = np.stack([np.ones(side.sum()), across[side], along[side]], axis=-1)
        value = inverse[side]
        keep = np.abs(value - np.median(value)) < 0.01 * np.median(value)
        if keep.sum() < _MIN_POINTS:
            return np.nan
        estimates.append(np.linalg.lstsq(design[keep], value[keep], rcond=None)[0][0])
    return float(2.0 / np.sum(estimates))


def _directions(s: Array, points: Array) -> Array:
    """Unit tangents by a quadratic through the neighbouring nodes."""
    tangents = np.empty_like(points)
    for i in range(len(s)):
        window = slice(max(0, i - _DIRECTION_NODES), i + _DIRECTION_NODES + 1)
        order = min(2, len(s[window]) - 1)
        tangents[i] = np.polyfit(s[window] - s[i], points[window], order)[-2]
    return np.asarray(tangents / np.linalg.norm(tangents, axis=1, keepdims=True))
