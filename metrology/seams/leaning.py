"""How the skins lean and bend, taken from a longer stretch of the seam than how high they stand.

A station's own strip tells heights well, but carries them over to the edges along slopes, and most of the step's noise
is theirs: with n points on each side, over a length l, their middles a distance D apart across the gap,
``var(step) = 2 σ²/n + D² σ²/(2 n l²/12)``, where the second term is five times the first. Plates are stiff: slopes and
curvature change little, and evenly, from one station to the next. They are predicted for each station from those before
and behind it that share no point with it, by straight lines along the seam, and the prediction is one more measurement
of the skin lines beside the station's own points. Where slopes do not change evenly, predictions miss by more than
noise, and by so much less they count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from metrology.seams.sections import Section, SkinLine

Array = NDArray[np.float64]

# Stations this near take part, mm: seven strips of 4 mm that share no point leave an eighth of the slopes' variance;
# more would gain little, and the farther away, the less evenly slopes change.
_REACH_MM = 16.0
# A straight line and its uncertainty need more than two.
_FEWEST_STATIONS = 4
# Mean slope, kink (B less A) and curvature, from a's c_0, c_1, b's c_0, c_1 and the common c_2.
_LEAN = np.array([[0, 0.5, 0, 0.5, 0], [0, -1.0, 0, 1.0, 0], [0, 0, 0, 0, 1.0]])
_ROUNDING_MM = 1e-6


def steadied(sections: Sequence[Section | None], s_mm: Array, half_length: float) -> list[Section | None]:
    """The sections with slopes and curvature from their own points and from their neighbours.

    Parameters
    ----------
    sections : sequence of Section or None
        Of one seam, in order; covariances with all that raises them.
    s_mm : (n,) ndarray
        Where they stand along the seam.
    half_length : float
        ε_d, mm: sections nearer to each other than twice that share points.
    """
    result = list(sections)
    own = [section for section in sections if section is not None]
    if len(own) < _FEWEST_STATIONS:
        return result
    index = np.array([k for k, section in enumerate(sections) if section is not None])
    lines = np.array([[*section.a.coefficients[:2], *section.b.coefficients] for section in own])
    covariance = np.array([section.covariance for section in own])
    lean, scatter = lines @ _LEAN.T, _LEAN @ covariance @ _LEAN.T
    predicted, variance = _predictions(own, s_mm[index], lean, scatter, 2 * half_length)
    told = np.flatnonzero(np.isfinite(variance).all(axis=1))
    index, own = index[told], [own[i] for i in told]
    lines, covariance = lines[told], covariance[told]
    # Kalman's gain.
    gain = covariance @ _LEAN.T @ np.linalg.inv(scatter[told] + variance[told][..., None] * np.eye(3))
    lines = lines + (gain @ (predicted - lean)[told][..., None])[..., 0]
    covariance = covariance - gain @ _LEAN @ covariance
    for k, section, line, left in zip(index, own, lines, covariance, strict=True):
        a, b = SkinLine(line[[0, 1, 4]], section.a.n), SkinLine(line[2:], section.b.n)
        result[k] = replace(section, a=a, b=b, covariance=left)
    return result


def _predictions(own: Sequence[Section], s: Array, lean: Array, scatter: Array, apart_mm: float) -> tuple[Array, Array]:
    """Slopes and curvature (n, 3) of each section as the others tell them, and their variances; infinite where they
    do not.

    Parameters
    ----------
    s : (n,) ndarray
        mm along the seam.
    lean, scatter : (n, 3), (n, 3, 3) ndarray
        Each section's own, and its covariance.
    apart_mm : float
        Sections this far apart share no point.
    """
    away = s[None] - s[:, None]
    within = np.abs(away) <= _REACH_MM + _ROUNDING_MM
    others = within & (np.abs(away) >= apart_mm - _ROUNDING_MM)
    # Neighbouring strips overlap: so many say as much as one.
    overlap = max(1.0, apart_mm / float(np.median(np.diff(s))))
    own_variance = np.einsum("nii->ni", scatter)
    weights = others[..., None] / (overlap * own_variance[None])
    values = np.broadcast_to(lean[None], (len(s), len(s), 3)).copy()
    # A section's mean slope is that in its own frame; seen from another one its frame's slope comes on top.
    across, up = (np.array([section.frame.axes[k] for section in own]) for k in (0, 2))
    values[..., 0] -= across @ up.T
    d = away[..., None]
    w, wd, wdd = ((weights * power).sum(axis=1) for power in (1.0, d, d * d))
    wv, wdv = ((weights * values * power).sum(axis=1) for power in (1.0, d))
    determinant = w * wdd - wd * wd
    told = (others.sum(axis=1) >= _FEWEST_STATIONS)[:, None] & (determinant > 0)
    determinant = np.where(told, determinant, 1.0)
    predicted, variance = (wdd * wv - wd * wdv) / determinant, wdd / determinant
    # What the predictions hereabouts miss by beyond noise.
    excess = np.where(told, (predicted - lean) ** 2 - variance - own_variance, 0.0)
    near = within.astype(float)
    variance = variance + np.maximum(near @ excess, 0.0) / np.maximum(near @ told, 1.0)
    return predicted, np.where(told, variance, np.inf)
