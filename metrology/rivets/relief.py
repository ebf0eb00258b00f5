"""Heads in the height map: what the cloud says about a ring, and heads that show no ring at all (painted over).

Heights are taken against the skin smoothed over a few head diameters, heads themselves left out. In 1/z a plane is
linear over the (undistorted) image, so smoothing bends nothing; a height is about z² times what 1/z exceeds it by.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array, Float32
from metrology.cloud import PixelFlag, Reconstruction
from metrology.rivets.ellipse import Ellipse, ellipse_of_shape
from metrology.rivets.shapes import CircleShapes, log_shape
from metrology.robust import MAD, from_scratch
from metrology.surfaces import Frame

_REDUCTION = 4  # pixels per cell of the height map
_PLATEAU = 0.7  # area above half the height over area above a fifth of it: 1 for a disc, 0.43 for a Gaussian bump
_SHAPE_TOLERANCE = 0.15  # of the elongation of a blob of few cells
_TEXTURE_STEP = 0.06  # relative brightness step that a painted-over head does not show
_TOP_FROM = 0.45  # of the radius, from which on a head's top is looked at: a recess lies in the middle
_BORDER_CELLS = 0.7  # of a disc's border hold skin, too
_UNEVEN = 0.35  # of its height, by which most of the top's cells depart from a plane: a dent's depart more
_MOST_CELLS = 0.7  # of the top's
_FEWEST_CELLS = 6
_CLEAR_SHARE = 0.5  # of the pixels inside and outside such a head that lie clear of edges in the picture
_ON_PICTURE = 0.7  # of the skin round such a head must lie on the picture
_GOOD_SHARE = 0.9  # of the pixels inside and outside a head that is only seen in the height map
_RECESS_MM, _OFF_MIDDLE = 0.2, 0.3  # below the skin; of the radius
# Of what a rim encloses, 3 px off it: a recess reaches to 0.3 to 0.6 of the radius.
_RECESS_SHARES = (0.15, 0.65)
_LEAST_HEIGHT_MM = 0.04  # of a head that is only seen in the height map
_LEAST_SIGMAS = 8.0  # of a cell's noise
_FAR_MM = 2.0  # from the skin's quadric, or from one cell to the next: no plate, but what lies behind it
_ENOUGH = 3000  # cells to fit that quadric to
_SKIN_SIGMAS = 3.0  # within which of its own scatter about the smoothed skin a cell is skin


@dataclass(frozen=True)
class ReliefMap:
    """Heights over the smoothed skin on cells of 4 × 4 pixels."""

    height: Float32
    """(h/4, w/4) float32: mm, positive towards the rig; NaN where there is no cloud."""
    skin: Float32
    """(h/4, w/4) float32: 1/z of the smoothed skin, 1/mm."""
    noise: float
    """Standard deviation of a cell, mm."""


@dataclass(frozen=True)
class Disc:
    """A disc that lies above or below the skin: a head, or the ground of a hole."""

    ellipse: Ellipse
    height_mm: float
    significance: float


def relief_map(reconstruction: Reconstruction, radius_px: float) -> ReliefMap:
    """Heights against the skin smoothed over `radius_px` times 1.5 (the largest head's radius)."""
    inverse, share = _cells(reconstruction)
    known = share > 0.5
    trusted = known & ~_far_off(inverse, known)
    sigma = 1.5 * radius_px / _REDUCTION
    depth = np.where(known, 1 / np.maximum(inverse, 1e-9), np.nan)
    residual = np.full(inverse.shape, np.nan, np.float32)
    noise, smooth = 0.0, inverse
    # What smoothing cuts off a bent skin is smooth itself: smoothed once more it is what is missing (Tukey's twicing).
    for afresh in (True, True, False, False):
        known_part = inverse if afresh else np.where(known, inverse - smooth, 0).astype(np.float32)
        smoothed = _linear_smooth(known_part, trusted, sigma)
        smooth = smoothed if afresh else smooth + smoothed
        residual = np.where(known, (inverse - smooth) * depth**2, np.nan).astype(np.float32)
        # The median of neighbours' differences: heads and edges are few.
        steps = np.abs(np.diff(residual, axis=1))
        noise = float(MAD * np.nanmedian(steps) / np.sqrt(2)) if np.isfinite(steps).any() else np.inf
        trusted = known & _near_skin(residual, max(4 * noise, 0.01))
    return ReliefMap(residual, smooth.astype(np.float32), noise)


def _far_off(inverse: Float32, known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which cells lie far from the skin's quadric: what is behind the panel would bend its border.

    The quadric is that of the largest part without a jump: another part that is smooth would bend it, too.
    """
    z = np.where(known, 1 / np.maximum(inverse, 1e-9), np.inf)
    whole = known.copy()
    with np.errstate(invalid="ignore"):
        whole[:, 1:] &= ~(np.abs(np.diff(z, axis=1)) > _FAR_MM)
        whole[1:] &= ~(np.abs(np.diff(z, axis=0)) > _FAR_MM)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(whole.astype(np.uint8), connectivity=4)
    if len(stats) < 2:
        return np.zeros_like(known)
    skin = np.flatnonzero(labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])))
    v, u = np.mgrid[0 : inverse.shape[0], 0 : inverse.shape[1]].astype(float)
    u, v = u / inverse.shape[1] - 0.5, v / inverse.shape[0] - 0.5
    design = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)
    some = skin[:: max(1, len(skin) // _ENOUGH)]
    solved = from_scratch(design.reshape(-1, 6)[some], inverse.ravel()[some].astype(float), absolute=5, iterations=10)
    if solved is None:
        return np.zeros_like(known)
    away = np.abs(inverse - design @ solved.values) / np.maximum(inverse, 1e-9) ** 2
    return np.asarray(away > max(_FAR_MM, _SKIN_SIGMAS * MAD * float(np.median(away.ravel()[some]))))


def _near_skin(residual: Float32, least: float) -> NDArray[np.bool_]:
    """Which cells lie on the skin: smoothing cuts off its bends, so that all of it may lie beside zero."""
    if not np.isfinite(residual).any():
        return np.zeros(residual.shape, bool)
    away = np.abs(residual - np.nanmedian(residual))
    return np.asarray(away < max(least, _SKIN_SIGMAS * MAD * float(np.nanmedian(away))))


def _cells(reconstruction: Reconstruction) -> tuple[Float32, Float32]:
    """Mean 1/z of the valid points per cell, and the share of pixels that have one."""
    height, width = reconstruction.points.shape[:2]
    rows, columns = height // _REDUCTION, width // _REDUCTION
    part = np.s_[: rows * _REDUCTION, : columns * _REDUCTION]
    z = reconstruction.points[part][..., 2]
    good = np.isfinite(z) & ((reconstruction.flags[part] & np.uint16(PixelFlag.SLOPE)) == 0)
    inverse = np.where(good, 1 / np.where(good, z, 1), 0).astype(np.float32)
    size = (columns, rows)
    share = cv2.resize(good.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    total = cv2.resize(inverse, size, interpolation=cv2.INTER_AREA)
    return (total / np.maximum(share, 1e-6)).astype(np.float32), share


def _linear_smooth(values: Float32, mask: NDArray[np.bool_], sigma: float) -> NDArray[np.floating]:
    """Local linear regression with Gaussian weights: exact on planes, at borders and round holes too.

    On a grid four times as coarse, since the result changes over `sigma` cells only.
    """
    rows, columns = values.shape
    coarse = max(1, min(4, int(sigma / 3)))
    size = (max(2, columns // coarse), max(2, rows // coarse))
    middle = float(values[mask].mean()) if mask.any() else 0.0
    v, u = np.mgrid[0:rows, 0:columns].astype(np.float32)
    u, v = u / columns - 0.5, v / rows - 0.5
    w = mask.astype(np.float32)
    f = np.where(mask, values - middle, 0).astype(np.float32)
    spread = (sigma * size[0] / columns, sigma * size[1] / rows)

    def gathered(image: Float32) -> Array:
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float64)
        blurred = cv2.GaussianBlur(small, (0, 0), spread[0], sigmaY=spread[1], borderType=cv2.BORDER_CONSTANT)
        return np.asarray(blurred, np.float64)

    m0, mu, mv = gathered(w), gathered(w * u), gathered(w * v)
    muu, muv, mvv = gathered(w * u * u), gathered(w * u * v), gathered(w * v * v)
    t0, tu, tv = gathered(f), gathered(f * u), gathered(f * v)
    y, x = np.mgrid[0 : size[1], 0 : size[0]]
    x, y = (x + 0.5) / size[0] - 0.5 - 0.5 / columns, (y + 0.5) / size[1] - 0.5 - 0.5 / rows
    # Moments about each place itself.
    su, sv = mu - x * m0, mv - y * m0
    suu, svv = muu - 2 * x * mu + x * x * m0, mvv - 2 * y * mv + y * y * m0
    suv = muv - x * mv - y * mu + x * y * m0
    ru, rv = tu - x * t0, tv - y * t0
    det = m0 * (suu * svv - suv**2) - su * (su * svv - suv * sv) + sv * (su * suv - suu * sv)
    top = t0 * (suu * svv - suv**2) - su * (ru * svv - suv * rv) + sv * (ru * suv - suu * rv)
    scale = spread[0] * spread[1] / (size[0] * size[1])
    good = det > 1e-4 * scale**2 * m0**3
    smooth = np.where(good, top / np.where(good, det, 1), np.nan).astype(np.float32)
    return np.asarray(cv2.resize(smooth, (columns, rows), interpolation=cv2.INTER_LINEAR) + middle, float)


def discs(relief: ReliefMap, shapes: CircleShapes, radii: tuple[float, float]) -> list[Disc]:
    """Discs of the size and shape of heads in the height map, whatever the texture shows there.

    Parameters
    ----------
    radii : (least, most)
        Radii looked for, px.
    """
    found = []
    limit = max(_LEAST_SIGMAS * relief.noise, _LEAST_HEIGHT_MM)
    for sign in (1.0, -1.0):
        height = np.nan_to_num(sign * relief.height, nan=0.0)
        count, labels, stats, _ = cv2.connectedComponentsWithStats((height > 0.5 * limit).astype(np.uint8))
        for k in range(1, count):
            u0, v0, columns, rows, area = stats[k]
            if area * _REDUCTION**2 < 2 * radii[0] ** 2 or max(columns, rows) * _REDUCTION > 3 * radii[1]:
                continue
            window = np.s_[v0 : v0 + rows, u0 : u0 + columns]
            head = _disc(height[window], labels[window] == k, (u0, v0), shapes)
            if head is not None and head[1] >= limit and radii[0] <= head[0].radius <= radii[1]:
                ellipse, level = head
                found.append(Disc(ellipse, sign * level, level / relief.noise))
    return _outermost(found)


def _outermost(heads: Sequence[Disc]) -> list[Disc]:
    """The heads that lie in no larger one: a recess is no head."""
    kept: list[Disc] = []
    for head in sorted(heads, key=lambda h: -h.ellipse.radius):
        e = head.ellipse
        if all(np.hypot(e.u - k.ellipse.u, e.v - k.ellipse.v) > k.ellipse.b for k in kept):
            kept.append(head)
    return kept


def _disc(
    height: Array, blob: NDArray[np.bool_], corner: tuple[int, int], shapes: CircleShapes
) -> tuple[Ellipse, float] | None:
    """The disc that a blob is, in pixels, and its height; None where it is none.

    What lies in its middle may be a recess: the border tells.
    """
    outlines, _ = cv2.findContours(blob.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    whole = cv2.drawContours(np.zeros(blob.shape, np.uint8), outlines, -1, 1, cv2.FILLED)
    within = cv2.erode(whole, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    v, u = np.mgrid[0 : height.shape[0], 0 : height.shape[1]].astype(float)
    weight = whole.astype(float)
    level = 0.0
    for _ in range(2):  # the border's cells count by their share, which the height tells, which lies inside the border
        total = weight.sum()
        cu, cv = (weight * u).sum() / total, (weight * v).sum() / total
        radius = np.sqrt(total / np.pi) * _REDUCTION
        centre = [(c + o + 0.5) * _REDUCTION - 0.5 for c, o in ((cu, corner[0]), (cv, corner[1]))]
        expected = shapes.ellipse(centre[0], centre[1], radius)
        away = np.hypot(u - cu, v - cv)
        top = (whole > 0) & (away > _TOP_FROM * radius / _REDUCTION) & (away < radius / _REDUCTION - _BORDER_CELLS)
        level = _flat(u[top] - cu, v[top] - cv, height[top])
        if level <= 0:
            return None
        weight = np.where(within, 1.0, np.where(blob, np.clip(height / level, 0, 1), 0.0))
    if (weight > 0.5).sum() < _PLATEAU * (weight > 0.2).sum():
        return None
    du, dv = u - cu, v - cv
    moments = np.array(
        [[(weight * du * du).sum(), (weight * du * dv).sum()], [(weight * du * dv).sum(), (weight * dv * dv).sum()]]
    )
    # A uniform ellipse has second moments of a quarter of its shape matrix.
    shape = ellipse_of_shape(0.0, 0.0, 4 * moments / weight.sum())
    if abs(shape.radius * _REDUCTION / radius - 1) > _SHAPE_TOLERANCE:
        return None
    if np.linalg.norm(log_shape(shape) - log_shape(expected)) > _SHAPE_TOLERANCE + 1.0 / (radius / _REDUCTION) ** 2:
        return None
    return expected, level


def _flat(u: Array, v: Array, height: Array) -> float:
    """Height of a flat or tilted top, told by the band inside its border; 0 where that is neither."""
    if len(height) < _FEWEST_CELLS:
        return 0.0
    solved = from_scratch(np.stack([np.ones_like(u), u, v], axis=1), height, absolute=4, iterations=8, least=1e-6)
    if solved is None:
        return 0.0
    level = float(solved.values[0])
    off = np.abs(height - solved.values[0] - solved.values[1] * u - solved.values[2] * v)
    return level if np.quantile(off, _MOST_CELLS) < _UNEVEN * level else 0.0


def on_skin(reconstruction: Reconstruction, ellipse: Ellipse) -> bool:
    """Whether points surround a disc and lie inside its border: borders of panels, holes and shadows are steps too.

    Lines of paint across it may take some; most must lie clear of edges.
    """
    reach = int(1.8 * ellipse.a) + 1
    height, width = reconstruction.points.shape[:2]
    u0, v0 = int(ellipse.u) - reach, int(ellipse.v) - reach
    window = np.s_[max(0, v0) : min(height, v0 + 2 * reach + 1), max(0, u0) : min(width, u0 + 2 * reach + 1)]
    flags = reconstruction.flags[window]
    good = np.isfinite(reconstruction.points[window][..., 2]) & ((flags & np.uint16(PixelFlag.SLOPE)) == 0)
    clear = good & ((flags & np.uint16(PixelFlag.EDGE)) == 0)
    v, u = np.mgrid[window]
    level = ellipse.level(u, v)
    sides = (level > 0.5) & (level < 0.8), (level > 1.3) & (level < 1.8)
    if sides[1].sum() < _ON_PICTURE * np.pi * (1.8**2 - 1.3**2) * ellipse.a * ellipse.b:
        return False
    return all(good[side].mean() > _GOOD_SHARE and clear[side].mean() > _CLEAR_SHARE for side in sides)


def shows_in_texture(texture: Float32, ellipse: Ellipse) -> bool:
    """Whether the disc is brighter or darker than what surrounds it: then it is a sticker or a hole."""
    reach = int(1.5 * ellipse.a) + 2
    u0, v0 = max(0, int(ellipse.u) - reach), max(0, int(ellipse.v) - reach)
    part = texture[v0 : int(ellipse.v) + reach + 1, u0 : int(ellipse.u) + reach + 1]
    v, u = np.mgrid[v0 : v0 + part.shape[0], u0 : u0 + part.shape[1]]
    level = ellipse.level(u, v)
    inside, outside = part[level < 0.85], part[(level > 1.15) & (level < 1.45)]
    if inside.size < 9 or outside.size < 9:
        return True
    skin = float(np.median(outside))
    return abs(float(np.median(inside)) - skin) > _TEXTURE_STEP * max(skin, 1e-6)


@dataclass(frozen=True)
class HeadRelief:
    """What the cloud says about a ring."""

    step_mm: float
    """Median height of the inside over the plane of the outside."""
    significance: float
    """Its size over its standard deviation."""
    inner_share: float
    outer_share: float
    """inner_share, outer_share: shares of pixels inside and outside that have a point."""
    recess_share: float = 0.0
    """Share of the points inside that lie as far below the outside as no paint makes them seem to, if about the middle.
    """

    @property
    def recessed(self) -> bool:
        """Whether there is a recess in the middle: paint has none, and of a countersink all is deep."""
        return _RECESS_SHARES[0] < self.recess_share < _RECESS_SHARES[1]


def head_relief(reconstruction: Reconstruction, ellipse: Ellipse) -> HeadRelief:
    """Height of a ring's inside over its outside, simply: a plane outside, a median inside."""
    reach = int(1.8 * ellipse.a) + 2
    height, width = reconstruction.points.shape[:2]
    u0, u1 = max(0, int(ellipse.u) - reach), min(width, int(ellipse.u) + reach + 1)
    v0, v1 = max(0, int(ellipse.v) - reach), min(height, int(ellipse.v) + reach + 1)
    v, u = np.mgrid[v0:v1, u0:u1]
    level = ellipse.level(u, v)
    valid = np.isfinite(reconstruction.points[v0:v1, u0:u1, 2])
    clear = 3 / ellipse.b
    inside, outside = level < max(1 - clear, 0.6), (level > 1 + clear) & (level < 1.8)
    shares = (
        float(valid[inside].mean()) if inside.any() else 0.0,
        float(valid[outside].mean()) if outside.any() else 0.0,
    )
    points = reconstruction.points[v0:v1, u0:u1].astype(float)
    skin, head = points[outside & valid], points[inside & valid]
    if len(skin) < 50 or len(head) < 20:
        return HeadRelief(0.0, 0.0, *shares)
    centre = skin.mean(axis=0)
    _, _, axes = np.linalg.svd(skin - centre, full_matrices=False)
    frame = Frame.on_plane(centre, axes[2])
    above = frame.local(head)[:, 2] - np.median(frame.local(skin)[:, 2])
    step = float(np.median(above))
    spread = MAD * float(np.median(np.abs(frame.local(skin)[:, 2])))
    # Matching correlates neighbours: a median of n points is worth about a quarter of them. Curved skin adds its sag.
    deviation = float(np.hypot(2 * spread * np.sqrt(1 / len(head) + 1 / len(skin)) * 1.25, 0.005))
    deep = above < -_RECESS_MM
    middle = np.array([u[inside & valid][deep].mean(), v[inside & valid][deep].mean()]) if deep.any() else np.zeros(2)
    recess = float(deep.mean()) if ellipse.level(*middle) < _OFF_MIDDLE else 0.0
    return HeadRelief(step, abs(step) / deviation, *shares, recess)
