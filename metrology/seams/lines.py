"""Lines in one image: Steger's line points at several scales, straight pieces, joined and refined (paper §3.2).

A band of width w answers most at a scale of about w/2; the image is reduced two, four and more times so that one small
filter finds bands of all widths. What is found so is refined in the full image by fitting the band's two borders
(`bands`), whose middle is free of the bias that unequal brightness on both sides gives Steger's points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrology.ridges import bar_curvature, curvature_noise, ridge_points
from metrology.seams.bands import fit_bands
from metrology.seams.blur import EdgeResponse, PixelBlur
from metrology.seams.linking import link
from metrology.seams.sampling import LocalMap, binned, sample
from metrology.seams.segments import join_pieces, straight_pieces
from metrology.seams.settings import LineSettings

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]

# Scale of the filter on each reduced image, px of it.
_SIGMA = 1.5
# Local brightness is the mean over about this many px.
_BACKGROUND_PX = 160
# Ratio of the low threshold to the high one.
_HYSTERESIS = 0.4
# Nodes of the refined line, px apart, and how far along the line each one looks.
_NODE_STEP_PX = 6.0
_NODE_HALF_PX = 9.0
# Half a window across, in line widths and px.
_REACH_WIDTHS = 1.0
_REACH_PX = 7.0
# Bands nearer to each other than this share a border, px.
_TOUCH_PX = 4.0
_BLUR = PixelBlur(lens_px=0.6, spill=0.0)
# Pixels are binned across the line; fewer of them tell nothing.
_BIN_PX = 0.25
_MIN_PIXELS = 60
# The refined line is smoothed over this length, px.
_SMOOTH_PX = 14.0


@dataclass(frozen=True)
class ImageLine:
    """A dark or bright line in an image.

    Attributes
    ----------
    centre_px : (n, 2) ndarray
        u, v of the middle between both borders, every pixel or so.
    width_px : (n,) ndarray
        Between the borders, NaN where they could not be told.
    contrast : float
        Brightness of the band relative to its surroundings, less one: negative for a dark line.
    support : float
        Share of the line's length over which it is there, 0 … 1.
    """

    centre_px: Array
    width_px: Array
    contrast: float
    support: float

    @property
    def length_px(self) -> float:
        """Along the line."""
        return polyline_length(self.centre_px)


@dataclass(frozen=True)
class _Candidate:
    """A chain of line points at full resolution, with what it says about the band's width and contrast."""

    points: Array
    width_px: float
    response: float


def polyline_length(points: Array) -> float:
    """Length of a polyline (n, 2)."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def resample(points: Array, step: float) -> Array:
    """Points every `step` along a polyline (n, k); u, v are the first two columns."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points[:, :2], axis=0), axis=1))])
    stops = np.linspace(0, arc[-1], max(2, round(arc[-1] / step) + 1))
    return np.stack([np.interp(stops, arc, column) for column in points.T], axis=-1)


def relative_brightness(texture: ArrayLike) -> Float32:
    """(h, w) texture over its local mean: exposure-fused scans span orders of magnitude, lines stand out by ratio."""
    grey = np.nan_to_num(np.asarray(texture, np.float32))
    small = cv2.resize(grey, None, fx=0.125, fy=0.125, interpolation=cv2.INTER_AREA)
    size = max(3, (_BACKGROUND_PX // 8) | 1)
    mean = cv2.blur(small, (size, size), borderType=cv2.BORDER_REFLECT)
    floor = 0.02 * float(np.percentile(small, 95)) + 1e-6
    background = cv2.resize(np.maximum(mean, floor), grey.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(np.clip(grey / background, 0.0, 3.0), np.float32)


def detect_lines(texture: ArrayLike, settings: LineSettings | None = None) -> list[ImageLine]:
    """Dark and bright lines of an image, longest first.

    Parameters
    ----------
    texture : (h, w) array
        Grey levels.
    settings : LineSettings, optional
    """
    settings = settings or LineSettings()
    relative = relative_brightness(texture)
    candidates: list[_Candidate] = []
    for level in range(1, settings.coarsest_level + 1):
        candidates += _candidates(relative, level, settings)
    candidates.sort(key=lambda c: -c.response * polyline_length(c.points[:, :2]))
    lines: list[ImageLine] = []
    for candidate in candidates:
        rest = _uncovered(candidate, lines, settings.min_length_px)
        refined = _refined(relative, rest, candidate.width_px, settings) if rest is not None else None
        if refined is not None and not _shares_border(refined, lines):
            lines.append(refined)
    return sorted(lines, key=lambda line: -line.length_px)


def _candidates(relative: Float32, level: int, settings: LineSettings) -> list[_Candidate]:
    """Lines at one scale."""
    factor = 2**level
    reduced = cv2.resize(relative, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
    # The weakest line sought: a bar of the width that answers most at this scale.
    faintest = bar_curvature(2 * _SIGMA, settings.min_contrast, _SIGMA)
    found = []
    for polarity in ("dark", "bright"):
        noise = _grain(np.asarray(reduced, np.float32)) * curvature_noise(_SIGMA)
        high = max(faintest, settings.noise_sigmas * noise)
        ridges = ridge_points(reduced, _SIGMA, _HYSTERESIS * high, polarity)
        chains = link(ridges, high, 6)
        generator = np.random.default_rng(settings.seed)
        pieces = [
            piece
            for chain in chains
            for piece in straight_pieces(
                chain, settings.straightness_px / factor + 0.3, settings.min_segment_px / factor, generator
            )
        ]
        joined = join_pieces(
            pieces,
            settings.max_gap_px / factor,
            2.0 + settings.straightness_px / factor,
            np.deg2rad(settings.max_bend_deg),
        )
        for line in joined:
            points = line.copy()
            points[:, :2] = (line[:, :2] + 0.5) * factor - 0.5
            if polyline_length(points[:, :2]) >= settings.min_length_px:
                response = float(np.median(line[:, 2])) * _SIGMA**2
                found.append(_Candidate(points, 2 * _SIGMA * factor, response))
    return found


def _grain(image: Float32) -> float:
    """Standard deviation of the pixel-to-pixel noise, from differences, robust."""
    d = image[1:, 1:] - image[:-1, 1:] - image[1:, :-1] + image[:-1, :-1]
    return 1.4826 * float(np.median(np.abs(d))) / 2.0


def _uncovered(candidate: _Candidate, lines: Sequence[ImageLine], min_length: float) -> Array | None:
    """The candidate's longest part that no line found so far accounts for, if it is long enough."""
    points = resample(candidate.points[:, :2], 2.0)
    free = np.ones(len(points), bool)
    for line in lines:
        width = np.nanmedian(line.width_px) if np.isfinite(line.width_px).any() else 4.0
        reach = 0.5 * width + candidate.width_px + 3.0
        distance = np.sqrt(((points[:, None] - line.centre_px[None, ::4]) ** 2).sum(-1).min(axis=1))
        free &= distance > reach
    if free.mean() > 0.9:
        return points
    borders = np.flatnonzero(np.concatenate([[True], ~free, [True]]))
    k = int(np.diff(borders).argmax())
    part = points[borders[k] : borders[k + 1] - 1]
    return part if len(part) > 2 and polyline_length(part) >= min_length else None


def _shares_border(line: ImageLine, lines: Sequence[ImageLine]) -> bool:
    """Whether a line is only the strip beside another one, which ends where that one begins."""
    for other in lines:
        reach = 0.5 * (np.nanmedian(line.width_px) + np.nanmedian(other.width_px)) + _TOUCH_PX
        distance = np.sqrt(((line.centre_px[::8, None] - other.centre_px[None, ::4]) ** 2).sum(-1).min(axis=1))
        if (distance < reach).mean() > 0.5:
            return True
    return False


def _refined(relative: Float32, points: Array, width_px: float, settings: LineSettings) -> ImageLine | None:
    """Both borders fitted at nodes along the line, and the smooth middle between them."""
    centre, width = points, width_px
    offsets = widths = contrasts = np.empty(0)
    for _ in range(2):
        nodes = resample(_smoothed(centre), max(_NODE_STEP_PX, width / 2))
        tangents = np.gradient(nodes, axis=0)
        tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
        normals = np.stack([-tangents[:, 1], tangents[:, 0]], axis=-1)
        fits = np.array([_borders(relative, node, normal, width) for node, normal in zip(nodes, normals, strict=True)])
        offsets, widths, contrasts = fits.T
        good = _consistent(offsets, widths, contrasts)
        if good.sum() < max(4, 0.3 * len(nodes)):
            return None
        index = np.arange(len(nodes))
        centre = nodes + normals * np.interp(index, index[good], offsets[good])[:, None]
        width = float(np.median(widths[good]))
    contrast = float(np.median(contrasts[good]))
    if abs(contrast) < settings.min_contrast:
        return None
    first, last = np.flatnonzero(good)[[0, -1]]
    centre, widths = centre[first : last + 1], np.where(good, widths, np.nan)[first : last + 1]
    if polyline_length(centre) < settings.min_length_px:
        return None
    dense = resample(np.column_stack([_smoothed(centre), np.arange(len(centre))]), 1.0)
    node_width = np.interp(dense[:, 2], np.flatnonzero(np.isfinite(widths)), widths[np.isfinite(widths)])
    return ImageLine(dense[:, :2], node_width, contrast, float(good[first : last + 1].mean()))


def _borders(relative: Float32, node: Array, normal: Array, width: float) -> tuple[float, float, float]:
    """Offset of the band's middle along the normal, its width and contrast; NaN where it is not there."""
    reach = (0.5 + _REACH_WIDTHS) * width + _REACH_PX
    local = LocalMap.in_image(node, normal)
    x, _, grey = sample(relative, local, -reach, reach, _NODE_HALF_PX)
    if len(x) < _MIN_PIXELS:
        return np.nan, np.nan, np.nan
    x, grey, counts = binned(x, grey, _BIN_PX)
    fit = fit_bands(x, grey, [-width / 2, width / 2], EdgeResponse.along(local.gradient, _BLUR), counts=counts)
    if fit is None:
        return np.nan, np.nan, np.nan
    outside = 0.5 * (fit.levels[0] + fit.levels[2])
    contrast = fit.levels[1] / outside - 1.0 if outside > 0 else np.nan
    return float(fit.edges.mean()), float(fit.edges[1] - fit.edges[0]), float(contrast)


def _consistent(offsets: Array, widths: Array, contrasts: Array) -> NDArray[np.bool_]:
    """Nodes whose borders agree with their neighbours'."""
    good = np.isfinite(offsets) & np.isfinite(contrasts)
    if not good.any():
        return good
    sign = np.sign(np.median(contrasts[good]))
    good &= (contrasts * sign > 0.3 * np.abs(np.median(contrasts[good]))) & (widths < 3 * np.median(widths[good]))
    kept = good.copy()
    for i in np.flatnonzero(good):
        near = slice(max(0, i - 6), i + 7)
        median = np.median(offsets[near][good[near]])
        kept[i] = abs(offsets[i] - median) < 1.5
    return kept


def _smoothed(points: Array) -> Array:
    """A polyline smoothed by local straight-line fits with Gaussian weights: ends do not shrink."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    out = np.empty_like(points)
    for i in range(len(points)):
        near = np.abs(arc - arc[i]) < 3 * _SMOOTH_PX
        d = arc[near] - arc[i]
        w = np.exp(-0.5 * (d / _SMOOTH_PX) ** 2)
        s0, s1, s2 = w.sum(), (w * d).sum(), (w * d * d).sum()
        determinant = s0 * s2 - s1 * s1
        weights = w / s0 if determinant < 1e-9 else w * (s2 - s1 * d) / determinant
        out[i] = weights @ points[near]
    return out
