"""A first look at a candidate: place, width and contrast of the band in the median of its cross-sections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrology.arrays import Array, Float32
from metrology.seams.finding.candidates import Candidate
from metrology.seams.finding.strip import Strip
from metrology.seams.polyline import normals, polyline_length, resample

# Cross-sections are looked at so far apart, px.
_STEP_PX = 6.0
# The skin is looked at over so much on each side, from a line's width away from its middle on, px.
_SKIN_PX = 6.0
_FEWEST_SECTIONS = 4


@dataclass(frozen=True)
class RoughLine:
    """A line to about a pixel."""

    points: Array
    """(n, 2): u, v on the band's middle, `_STEP_PX` apart."""
    width_px: float
    """Between the places of half contrast."""
    contrast: float
    """Brightness of the band relative to the skin beside it, less one: negative for a dark line."""

    @property
    def length_px(self) -> float:
        """Along the line."""
        return polyline_length(self.points)


def look_at(relative: Float32, candidate: Candidate) -> RoughLine | None:
    """The band at a candidate, or None where its median cross-section shows none."""
    strip = Strip.along(candidate.points, candidate.width_px + _SKIN_PX, _STEP_PX)
    values = strip.smooth(relative)
    complete = np.isfinite(values).all(axis=1)
    if complete.sum() < _FEWEST_SECTIONS:
        return None
    profile = np.median(values[complete], axis=0).astype(float)
    near = np.flatnonzero(np.abs(strip.x) <= 0.75 * candidate.width_px)
    peak = int(near[np.argmin(profile[near] if candidate.dark else -profile[near])])
    skin_px = int(_SKIN_PX)
    sides = float(np.median(profile[:skin_px])), float(np.median(profile[-skin_px:]))
    left = _half_way(profile[peak::-1], sides[0])
    right = _half_way(profile[peak:], sides[1])
    if left is None or right is None or min(sides) <= 0:
        return None
    offset = strip.x[peak] + 0.5 * (right - left)
    points = resample(candidate.points, _STEP_PX)
    return RoughLine(points + offset * normals(points), left + right, float(profile[peak] / np.mean(sides) - 1.0))


def _half_way(profile: Array, outside: float) -> float | None:
    """How far from its first entry a profile comes half-way to its level outside, px."""
    half = 0.5 * (profile[0] + outside)
    beyond = (profile - half) * np.sign(outside - profile[0]) >= 0
    if not beyond.any() or beyond[0]:
        return None
    k = int(beyond.argmax())
    return float(k - (profile[k] - half) / (profile[k] - profile[k - 1]))
