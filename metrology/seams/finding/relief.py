"""What the 3-D data say about a line in the image: a groove, a step, both, or nothing (a scratch, paint, a shadow).

The line's surroundings are cut into short pieces. In each, both sides of skin are fitted at once: over a plane 1/z is
affine in the pixel, so ``1/z = (offset of the side) + b x + c y + d x²`` with slopes and curvature common to both.
The offsets differ by the step along the ray, ``Δz = −z² Δ(1/z)``. What lies between the sides is deeper (a groove),
nearer (a cable, a decal), or in the skin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array, Mask
from metrology.cloud import PixelFlag, Reconstruction
from metrology.robust import MAD
from metrology.seams.finding.medians import row_medians
from metrology.seams.finding.shade import black_level, projected_share
from metrology.seams.finding.strip import Strip
from metrology.seams.settings import SeamSettings

# Places are 1 px apart across and this much along; so many rows make a piece, which is about 5 mm long.
_STEP_PX = 2.0
_PIECE_ROWS = 12
# No more pieces than this are looked at: shares to better than a tenth; a first look is content with half of them.
MOST_PIECES = 40
# Skin beside the line: 6 mm on each side tell a step from curvature.
SKIN_PX = 30.0
_MIN_SIDE_PLACES = 40
# Skins on both sides of a seam belong together: no farther apart than this.
_MAX_STEP_MM = 4.0
# A place without a point is in a gap's shadow if it is this dark compared with the skin, and counts as this deep, mm.
_SHADOW = 0.5
_SHADOW_DEPTH_MM = 1.0
# The middle of a band is looked at over at least this half-width, px, however narrow the band is.
_LEAST_HALF_PX = 1.0
# A band narrower than this has no points of its own; it is a gap where this much less of the projector's light comes
# back than from paint (paint and scratches stay within 0.01 of 1, gaps are at 0.95 and less: simulated scans).
_NARROW_PX = 5.0
_LIT_SHARE = 0.97
_SATURATED = np.uint16(PixelFlag.SATURATED | PixelFlag.SATURATED_SAMPLES)
# A seam shows relief over most of its length, and has skin on both sides over most of it.
_RELIEF_SHARE = 0.6
_SKIN_SHARE = 0.5
_FEWEST_PIECES = 3
# Share of the places in a band with a point, for its ground to be seen.
_SEEN = 0.5
# A piece's step and depth count from so many standard deviations on. Of many pieces most must agree, so that depth may
# be content with less than step, which slow changes of the skin imitate.
_STEP_SIGMAS = 4.0
_DEPTH_SIGMAS = 2.0
# Standard deviation of a median over that of a mean, and how much slower than independent ones neighbouring points,
# which share pixels of the matched phase, average out.
_MEDIAN = 1.25
_CORRELATION = 1.4
_ROUNDS = 3
_CLIP_SIGMAS = 4.0


@dataclass(frozen=True)
class Relief:
    """What was found along a line."""

    skin_share: float = 0.0
    """Share of pieces with skin on both sides."""
    groove_share: float = 0.0
    raised_share: float = 0.0
    """groove_share, raised_share: share of those with a groove; with something that stands out of the skin."""
    step_mm: float = 0.0
    """Median of the step."""
    step_share: float = 0.0
    """Share of those with a step of that sign beyond noise and the least step asked for."""
    shallow_share: float = 0.0
    """Share of those whose ground has points and lies less than half the line's width below both skins."""

    @property
    def between_skins(self) -> bool:
        """Whether both sides are skin: not the panel's own border, nor that of the projected field."""
        return self.skin_share >= _SKIN_SHARE

    @property
    def is_groove(self) -> bool:
        """Whether it lies deeper than both skins."""
        return self.groove_share >= _RELIEF_SHARE

    @property
    def is_shallow_groove(self) -> bool:
        """Whether it may be cut into one skin: no step, and a ground to which slopes of 45° lead down."""
        return self.step_share < _RELIEF_SHARE and self.shallow_share >= _RELIEF_SHARE

    @property
    def share(self) -> float:
        """Share of the length over which there is relief."""
        return max(self.groove_share, self.step_share)

    @property
    def is_seam(self) -> bool:
        """Whether the line is a groove or a step of the skin."""
        return self.between_skins and self.share >= _RELIEF_SHARE and self.raised_share < self.share


def examine_relief(
    points: Array, width_px: float, reconstruction: Reconstruction, usable: Mask, settings: SeamSettings,
    most_pieces: int = MOST_PIECES,
) -> Relief:  # fmt: skip
    """Look at the points on both sides of a line and between them.

    Parameters
    ----------
    points : (n, 2) ndarray
        u, v along the line.
    width_px : float
        The line's.
    usable : (h, w) ndarray of bool
        Pixels with a point, off the rivets.
    most_pieces : int
        So many pieces of the line, evenly spread, are looked at.
    """
    beside = _beside(points, width_px / 2 + settings.guard_px, reconstruction, usable, most_pieces)
    if isinstance(beside, float):
        return Relief(beside)
    pieces, skin, inverse, sides, joined = beside.pieces, beside.skin, beside.inverse, beside.sides, beside.joined
    texture = reconstruction.left.texture[pieces.v, pieces.u].astype(float)
    half = max(width_px / 2 - settings.guard_px, _LEAST_HALF_PX)
    depth, depth_sigma, seen = _depth(pieces, half, sides.at_places(pieces, inverse), texture, skin, sides)
    least_depth = np.maximum(settings.min_groove_mm, _DEPTH_SIGMAS * depth_sigma)
    if width_px < _NARROW_PX:
        modulation = reconstruction.left.modulation[pieces.v, pieces.u].astype(float)
        black = black_level(reconstruction.left)
        middle = np.abs(pieces.x) < 0.5
        lit = projected_share(texture, modulation, middle, skin, black)
        # A bright line that is saturated has lost a part of its fringes.
        saturated = (reconstruction.left.flags[pieces.v, pieces.u] & _SATURATED)[:, middle].any(axis=1)
        bright = saturated & (row_medians(texture, middle) > row_medians(texture, skin))
        stands_out = (seen >= _SEEN) & (depth < -least_depth)  # thick paint, whose own points say so
        depth = np.where((lit < _LIT_SHARE) & ~bright & ~stands_out, _SHADOW_DEPTH_MM, depth)
    depth_limit = least_depth[joined]
    step_limit = np.maximum(settings.min_step_mm, _STEP_SIGMAS * sides.sigma_mm)[joined]
    width_mm = width_px / reconstruction.rig.left.K[0, 0] / row_medians(inverse, skin)[joined]
    shallow = (seen[joined] >= _SEEN) & (depth[joined] < 0.5 * width_mm)
    step, depth = sides.step_mm[joined], depth[joined]
    median = float(np.median(step))
    return Relief(
        skin_share=beside.skin_share,
        groove_share=float((depth > depth_limit).mean()),
        raised_share=float((depth < -depth_limit).mean()),
        step_mm=median,
        step_share=float((step * np.sign(median) > step_limit).mean()),
        shallow_share=float(shallow.mean()),
    )


@dataclass(frozen=True)
class SkinProfile:
    """The median section across a line: heights above the middle of both skins, towards the camera."""

    x: Array
    """(m,) px across the line, in order."""
    height_mm: Array
    """(m,) NaN where no point is seen."""
    step_mm: float
    """Between the skins beyond, along the ray."""


def skin_profile(points: Array, inner_px: float, reconstruction: Reconstruction, usable: Mask) -> SkinProfile | None:
    """The section across a line between skins that begin `inner_px` beside it; None where they are not seen.

    Parameters
    ----------
    points : (n, 2) ndarray
        u, v along the line.
    usable : (h, w) ndarray of bool
        Pixels with a point, off the rivets.
    """
    beside = _beside(points, inner_px, reconstruction, usable, MOST_PIECES)
    if isinstance(beside, float):
        return None
    pieces, sides = beside.pieces, beside.sides
    between = np.abs(pieces.x) <= inner_px
    x, y = pieces.x[between], pieces.y[between]
    coefficients = sides.coefficients
    fitted = coefficients[:, :2].mean(axis=1)[:, None] + coefficients[:, 2:] @ _design(x, y)[:, 2:].T
    height = (1.0 / fitted - 1.0 / beside.inverse[:, between])[beside.joined]
    places = np.unique(x)
    columns = np.array([height[:, x == place].ravel() for place in places])
    return SkinProfile(
        places, row_medians(columns, np.isfinite(columns)), float(np.median(sides.step_mm[beside.joined]))
    )


@dataclass(frozen=True)
class _Beside:
    """Pieces of a line with skin on both sides, and the fit to those sides."""

    pieces: _Pieces
    skin: Mask
    """(p, n) of bool: points of the sides."""
    inverse: Array
    """(p, n) 1/z; NaN without a point."""
    sides: _Sides
    joined: Mask
    """(p,) of bool: both sides may be skins that belong together."""
    skin_share: float


def _beside(
    points: Array, inner: float, reconstruction: Reconstruction, usable: Mask, most_pieces: int
) -> _Beside | float:
    """Both sides of a line from `inner` px on; the share of pieces that have them if it is too low."""
    pieces = _Pieces.along(points, inner + SKIN_PX, usable.shape, most_pieces)
    if pieces is None:
        return 0.0
    beside = pieces.inside & (np.abs(pieces.x) > inner)
    dark = (reconstruction.flags[pieces.v, pieces.u] & np.uint16(PixelFlag.LOW_MODULATION)) != 0
    skin = beside & usable[pieces.v, pieces.u]
    both, evident = _evidence(pieces.x, skin, beside & ~skin & ~dark)
    if both.sum() < max(_FEWEST_PIECES, _SKIN_SHARE * evident.sum()):
        return float(both.sum() / max(evident.sum(), _FEWEST_PIECES))
    pieces, skin = pieces.some(both), skin[both]
    inverse = 1.0 / np.where(pieces.inside, reconstruction.points[pieces.v, pieces.u, 2], np.nan).astype(float)
    sides = _fit_sides(pieces, inverse, skin)
    joined = np.abs(sides.step_mm) < _MAX_STEP_MM
    share = float(joined.sum() / evident.sum())
    return _Beside(pieces, skin, inverse, sides, joined, share) if share >= _SKIN_SHARE else share


@dataclass(frozen=True)
class _Pieces:
    """A line's surroundings in pieces: p pieces of the same n places."""

    x: Array
    y: Array
    """x, y: (n,): places across and along the line, from a piece's middle, px."""
    v: NDArray[np.intp]
    u: NDArray[np.intp]
    """v, u: (p, n) of int: their pixels."""
    beside_x: Array
    beside_y: Array
    """beside_x, beside_y: (p, n): how far those lie from the places. All rows of a piece may round alike, and on a
    tilted panel half a pixel is 0.02 mm of depth."""
    inside: Mask
    """(p, n) of bool: whether they lie in the image."""

    @classmethod
    def along(cls, points: Array, reach_px: float, shape: tuple[int, ...], most: int) -> _Pieces | None:
        """Pieces evenly spread along a polyline; None if it is shorter than one."""
        strip = Strip.along(points, reach_px, _STEP_PX)
        count = len(strip.line) // _PIECE_ROWS
        if count == 0:
            return None
        chosen = np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))
        rows = (chosen[:, None] * _PIECE_ROWS + np.arange(_PIECE_ROWS)).ravel()
        strip = strip.rows(rows)
        v, u, inside = strip.pixels(shape)
        off_u, off_v = u - strip.u, v - strip.v
        normal_u, normal_v = strip.normals[:, :1], strip.normals[:, 1:]
        # Along the line is the normal turned back from v towards u.
        beside_x, beside_y = off_u * normal_u + off_v * normal_v, off_u * normal_v - off_v * normal_u
        x = np.tile(strip.x, _PIECE_ROWS)
        y = np.repeat(_STEP_PX * (np.arange(_PIECE_ROWS) - (_PIECE_ROWS - 1) / 2), len(strip.x))
        size = (len(chosen), -1)
        offsets = beside_x.reshape(size), beside_y.reshape(size)
        return cls(x, y, v.reshape(size), u.reshape(size), *offsets, inside.reshape(size))

    def some(self, which: Mask) -> _Pieces:
        """Some of the pieces."""
        offsets = self.beside_x[which], self.beside_y[which]
        return _Pieces(self.x, self.y, self.v[which], self.u[which], *offsets, self.inside[which])


def _evidence(x: Array, skin: Mask, dazzled: Mask) -> tuple[Mask, Mask]:
    """Pieces with skin on both sides, and pieces that tell whether there is: not those where one side is lit and yet
    has no good points, as a highlight in either camera makes it."""
    enough, hidden = [], []
    for side in (x < 0, x > 0):
        enough.append(skin[:, side].sum(axis=1) >= _MIN_SIDE_PLACES)
        hidden.append(dazzled[:, side].sum(axis=1) >= _MIN_SIDE_PLACES)
    both = enough[0] & enough[1]
    return both, both | (enough[0] | ~hidden[0]) & (enough[1] | ~hidden[1])


@dataclass(frozen=True)
class _Sides:
    """Both sides of each piece: (p, 5) coefficients of 1/z; step, its σ, and the points' scatter about the fit (p,)."""

    coefficients: Array
    step_mm: Array
    sigma_mm: Array
    spread_mm: Array

    def at_places(self, pieces: _Pieces, inverse: Array) -> Array:
        """(p, n) 1/z at the places themselves, from what their pixels have."""
        return _moved(pieces, inverse, self.coefficients[:, 2], self.coefficients[:, 3])


def _moved(pieces: _Pieces, inverse: Array, across: Array, along: Array) -> Array:
    """1/z (p, n) of pixels carried to their places by the slopes (p,) of 1/z."""
    return inverse - across[:, None] * pieces.beside_x - along[:, None] * pieces.beside_y


def _design(x: Array, y: Array) -> Array:
    """(n, 5) derivatives of 1/z by the offsets of both sides, b, c and d."""
    return np.stack([x < 0, x > 0, x, y, x * x], axis=-1).astype(float)


def _fit_sides(pieces: _Pieces, inverse: Array, skin: Mask) -> _Sides:
    """Least squares in all pieces at once, outliers clipped."""
    x, y = pieces.x, pieces.y
    # In units of the strip's half-width the normal equations are well conditioned.
    unit = np.array([1.0, 1.0, 1 / x.max(), 1 / x.max(), 1 / x.max() ** 2])
    design = _design(x, y) * unit
    products = (design[:, :, None] * design[:, None, :]).reshape(len(x), 25)
    depth = 1.0 / row_medians(inverse, skin)
    inverse = np.where(skin, inverse, 0.0)
    at_places, keep = inverse, skin.astype(float)
    for _ in range(_ROUNDS):
        normal = (keep @ products).reshape(-1, 5, 5) + 1e-9 * np.eye(5)
        solution = np.linalg.solve(normal, ((keep * at_places) @ design)[..., None])[..., 0]
        at_places = _moved(pieces, inverse, solution[:, 2] * unit[2], solution[:, 3] * unit[3])
        residual = np.abs(at_places - solution @ design.T)
        spread = MAD * row_medians(residual, keep > 0) + 1e-12
        clipped = skin & (residual < _CLIP_SIGMAS * spread[:, None])
        # A side that the clipping would empty is kept: its step is too large for one common fit to begin with.
        enough = np.minimum(clipped[:, x < 0].sum(axis=1), clipped[:, x > 0].sum(axis=1)) >= _MIN_SIDE_PLACES // 2
        keep = np.where(enough[:, None], clipped, keep)
    covariance = np.linalg.inv(normal)
    variance = covariance[:, 0, 0] + covariance[:, 1, 1] - 2 * covariance[:, 0, 1]
    step = depth**2 * (solution[:, 1] - solution[:, 0])
    spread_mm = depth**2 * spread
    return _Sides(solution * unit, step, spread_mm * _CORRELATION * np.sqrt(variance), spread_mm)


def _depth(
    pieces: _Pieces, half_px: float, inverse: Array, texture: Array, skin: Mask, sides: _Sides
) -> tuple[Array, Array, Array]:
    """Median depth below both skins (p,) of the places in the band, negative above both, 0 in between; its σ; and the
    share of places with a point.
    """
    brightness = row_medians(texture, skin)
    between = np.abs(pieces.x) <= half_px
    x, y, texture = pieces.x[between], pieces.y[between], texture[:, between]
    z = 1.0 / inverse[:, between]
    offsets, rest = sides.coefficients[:, :2], sides.coefficients[:, 2:] @ _design(x, y)[:, 2:].T
    far, near = 1.0 / (offsets.min(axis=1)[:, None] + rest), 1.0 / (offsets.max(axis=1)[:, None] + rest)
    depth = np.maximum(z - far, 0.0) + np.minimum(z - near, 0.0)
    shadow = ~np.isfinite(z) & (texture < _SHADOW * brightness[:, None])
    seen = np.isfinite(z).mean(axis=1)
    depth = np.where(shadow, _SHADOW_DEPTH_MM, depth)
    known = np.isfinite(depth)
    sigma = sides.spread_mm * _MEDIAN * _CORRELATION / np.sqrt(np.maximum(known.sum(axis=1), 1))
    return np.nan_to_num(row_medians(depth, known)), sigma, seen
