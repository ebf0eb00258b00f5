"""Least squares of a gap's section on all stations' pixels: Levenberg–Marquardt with levels and borders eliminated.

What limits the shape is not noise but how well the model renders the gap. That error is common to all stations, so
each of n stations gets n times its variance: more stations do not make it smaller.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metrology.seams.blur import PixelBlur, blurred_step
from metrology.seams.gap.equations import normal_equations
from metrology.seams.gap.model import LEVELS, NODES_PER_PX
from metrology.seams.gap.prior import LENSES, SPILL, WIDTH_A, WIDTH_B, Prior
from metrology.seams.gap.profiles import Profiles

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Error of the rendered brightness, relative to the skin's: what stations' residuals have in common is 0.001 to 0.002 on
# simulated and rendered seams, seldom 0.003. The fit is told more, so that it does not follow what is not modelled.
_RENDERING, _RENDERING_FOUND = 0.004, 0.002
# Blur spreads such an error over 2√π σ = 2.5 px at a usual σ of 0.7 px, which is so many bins: of as many one counts.
_ALIKE_BINS = 7.5
_USUAL_MISFIT = _ALIKE_BINS * (_RENDERING_FOUND / _RENDERING) ** 2
# Stations whose squared residuals exceed the usual ones so many times tell less about the shape (Cauchy).
_DOUBTFUL = 3.0
# An iteration that gains less than this, in squared standard deviations, is the last.
_SETTLED = 0.002
# No border moves farther in one iteration, mm.
_STRIDE_MM = 0.3
# Pixel and spill reach so far along the diagonal, px; the tail of the lens's Gaussian, standard deviations.
_BLUR_REACH_PX, _LENS_TAIL = 3.6, 4.5
# From skin A to skin B.
ACROSS = np.array([-1.0, 1.0])


@dataclass(frozen=True)
class State:
    """Parameters of n stations in k cameras, and the normal equations there.

    Attributes
    ----------
    borders : (n, 2) ndarray
        x of C on both skins, mm.
    shared : (m,) ndarray
        As in `prior`.
    known : Prior
    normals, gradients : (n, 2 + m, 2 + m), (n, 2 + m) ndarray
        JᵀWJ and JᵀWr of each station, its own levels eliminated.
    levels : (n, k, LEVELS) ndarray
    costs : (n,) ndarray
        Squared residuals in units of their variance.
    misfit : float
        Variance of the rendering error as the residuals show it, in units of what the fit is told.
    """

    borders: Array
    shared: Array
    known: Prior
    normals: Array
    gradients: Array
    levels: Array
    costs: Array
    misfit: float = _USUAL_MISFIT

    @property
    def widths(self) -> Array:
        """(n,) from ideal edge to ideal edge, mm."""
        return np.asarray(self.borders @ ACROSS - self.shared[WIDTH_A] - self.shared[WIDTH_B])

    @property
    def usual_levels(self) -> Array:
        """(k, LEVELS) of the seam in each camera."""
        cameras = self.levels.shape[1]
        return self.shared[LENSES + cameras :].reshape(cameras, LEVELS)

    @property
    def limit(self) -> float:
        """Cost from which a station is doubtful."""
        return _DOUBTFUL * float(np.median(self.costs))

    def cost(self, limit: float) -> float:
        """What pictures and prior have against the state; of costs beyond the limit only the logarithm counts."""
        beyond = limit * (1.0 + np.log(np.maximum(self.costs / max(limit, 1e-12), 1.0)))
        return float(np.where(self.costs < limit, self.costs, beyond).sum()) + self.known.cost(self.shared)

    def at(self, which: Mask) -> State:
        """Some of the stations."""
        return replace(self, **{name: getattr(self, name)[which] for name in _OF_STATIONS})

    def with_stations(self, which: Mask, others: State) -> State:
        """The state with some of its stations replaced."""
        changed = {}
        for name in _OF_STATIONS:
            changed[name] = getattr(self, name).copy()
            changed[name][which] = getattr(others, name)
        return replace(self, **changed)

    def shape_normal(self, damping: float = 0.0) -> tuple[Array, Array, Array]:
        """Normal matrix of what is shared with the borders eliminated (Schur complement).

        Returns
        -------
        normal : (m, m) ndarray
        cross : (n, 2, m) ndarray
            Blocks of borders by shape.
        inverse : (n, 2, 2) ndarray
            Of the borders' own blocks.
        """
        own = self.normals[:, :2, :2] * (1.0 + damping * np.eye(2)) + 1e-9 * np.eye(2)
        cross, inverse = self.normals[:, :2, 2:], np.asarray(np.linalg.inv(own), float)
        trust = self._trust[:, None, None]
        normal = (trust * self.normals[:, 2:, 2:]).sum(axis=0) + self.known.precision
        normal += damping * np.diag(np.diag(normal))
        normal -= ((trust * cross).transpose(0, 2, 1) @ (inverse @ cross)).sum(axis=0)
        return normal, cross, inverse

    @property
    def excess_misfit(self) -> float:
        """How many times more the rendering errs than usual, as a variance."""
        return self.misfit / _USUAL_MISFIT

    @property
    def mean_width_sigma(self) -> float:
        """Standard deviation of the stations' mean width by what they have in common."""
        normal, cross, inverse = self.shape_normal()
        free = self.known.free
        # W = x_B − x_A − w_A − w_B; with the shape, the borders move along.
        by_shape = -(ACROSS @ (inverse @ cross)).mean(axis=0)
        by_shape[[WIDTH_A, WIDTH_B]] -= 1.0
        moved = np.linalg.solve(normal[np.ix_(free, free)], by_shape[free])
        by_prior = moved @ self.known.precision[np.ix_(free, free)] @ moved
        by_pictures = by_shape[free] @ moved - by_prior + (ACROSS @ inverse @ ACROSS).sum() / len(self.borders) ** 2
        return float(np.sqrt(by_prior + self.misfit * by_pictures))

    def step(self, damping: float) -> tuple[Array, Array]:
        """Moves of the borders and of what is shared."""
        normal, cross, inverse = self.shape_normal(damping)
        alone = (inverse @ self.gradients[:, :2, None])[..., 0]
        right = self._trust @ (self.gradients[:, 2:] - (alone[:, None, :] @ cross)[:, 0])
        right += self.known.gradient(self.shared)
        by_shape, free = np.zeros(len(self.shared)), self.known.free
        by_shape[free] = np.linalg.solve(normal[np.ix_(free, free)], right[free])
        by_border = alone - (inverse @ (cross @ by_shape)[..., None])[..., 0]
        return np.clip(by_border, -_STRIDE_MM, _STRIDE_MM), by_shape

    @property
    def _trust(self) -> Array:
        """(n,) stations' weights: one for those with usual costs."""
        return np.minimum(1.0, self.limit / np.maximum(self.costs, 1e-12))


_OF_STATIONS = ("borders", "normals", "gradients", "levels", "costs")


def fit_shape_from(profiles: Profiles, borders: Array, shared: Array, known: Prior, iterations: int) -> State:
    """Borders and shape together, from a start."""
    n = len(profiles.stations)
    cautious = replace(profiles, variance=profiles.variance + n * _RENDERING**2)
    state = _state_at(cautious, _apart(borders, shared), shared, known, with_shape=True)
    damping = 1e-2
    for _ in range(iterations):
        by_border, by_shape = state.step(damping)
        tried = known.within_bounds(state.shared + by_shape)
        new = _state_at(cautious, _apart(state.borders + by_border, tried), tried, known, with_shape=True)
        gain = state.cost(state.limit) - new.cost(state.limit)
        if gain > 0:
            state, damping = new, max(0.2 * damping, 1e-6)
            if gain < _SETTLED:
                break
        else:
            damping *= 8.0
            if damping > 1e4:
                break
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
    state = _state_at(careful, borders, shape.shared, shape.known, with_shape=False)
    damping = np.full(len(borders), 1e-2)
    for _ in range(10):
        own = state.normals[:, :2, :2] * (1.0 + damping[:, None, None] * np.eye(2)) + 1e-9 * np.eye(2)
        moves = np.clip(np.linalg.solve(own, state.gradients[:, :2, None])[..., 0], -_STRIDE_MM, _STRIDE_MM)
        if np.abs(moves).max() < 1e-4:
            break
        moved = _apart(state.borders + moves, shape.shared)
        new = _state_at(careful, moved, shape.shared, shape.known, with_shape=False)
        better = new.costs < state.costs
        damping = np.where(better, 0.2 * damping, 8.0 * damping)
        state = state.with_stations(better, new.at(better))
    return state


def _apart(borders: Array, shared: Array) -> Array:
    """Borders moved so far apart that no gap is narrower than nothing."""
    missing = np.maximum(shared[WIDTH_A] + shared[WIDTH_B] - borders @ ACROSS, 0.0)
    return np.asarray(borders + 0.5 * missing[:, None] * ACROSS)


def _state_at(profiles: Profiles, borders: Array, shared: Array, known: Prior, with_shape: bool) -> State:
    n, k = profiles.sizes.shape
    size = 2 + len(shared)
    state = State(
        borders, shared, known, np.zeros((n, size, size)), np.zeros((n, size)), np.zeros((n, k, LEVELS)), np.zeros(n)
    )
    normal_equations(
        profiles.x, profiles.grey, profiles.variance, profiles.sizes, profiles.places, borders, shared,
        _tables(profiles.normals, shared), known.floor.sealed, profiles.tilts, profiles.eyes,
        profiles.lamps, profiles.px_mm, profiles.level_scatter**-2.0, profiles.courses, with_shape,
        state.normals, state.gradients, state.levels, state.costs,
    )  # fmt: skip
    return state


def _tables(normals: Array, shared: Array) -> Array:
    """(k, 6, nodes) blurred steps of the cameras, and how they change."""
    spill, lenses = float(shared[SPILL]), [float(lens) for lens in shared[LENSES : LENSES + len(normals)]]
    reach = _BLUR_REACH_PX + _LENS_TAIL * max(lenses)
    return np.array([
        blurred_step((float(u), float(v)), PixelBlur(lens, spill), NODES_PER_PX, reach)
        for (u, v), lens in zip(normals, lenses, strict=True)
    ])  # fmt: skip
