"""Least squares of a gap's section on all stations' pixels: Levenberg–Marquardt with levels and borders eliminated.

What limits the shape is not noise but how well the model renders the gap. That error is common to all stations, so
each of n stations gets n times its variance: more stations do not make it smaller.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array, Mask
from metrology.seams.gap.descent import DOUBTFUL, STRIDE_MM, descend, keep_apart, tables_of
from metrology.seams.gap.equations import normal_equations
from metrology.seams.gap.model import LEVELS
from metrology.seams.gap.prior import LENSES, WIDTH_A, WIDTH_B, Prior
from metrology.seams.gap.profiles import Profiles

Indices = NDArray[np.intp]

# Error of the rendered brightness, relative to the skin's: what stations' residuals have in common is 0.001 to 0.002 on
# simulated and rendered seams, seldom 0.003. The fit is told more, so that it does not follow what is not modelled.
_RENDERING, _RENDERING_FOUND = 0.004, 0.002
# Blur spreads such an error over 2√π σ = 2.5 px at a usual σ of 0.7 px, which is so many bins: of as many one counts.
_ALIKE_BINS = 7.5
_USUAL_MISFIT = _ALIKE_BINS * (_RENDERING_FOUND / _RENDERING) ** 2
# Steps of the stations' borders where the shape is known: at most so many, while one is longer than this, mm; a station
# whose own are shorter than the last number stays. What is left would come up to micrometres in the shape's next fit.
_BORDER_ITERATIONS, _SETTLED_MM, _STILL_MM = 10, 1e-4, 1e-8
# From skin A to skin B.
ACROSS = np.array([-1.0, 1.0])


@dataclass(frozen=True)
class State:
    """Parameters of n stations in k cameras, and the normal equations there."""

    borders: Array
    """(n, 2): x of C on both skins, mm."""
    shared: Array
    """(m,): as in `prior`."""
    known: Prior
    normals: Array
    gradients: Array
    """normals, gradients: (n, 2 + m, 2 + m), (n, 2 + m): JᵀWJ and JᵀWr of each station, its own levels eliminated; of
    the borders alone where the shape is known."""
    levels: Array
    """(n, k, LEVELS)."""
    costs: Array
    """(n,): squared residuals in units of their variance."""
    misfit: float = _USUAL_MISFIT
    """Variance of the rendering error as the residuals show it, in units of what the fit is told."""

    @property
    def widths(self) -> Array:
        """(n,) from ideal edge to ideal edge, mm."""
        return np.asarray(self.borders @ ACROSS - self.shared[WIDTH_A] - self.shared[WIDTH_B])

    @property
    def usual_levels(self) -> Array:
        """(k, LEVELS) of the seam in each camera."""
        cameras = self.levels.shape[1]
        return self.shared[LENSES + cameras :].reshape(cameras, LEVELS)

    @cached_property
    def limit(self) -> float:
        """Cost from which a station is doubtful."""
        return DOUBTFUL * float(np.median(self.costs))

    def cost(self, limit: float) -> float:
        """What pictures and prior have against the state; of costs beyond the limit only the logarithm counts."""
        beyond = limit * (1.0 + np.log(np.maximum(self.costs / max(limit, 1e-12), 1.0)))
        return float(np.where(self.costs < limit, self.costs, beyond).sum()) + self.known.cost(self.shared)

    def at(self, which: Mask | Indices) -> State:
        """Some of the stations."""
        return replace(self, **{name: getattr(self, name)[which] for name in _OF_STATIONS})

    def with_stations(self, which: Mask | Indices, others: State) -> State:
        """The state with some of its stations replaced."""
        changed = {}
        for name in _OF_STATIONS:
            changed[name] = getattr(self, name).copy()
            changed[name][which] = getattr(others, name)
        return replace(self, **changed)

    @property
    def shape_normal(self) -> tuple[Array, Array, Array]:
        """Normal matrix of what is shared with the borders eliminated (Schur complement).

        Returns
        -------
        normal : (m, m) ndarray
        cross : (n, 2, m) ndarray
            Blocks of borders by shape.
        inverse : (n, 2, 2) ndarray
            Of the borders' own blocks.
        """
        cross, inverse = self.normals[:, :2, 2:], _inverses(self.normals[:, :2, :2] + 1e-9 * np.eye(2))
        trust = np.minimum(1.0, self.limit / np.maximum(self.costs, 1e-12))[:, None, None]
        normal = (trust * self.normals[:, 2:, 2:]).sum(axis=0) + self.known.precision
        normal -= ((trust * cross).transpose(0, 2, 1) @ (inverse @ cross)).sum(axis=0)
        return normal, cross, inverse

    @property
    def excess_misfit(self) -> float:
        """How many times more the rendering errs than usual, as a variance."""
        return self.misfit / _USUAL_MISFIT

    @property
    def mean_width_sigma(self) -> float:
        """Standard deviation of the stations' mean width by what they have in common."""
        normal, cross, inverse = self.shape_normal
        free = self.known.free
        # W = x_B − x_A − w_A − w_B; with the shape, the borders move along.
        by_shape = -(ACROSS @ (inverse @ cross)).mean(axis=0)
        by_shape[[WIDTH_A, WIDTH_B]] -= 1.0
        moved = np.linalg.solve(normal[np.ix_(free, free)], by_shape[free])
        by_prior = moved @ self.known.precision[np.ix_(free, free)] @ moved
        by_pictures = by_shape[free] @ moved - by_prior + (ACROSS @ inverse @ ACROSS).sum() / len(self.borders) ** 2
        return float(np.sqrt(by_prior + self.misfit * by_pictures))


def _inverses(matrices: Array) -> Array:
    """(n, 2, 2) inverses of (n, 2, 2) symmetric matrices."""
    (a, b), (_, d) = matrices.transpose(1, 2, 0)
    return np.asarray((np.array([[d, -b], [-b, a]]) / (a * d - b * b)).transpose(2, 0, 1))


_OF_STATIONS = ("borders", "normals", "gradients", "levels", "costs")


def fit_shape_from(profiles: Profiles, borders: Array, shared: Array, known: Prior, iterations: int) -> State:
    """Borders and shape together, from a start."""
    n = len(profiles.stations)
    cautious = replace(profiles, variance=profiles.variance + n * _RENDERING**2)
    state = _empty_state(cautious, borders, shared, known, 2 + len(shared))
    descend(
        _pictures(cautious), profiles.normals, known.floor.sealed, known.limits, iterations,
        state.borders, state.shared, state.normals, state.gradients, state.levels, state.costs,
    )  # fmt: skip
    return replace(state, misfit=max(state.misfit, _misfit(state.costs, profiles)))


def _misfit(costs: Array, profiles: Profiles) -> float:
    """How much more the residuals vary than noise alone would make them, with the correlation that blur gives them."""
    n = len(costs)
    used = np.arange(profiles.variance.shape[2]) < profiles.sizes[..., None]
    noise = np.where(used, profiles.variance / (profiles.variance + n * _RENDERING**2), 0.0).sum(axis=(1, 2))
    bins = np.maximum(used.sum(axis=(1, 2)), 1)
    # A station's share of what all have in common is one in n.
    return _ALIKE_BINS * n * float(np.median((costs - noise) / bins))


def fit_borders_from(profiles: Profiles, borders: Array, shape: State) -> State:
    """Every station's borders from a start, with the shape known, each station by itself."""
    careful = replace(profiles, variance=profiles.variance + _RENDERING**2)
    tables = tables_of(profiles.normals, shape.shared)
    state = _state_at(careful, borders, shape.shared, shape.known, tables)
    moving, damping = np.arange(len(borders)), np.full(len(borders), 1e-2)
    for _ in range(_BORDER_ITERATIONS):
        here = state.at(moving)
        own = here.normals * (1.0 + damping[:, None, None] * np.eye(2)) + 1e-9 * np.eye(2)
        moves = (_inverses(own) @ here.gradients[..., None])[..., 0].clip(-STRIDE_MM, STRIDE_MM)
        longest = np.abs(moves).max(axis=1)
        if longest.max() < _SETTLED_MM:
            break
        moved = here.borders + moves
        keep_apart(moved, shape.shared)
        new = _state_at(careful.at(moving), moved, shape.shared, shape.known, tables)
        better = new.costs < here.costs
        state = state.with_stations(moving[better], new.at(better))
        unsettled = longest >= _STILL_MM
        moving, damping = moving[unsettled], np.where(better, 0.2 * damping, 8.0 * damping)[unsettled]
    return state


def _state_at(profiles: Profiles, borders: Array, shared: Array, known: Prior, tables: Array | None = None) -> State:
    """What the pictures say there: of borders and shape; with `tables` of the known blur, of the borders alone."""
    state = _empty_state(profiles, borders, shared, known, 2 + (len(shared) if tables is None else 0))
    x, grey, variance, sizes, places, tilts, eyes, lamps, px_mm, precisions, along = _pictures(profiles)
    normal_equations(
        x, grey, variance, sizes, places, state.borders, shared,
        tables_of(profiles.normals, shared) if tables is None else tables, known.floor.sealed, tilts, eyes, lamps,
        px_mm, precisions, along, state.normals, state.gradients, state.levels, state.costs,
    )  # fmt: skip
    return state


def _empty_state(profiles: Profiles, borders: Array, shared: Array, known: Prior, size: int) -> State:
    """Room for the normal equations of so many parameters, at copies of what is given."""
    n, k = profiles.sizes.shape
    normals, gradients = np.zeros((n, size, size)), np.zeros((n, size))
    return State(borders.copy(), shared.copy(), known, normals, gradients, np.zeros((n, k, LEVELS)), np.zeros(n))


def _pictures(profiles: Profiles) -> tuple[NDArray[Any], ...]:
    """Pictures as the compiled fit takes them."""
    return (
        profiles.x, profiles.grey, profiles.variance, profiles.sizes, profiles.places, profiles.tilts, profiles.eyes,
        profiles.lamps, profiles.px_mm, profiles.level_scatter**-2.0, profiles.courses,
    )  # fmt: skip
