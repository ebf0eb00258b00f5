"""Skin lines smoothed by the seam stations before and behind: slopes, curvature, and the course of the step.

A station's own strip tells heights well, but carries them over to the edges along slopes, and most of the step's noise
is theirs: with n points on each side, over a length l, their middles a distance D apart across the gap,
``var(step) = 2 σ²/n + D² σ²/(2 n l²/12)``, where the second term is five times the first. Plates are stiff: slopes and
curvature change little, and evenly, from one station to the next. They are predicted for each station from those before
and behind it that share no point with it, by straight lines along the seam, and the prediction is one more measurement
of the skin lines beside the station's own points. Where slopes do not change evenly, predictions miss by more than
noise, and by so much less they count.

Then the step itself is predicted likewise. A step may change from one station to the next, and that is what is to be
measured: so a station is not only judged by how much predictions miss hereabouts, but also by how much its own does.
With variance σ² of what it says itself, and a miss of m, it moves by less than ``σ²/|m|``, and never by more than σ:
what stands out of the noise stays, and only a station's noise is lessened. Most is gained where a seam leaves the image
through a corner and one side shows a few millimetres of skin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.fits import SkinLine
from metrology.seams.skins.residuals import clumpings, shared_share
from metrology.seams.skins.sections import Section

# A straight line and its uncertainty need more than two.
_FEWEST_STATIONS = 4
# Mean slope, kink (B less A), curvature, and step in the gap's middle, from a's c_0, c_1, b's c_0, c_1, common c_2.
_TRAITS = np.array([[0, 0.5, 0, 0.5, 0], [0, -1.0, 0, 1.0, 0], [0, 0, 0, 0, 1.0], [-1.0, 0, 1.0, 0, 0]])
_LEAN, _STEP = slice(0, 3), 3
# Stations this near take part, mm. Slopes: seven strips of 4 mm that share no point leave an eighth of their variance;
# more would gain little, and the farther away, the less evenly slopes change. Step: at a seam's end all the others lie
# on one side, and a straight line is four times as uncertain (variance) at its end as in its middle: twice as far.
_REACH_MM = np.array([16.0, 16.0, 16.0, 32.0])
_ROUNDING_MM = 1e-6
# What neighbours share and skin lines follow (waves along the seam) is not in residuals: so much of the variance stays.
_LEAST_SHARED = 0.1


def smoothed_sections(own: Sequence[Section | None], s_mm: Array, half_length: float) -> list[Section | None]:
    """The sections of a seam, smoothed by one another, with covariances as their residuals show them.

    Parameters
    ----------
    own : sequence of Section or None
        In order; covariances as if the points were independent.
    s_mm : (n,) ndarray
        Where they stand along the seam.
    half_length : float
        ε_d, mm.
    """
    scaled = [
        replace(section, covariance=clumping * section.covariance) if section else None
        for section, clumping in zip(own, clumpings(own), strict=True)
    ]
    shared = max(_LEAST_SHARED, shared_share(own, s_mm, half_length))
    return smoothed(scaled, s_mm, half_length, shared)


def smoothed(
    sections: Sequence[Section | None], s_mm: Array, half_length: float, shared: float = 0.0
) -> list[Section | None]:
    """The sections with their own points' skin lines and what their neighbours tell of them.

    Parameters
    ----------
    sections : sequence of Section or None
        Of one seam, in order; covariances with all that raises them.
    s_mm : (n,) ndarray
        Where they stand along the seam.
    half_length : float
        ε_d, mm: sections nearer to each other than twice that share points.
    shared : float
        Share of the points' variance that a station has in common with those it is smoothed by; no neighbour makes it
        smaller.
    """
    result = list(sections)
    own = [section for section in sections if section is not None]
    if len(own) < _FEWEST_STATIONS:
        return result
    index = np.array([k for k, section in enumerate(sections) if section is not None])
    lines = np.array([[*section.a.coefficients[:2], *section.b.coefficients] for section in own])
    covariance = np.array([section.covariance for section in own])
    told, near, predicted, variance = _predictions(own, s_mm[index], lines, covariance, 2 * half_length)
    index, own = index[told], [own[i] for i in told]
    lines, covariance = lines[told], covariance[told]
    common = shared * covariance
    variance = _with_unevenness(lines, covariance, near, predicted, variance)
    lines, covariance = _lean_told(lines, covariance, predicted, variance)
    lines, covariance = _step_told(lines, covariance, near, predicted, variance)
    covariance = (1.0 - shared) * covariance + common
    for k, section, line, left in zip(index, own, lines, covariance, strict=True):
        a, b = SkinLine(line[[0, 1, 4]], section.a.n), SkinLine(line[2:], section.b.n)
        result[k] = replace(section, a=a, b=b, covariance=left)
    return result


def _with_unevenness(lines: Array, covariance: Array, near: Array, predicted: Array, variance: Array) -> Array:
    """(m, 4, 4) `variance` and what predictions of slopes and curvature miss by hereabouts beyond noise."""
    lean = _TRAITS[_LEAN]
    known = np.einsum("kii->ki", variance[:, _LEAN, _LEAN] + lean @ covariance @ lean.T)
    excess = _mean_near((predicted[:, _LEAN] - lines @ lean.T) ** 2 - known, near[..., _LEAN])
    variance = variance.copy()
    np.einsum("kii->ki", variance)[:, _LEAN] += np.maximum(excess, 0.0)
    return variance


def _lean_told(lines: Array, covariance: Array, predicted: Array, variance: Array) -> tuple[Array, Array]:
    """Lines and covariances with slopes and curvature as predicted."""
    lean = _TRAITS[_LEAN]
    missed = predicted[:, _LEAN] - lines @ lean.T
    # Kalman's gain.
    gain = covariance @ lean.T @ np.linalg.inv(lean @ covariance @ lean.T + variance[:, _LEAN, _LEAN])
    return lines + (gain @ missed[..., None])[..., 0], covariance - gain @ lean @ covariance


def _step_told(lines: Array, covariance: Array, near: Array, predicted: Array, variance: Array) -> tuple[Array, Array]:
    """Lines and covariances with the step as predicted, once slopes and curvature have been.

    The predicted step's noise goes with that of the predicted slopes: what is left of it without them is the new
    measurement.
    """
    shared = np.linalg.solve(variance[:, _LEAN, _LEAN], variance[:, _LEAN, _STEP, None])[..., 0]
    trait = _TRAITS[_STEP] - shared @ _TRAITS[_LEAN]
    alone = predicted[:, _STEP] - np.sum(shared * predicted[:, _LEAN], axis=1)
    noise = variance[:, _STEP, _STEP] - np.sum(shared * variance[:, _LEAN, _STEP], axis=1)
    missed = alone - np.sum(trait * lines, axis=1)
    carried = (covariance @ trait[..., None])[..., 0]
    scatter = np.sum(trait * carried, axis=1)
    excess = missed**2 - noise - scatter
    hereabouts = _mean_near(excess[:, None], near[..., _STEP:])[:, 0]
    noise = noise + np.maximum(np.maximum(hereabouts, excess), 0.0)
    gain = carried / (scatter + noise)[:, None]
    return lines + gain * missed[:, None], covariance - gain[..., None] * carried[:, None]


def _mean_near(values: Array, near: Array) -> Array:
    """(n, k) mean of values (n, k) over the stations near each, near being (n, n, k)."""
    return np.einsum("ijk,jk->ik", near, values) / near.sum(axis=1)


def _predictions(
    own: Sequence[Section], s: Array, lines: Array, covariance: Array, apart_mm: float
) -> tuple[NDArray[np.intp], Array, Array, Array]:
    """What the others tell of each section.

    Parameters
    ----------
    s : (n,) ndarray
        mm along the seam.
    lines, covariance : (n, 5), (n, 5, 5) ndarray
        Each section's own.
    apart_mm : float
        Sections this far apart share no point.

    Returns
    -------
    told : (m,) ndarray of int
        The sections of which they tell anything.
    near : (m, m, 4) ndarray
        1 where one of those is near another.
    predicted, variance : (m, 4), (m, 4, 4) ndarray
        Traits, and the covariance that the others' points leave.
    """
    away = s[None] - s[:, None]
    within = np.abs(away)[..., None] <= _REACH_MM + _ROUNDING_MM
    others = within & (np.abs(away) >= apart_mm - _ROUNDING_MM)[..., None]
    # Neighbouring strips overlap: so many say as much as one.
    overlap = max(1.0, apart_mm / float(np.median(np.diff(s))))
    scatter = _TRAITS @ covariance @ _TRAITS.T
    weights = others / np.einsum("nii->ni", scatter)[None]
    values = np.broadcast_to((lines @ _TRAITS.T)[None], weights.shape).copy()
    # A section's mean slope is that in its own frame; seen from another one its frame's slope comes on top.
    across, up = (np.array([section.frame.axes[k] for section in own]) for k in (0, 2))
    values[..., 0] -= across @ up.T
    d = away[..., None]
    w, wd, wdd = ((weights * power).sum(axis=1) for power in (1.0, d, d * d))
    determinant = w * wdd - wd * wd
    told = np.flatnonzero(((others.sum(axis=1) >= _FEWEST_STATIONS) & (determinant > 0)).all(axis=1))
    # The straight line's value here, as a sum over the others.
    shares = weights[told] * (wdd[told, None] - wd[told, None] * d[told]) / determinant[told, None]
    predicted = np.sum(shares * values[told], axis=1)
    variance = overlap * np.einsum("kic,kid,icd->kcd", shares, shares, scatter)
    return told, within[np.ix_(told, told)].astype(float), predicted, variance
