"""A seam's centre line laid onto the skin: a curve in space with arc length, on which the stations stand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array, Mask
from metrology.cloud import Reconstruction
from metrology.seams.polyline import arc_length, normals, resample

# Nodes of the curve, px apart.
_NODE_STEP_PX = 8.0
# Skin beside a node, px wide (3 mm: flat) and as long as two nodes are apart; so many points make its depth as good as
# the points' noise.
_BAND_PX = 16
_MIN_POINTS = 25
# The direction at a node is that of a parabola through so many neighbours on each side, ±10 mm.
_DIRECTION_NODES = 6
_FEWEST_NODES = 4
# Points whose depth differs by more than this share (7 mm) are of something else.
_SAME_SKIN = 0.01
_UNKNOWN_WIDTH_PX = 4.0


@dataclass(frozen=True)
class Track:
    """The centre line on the skin."""

    s: Array
    """(n,): arc length, mm."""
    pixels: Array
    """(n, 2): left image."""
    points: Array
    """(n, 3): rig frame, mm."""
    directions: Array
    """(n, 3): unit tangents."""
    width_px: Array
    """(n,): of the line in the left image."""

    @property
    def length_mm(self) -> float:
        """From the first to the last node."""
        return float(self.s[-1])

    def at(self, s: Array) -> tuple[Array, Array, Array, Array]:
        """Points (n, 3), unit tangents (n, 3), pixels (n, 2) and line widths (n,) at arc lengths."""

        def interpolated(values: Array) -> Array:
            return np.stack([np.interp(s, self.s, column) for column in values.T], axis=-1)

        directions = interpolated(self.directions)
        return (
            interpolated(self.points),
            directions / np.linalg.norm(directions, axis=1, keepdims=True),
            interpolated(self.pixels),
            np.interp(s, self.s, self.width_px),
        )


def lay_on_skin(
    centre_px: Array, width_px: Array, reconstruction: Reconstruction, usable: Mask, guard_px: float
) -> Track | None:
    """Nodes on the skin along a centre line, or None where the skin beside it was not reconstructed.

    Each node's depth is that of the skin on both sides: over a plane 1/z is affine in the pixel, so 1/z is fitted there
    and evaluated at the node.
    """
    pixels = resample(centre_px, _NODE_STEP_PX)
    stops, arc = arc_length(pixels), arc_length(centre_px)
    known = np.isfinite(width_px)
    width = np.interp(stops, arc[known], width_px[known]) if known.any() else np.full(len(stops), _UNKNOWN_WIDTH_PX)
    inverse = _skin_inverse_depth(pixels, width / 2 + guard_px, reconstruction.points[..., 2], usable)
    good = np.isfinite(inverse)
    if good.sum() < _FEWEST_NODES:
        return None
    # Beyond the last good node the skin is not known; between good nodes it is smooth.
    inside = slice(int(np.argmax(good)), len(good) - int(np.argmax(good[::-1])))
    inverse = np.interp(stops, stops[good], inverse[good])
    rays = reconstruction.rig.left.normalized(pixels)
    points = np.concatenate([rays, np.ones((len(pixels), 1))], axis=1) / inverse[:, None]
    points, pixels, width = points[inside], pixels[inside], width[inside]
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return Track(s, pixels, points, _directions(s, points), width)


def _skin_inverse_depth(nodes: Array, inner: Array, z: NDArray[np.float32], usable: Mask) -> Array:
    """1/z of the skin at nodes (n, 2), from what lies beyond `inner` (n,) px on each side; NaN without skin."""
    along = normals(nodes)
    y = np.arange(-_BAND_PX / 2, _BAND_PX / 2 + 1)
    result = np.zeros(len(nodes))
    for side in (-1.0, 1.0):
        x = side * (inner[:, None] + np.arange(1.0, _BAND_PX + 1))
        # Places (node, along, across) and their pixels: the tangent is the normal turned back from v towards u.
        u = nodes[:, 0, None, None] + x[:, None] * along[:, 0, None, None] + y[:, None] * along[:, 1, None, None]
        v = nodes[:, 1, None, None] + x[:, None] * along[:, 1, None, None] - y[:, None] * along[:, 0, None, None]
        rows, columns = np.rint(v).astype(int), np.rint(u).astype(int)
        seen = (rows >= 0) & (rows < z.shape[0]) & (columns >= 0) & (columns < z.shape[1])
        # Points are taken where they lie: half a pixel beside it is 0.02 mm of depth on a tilted panel.
        du, dv = columns - nodes[:, 0, None, None], rows - nodes[:, 1, None, None]
        across = du * along[:, 0, None, None] + dv * along[:, 1, None, None]
        lengthwise = du * along[:, 1, None, None] - dv * along[:, 0, None, None]
        rows, columns = np.clip(rows, 0, z.shape[0] - 1), np.clip(columns, 0, z.shape[1] - 1)
        skin = (seen & usable[rows, columns]).reshape(len(nodes), -1)
        inverse = 1.0 / np.where(skin, z[rows, columns].reshape(len(nodes), -1).astype(float), np.nan)
        result += 0.5 * _at_origin(across.reshape(skin.shape), lengthwise.reshape(skin.shape), inverse, skin)
    return result


def _at_origin(x: Array, y: Array, values: Array, known: Mask) -> Array:
    """Value at (0, 0) of the plane through each row's known values; NaN where they are too few."""
    result = np.full(len(values), np.nan)
    rows = np.flatnonzero(known.sum(axis=1) >= _MIN_POINTS)
    x, y, values, known = x[rows], y[rows], values[rows], known[rows]
    median = np.nanmedian(values, axis=1)[:, None]
    with np.errstate(invalid="ignore"):
        near = (known & (np.abs(values - median) < _SAME_SKIN * median)).astype(float)
    values = np.where(known, values, 0.0)
    design = (np.ones_like(x), x, y)
    normal = np.array([[np.sum(near * a * b, axis=1) for a in design] for b in design]).transpose(2, 0, 1)
    right = np.array([np.sum(near * a * values, axis=1) for a in design]).T
    good = near.sum(axis=1) >= _MIN_POINTS
    result[rows[good]] = np.linalg.solve(normal[good], right[good][..., None])[:, 0, 0]
    return result


def _directions(s: Array, points: Array) -> Array:
    """Unit tangents: slope of the parabola through the neighbouring nodes."""
    count = min(2 * _DIRECTION_NODES + 1, len(s))
    first = np.clip(np.arange(len(s)) - count // 2, 0, len(s) - count)
    window = first[:, None] + np.arange(count)
    d = s[window] - s[:, None]
    design = np.stack([np.ones_like(d), d, d * d], axis=-1)
    tangents = np.linalg.pinv(design)[:, 1:2] @ points[window]
    return np.asarray(tangents[:, 0] / np.linalg.norm(tangents[:, 0], axis=1, keepdims=True))
