"""Where lines may be: Steger's line points at several scales, linked, cut into straight pieces and joined (paper §3.2).

A band of width w answers most at a scale of about w/2; the image is reduced two, four and more times so that one small
filter finds bands of all widths.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from metrology.arrays import Array, Float32, Mask
from metrology.ridges import RidgeMap, bar_curvature, curvature_noise, ridge_points
from metrology.robust import MAD
from metrology.seams.finding.linking import link
from metrology.seams.finding.segments import join_pieces, straight_pieces
from metrology.seams.polyline import polyline_length
from metrology.seams.settings import LineSettings

# Scale of the filter on each reduced image, px of it: the least at which a Gaussian's derivatives sampled at pixels
# keep their moments to a per cent.
_SIGMA = 1.5
# The width that answers most at this scale (Steger 1998, eq 8: the maximum of w exp(−w²/8σ²)), px.
_BEST_WIDTH = 2.0 * _SIGMA
# Local brightness is the mean over several times the widest band.
_BACKGROUND_PX = 160
# Where there is hardly any light, ratios are noise: the background counts as at least this share of the lit skin.
_LEAST_LIGHT = 0.02
# A line is followed down to this share of the strength it must have somewhere (Canny's ratio of two to three).
_HYSTERESIS = 0.4
# Shorter chains are noise, points.
_MIN_CHAIN = 6


@dataclass(frozen=True)
class Candidate:
    """What may be a line."""

    points: Array
    """(n, 2): u, v along it in the full image, good to about the scale it was found at."""
    width_px: float
    """Of bands that answer most at this scale."""
    response: float
    """Median strength of its points times the scale's square: comparable among scales."""
    dark: bool
    """Whether it is darker than what lies beside it."""


def relative_brightness(texture: ArrayLike) -> Float32:
    """(h, w) texture over its local mean: exposure-fused scans span orders of magnitude, lines stand out by ratio."""
    grey = np.array(texture, np.float32)
    cv2.patchNaNs(grey, 0.0)
    small = cv2.resize(grey, None, fx=0.125, fy=0.125, interpolation=cv2.INTER_AREA)
    size = max(3, (_BACKGROUND_PX // 8) | 1)
    mean = cv2.blur(small, (size, size), borderType=cv2.BORDER_REFLECT)
    floor = _LEAST_LIGHT * float(np.percentile(small, 95)) + 1e-6
    background = cv2.resize(np.maximum(mean, floor), grey.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(np.clip(grey / background, 0.0, 3.0), np.float32)


def find_candidates(relative: Float32, settings: LineSettings, hidden: Mask | None = None) -> list[Candidate]:
    """Candidates at all scales, the longest and strongest first.

    Parameters
    ----------
    relative : (h, w) float32
        See `relative_brightness`.
    hidden : (h, w) ndarray of bool, optional
        Where line points count for nothing: on rivets.
    """
    found: list[Candidate] = []
    for level in range(1, settings.coarsest_level + 1):
        found += _at_level(relative, level, settings, hidden)
    return sorted(found, key=lambda c: -c.response * polyline_length(c.points))


def _at_level(relative: Float32, level: int, settings: LineSettings, hidden: Mask | None) -> list[Candidate]:
    factor = 2**level
    reduced = cv2.resize(relative, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
    noise = _grain(np.asarray(reduced, np.float32)) * curvature_noise(_SIGMA)
    # The weakest line sought: a bar of the width that answers most at this scale.
    high = max(bar_curvature(_BEST_WIDTH, settings.min_contrast, _SIGMA), settings.noise_sigmas * noise)
    ridges = ridge_points(reduced, _SIGMA, _HYSTERESIS * high, "both")
    if hidden is not None:
        _drop(ridges, hidden, factor)
    generator = np.random.default_rng(settings.seed)
    pieces = [
        piece
        for chain in link(ridges, high, _MIN_CHAIN)
        for piece in straight_pieces(
            # Positions on a reduced image are good to a fraction of its pixel.
            chain,
            settings.straightness_px / factor + 0.3,
            settings.min_segment_px / factor,
            generator,
        )
    ]
    found = []
    for sign in (1, -1):
        same = [piece for piece in pieces if np.sign(piece[0, 2]) == sign]
        joined = join_pieces(
            same,
            settings.max_gap_px / factor,
            2.0 + settings.straightness_px / factor,
            np.deg2rad(settings.max_bend_deg),
        )
        for line in joined:
            points = (line[:, :2] + 0.5) * factor - 0.5
            if polyline_length(points) >= settings.min_length_px:
                response = float(np.median(np.abs(line[:, 2]))) * _SIGMA**2
                found.append(Candidate(points, _BEST_WIDTH * factor, response, sign > 0))
    return found


def _drop(ridges: RidgeMap, hidden: Mask, factor: int) -> None:
    """Take away the line points in hidden places of the full image."""
    height, width = ridges.strength.shape
    small = cv2.resize(hidden.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
    ridges.strength[small > 0] = 0.0


def _grain(image: Float32) -> float:
    """Standard deviation of the pixel-to-pixel noise, robust, from mixed differences of each 2 × 2 pixels."""
    even = image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2]
    mixed = even[::2, ::2] - even[1::2, ::2] - even[::2, 1::2] + even[1::2, 1::2]
    return MAD * float(np.median(np.abs(mixed))) / 2.0
