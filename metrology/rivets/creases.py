"""Skin round a head that a quadric does not follow: creases over frames and joints, and the flanks of dents.

A head sits where its skin bends as often as beside it, and no point of the skin lies under it. What a quadric leaves in
the annulus tells: lines along which the slope changes, and bends of fourth order, each tried in many directions and
places. No one of them is picked: each counts by its probability (Bayesian model averaging), so that skin without a
crease keeps its quadric, and what remains open between the shapes is uncertainty.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrology.arrays import Array
from metrology.rivets.fits import Fits
from metrology.rivets.inflation import Inflation
from metrology.surfaces import Polynomial, monomials

_DIRECTIONS = 24  # of half a turn
_OFFSETS = np.linspace(-0.85, 0.85, 15)  # of a crease from the head's centre, shares of the annulus' radius
_USUAL_MM = 0.03  # standard deviation of what creases that there are raise the skin by at the annulus' border
_LEAST_SHOWN = 1e-3  # of what shows the clearest of the shapes: the points tell others from no quadric
_CELLS = 12  # per radius: fine beside a crease's reach, few beside the points


def creased_skin(fits: Fits, inflation: Inflation) -> Polynomial:
    """The skin's quadric, moved to where creases put the skin at the head's centre, with what they leave uncertain.

    Parameters
    ----------
    inflation : Inflation
        By which the variances of heights and slopes exceed those of independent noise.
    """
    skin, patch = fits.skin, fits.patch
    chosen = np.flatnonzero(fits.outer)[skin.weights > 0]
    x, y = patch.x[chosen], patch.y[chosen]
    size = float(np.hypot(x, y).max())
    weight = skin.weights[skin.weights > 0] / patch.sigma[chosen] ** 2
    residual = patch.h[chosen] - skin.height(x, y)
    x, y, residual, weight = _cells(x / size, y / size, residual, weight)
    shapes, at_centre = _shapes(x, y)
    design = monomials(x, y, skin.order)
    # What is left of each shape, and of its value and slopes at the centre, once the quadric has taken its share.
    share = np.linalg.solve(design.T @ (weight[:, None] * design), design.T @ (weight[:, None] * shapes))
    shapes = shapes - design @ share
    at_centre = at_centre - share[:3]
    information = weight @ shapes**2
    shown = information > _LEAST_SHOWN * information.max()
    shapes, at_centre, information = shapes[:, shown], at_centre[:, shown], information[shown]
    amplitude = (weight * residual) @ shapes / information
    variance = skin.chi**2 * inflation.height / information + np.finfo(float).tiny
    odds = _odds(amplitude**2, variance)
    # A share of what the points ask for: noise asks for some, too.
    known = _USUAL_MM**2 / (_USUAL_MM**2 + variance)
    amplitude, variance = known * amplitude, known * variance
    height = amplitude * at_centre[0]
    moved = float(odds @ height)
    open_height = float(odds @ (height**2 + variance * at_centre[0] ** 2)) - moved**2
    slopes = amplitude * at_centre[1:] / size
    coefficients, covariance = skin.coefficients.copy(), skin.covariance.copy()
    coefficients[0] += moved
    covariance[0, 0] += open_height / inflation.height
    covariance[1:3, 1:3] += (odds * slopes) @ slopes.T / inflation.slope
    return replace(skin, coefficients=coefficients, covariance=covariance)


def _odds(squares: Array, variance: Array) -> Array:
    """(k,) probability of each shape beside the quadric alone, from squared amplitudes and their variances."""
    total = _USUAL_MM**2 + variance
    log = 0.5 * (squares / variance * _USUAL_MM**2 / total - np.log(total / variance)) - np.log(len(squares))
    most = max(float(log.max()), 0.0)
    likelihood = np.exp(log - most)
    return np.asarray(likelihood / (likelihood.sum() + np.exp(-most)))


def _cells(x: Array, y: Array, residual: Array, weight: Array) -> tuple[Array, Array, Array, Array]:
    """Points averaged over square cells; x and y within the unit circle."""
    side = 2 * _CELLS + 2
    cell = (np.floor(y * _CELLS).astype(int) + _CELLS) * side + np.floor(x * _CELLS).astype(int) + _CELLS
    total = np.bincount(cell, weight)
    there = total > 0
    means = [np.bincount(cell, weight * a)[there] / total[there] for a in (x, y, residual)]
    return means[0], means[1], means[2], np.asarray(total[there], float)


def _shapes(x: Array, y: Array) -> tuple[Array, Array]:
    """(n, k) heights of the shapes at points within the unit circle; (3, k) height and slopes at its centre."""
    angle = np.arange(_DIRECTIONS) * (np.pi / _DIRECTIONS)
    across = np.stack([np.cos(angle), np.sin(angle)])
    t = np.stack([x, y], axis=1) @ across
    creases = np.abs(t[:, :, None] - _OFFSETS).reshape(len(x), -1)
    turn = np.where(_OFFSETS > 0, -1.0, 1.0)
    slope = (across[:, :, None] * turn).reshape(2, -1)
    height = np.tile(np.abs(_OFFSETS), _DIRECTIONS)
    fourth = np.zeros((3, _DIRECTIONS))
    return np.hstack([creases, t**4]), np.hstack([np.vstack([height, slope]), fourth])
