"""What the projector's gamma, flicker and vibration leave in a decoded coordinate, from the scan itself.

A projector that is not linear adds harmonics to its fringes. With N steps those of order m N ± 1 pass for fringe: the
coordinate ripples with m N times the fringe's phase, φ = 2π f (ξ + ½)/W, the same way wherever a column is seen. Light
that is not the same in every frame (flicker), and steps that are not where they should be (vibration), make it ripple
with the phase itself and with twice the phase. Two cameras see the same ripple and match it away, unless the frames of
one are uneven in another way than those of the other: a frame blurred, a trigger late, a shutter beside the light's
period. One camera would measure every ripple as relief. So the ripple of every count is fitted to second differences of
the coordinate, in which a smooth skin hardly shows, and taken out: all of it from one camera, from two what they
differ by.

What one camera's second differences scatter beyond the stated σ, for whatever reason, is added to it: three steps leave
no residual from which the noise could be told.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.cloud import DecodedView
from metrology.fringe import FringeCode
from metrology.robust import MAD

_ORDERS = (1, 2)  # of what passes for fringe
_UNEVEN = (1, 2)  # times the phase: of frames that are not alike
_LEAST_SHOWN = 0.15  # of its amplitude, what second differences must show of a ripple: it is told by nothing else
_ROWS = 400  # are looked at
_ROWS_OF_TWO = 120  # suffice for ripples of six frequencies
_PER_PIXEL = 16  # of the table: between two places the finest ripple is off by a two-hundredth of itself
_UNEQUAL = 0.25  # of a pixel's σ: a ripple that adds 1/32 to its variance
_TOLD = 32.0  # χ² of a ripple's two amplitudes: what is less is noise, whose neighbours are alike, and stays
_FEWEST = 5000
_OUTLIER = 5.0
_ROUNDS = 3


def without_ripple(view: DecodedView, code: FringeCode, size: int) -> DecodedView:
    """The view with its coordinate free of the projector's harmonics, and σ at least what the coordinate scatters.

    Parameters
    ----------
    size : int
        W, projector pixels along the fringe axis.
    """
    own = [(count, steps) for count, steps in zip(code.counts, code.step_counts, strict=True)]
    orders = {count * times for count, steps in own for times in (*_UNEVEN, *(steps * order for order in _ORDERS))}
    found = _found(view, code, size, orders, [count * steps for count, steps in own], _ROWS)
    if found is None:
        return view
    plain = _without(view, found, size)
    return replace(plain, sigma=(view.sigma * np.float32(max(1.0, found.scatter))).astype(np.float32))


def with_equal_ripples(
    left: DecodedView, right: DecodedView, code: FringeCode, size: int, of_shape: bool = False
) -> tuple[DecodedView, DecodedView, float]:
    """Two views with one ripple of uneven frames, which then cancels, where those are not alike.

    Parameters
    ----------
    size : int
        W, projector pixels along the fringe axis.
    of_shape : bool
        Whether the fringes' shape differs, too: one camera has a gamma of its own.

    Returns
    -------
    left, right : DecodedView
        As they were where their ripples are alike, else the one with more of it has only the other's.
    difference : float
        Largest difference between their amplitudes, as a share of a pixel's median σ.
    """
    own = list(zip(code.counts, code.step_counts, strict=True))
    orders = {
        count * times
        for count, steps in own
        for times in (*_UNEVEN, *(steps * order for order in (_ORDERS if of_shape else ())))
    }
    finest = [count * (steps if of_shape else max(_UNEVEN)) for count, steps in own]
    views = (left, right)
    found = [_found(view, code, size, orders, finest, _ROWS_OF_TWO) for view in views]
    one, other = found
    if one is None or other is None or one.frequencies != other.frequencies or not one.frequencies:
        return left, right, 0.0
    noise = min(float(np.nanmedian(view.sigma)) for view in views)
    apart = one.weights - other.weights
    difference = float(np.hypot(*apart.reshape(-1, 2).T).max()) / noise
    if difference <= _UNEQUAL:
        return left, right, difference
    if np.linalg.norm(one.weights) > np.linalg.norm(other.weights):
        return _without(left, replace(one, weights=apart), size), right, difference
    return left, _without(right, replace(other, weights=-apart), size), difference


@dataclass(frozen=True)
class _Ripples:
    """What was fitted: frequencies (rad/px), cosine and sine amplitudes of each, and the scatter left, in stated σ."""

    frequencies: list[float]
    weights: Array
    scatter: float


def _found(
    view: DecodedView, code: FringeCode, size: int, orders: Collection[int], finest: Sequence[int], most_rows: int
) -> _Ripples | None:
    """The ripples of these orders (periods over W); None where too few points tell."""
    coordinate, sigma = (_along(values, code.axis) for values in (view.coordinate, view.sigma))
    stride = max(1, len(coordinate) // most_rows)
    rows, noise = coordinate[::stride].astype(float), sigma[::stride].astype(float)
    slope = np.abs(np.diff(rows, axis=1))
    if not np.isfinite(slope).any():
        return None
    steep = float(np.nanmedian(slope))
    reach = _reach(finest, size, steep)
    bend = _second(rows, reach)
    expected = np.sqrt(_shifted(noise, reach) + 4 * noise[:, reach:-reach] ** 2)
    use = np.isfinite(bend) & np.isfinite(expected)
    if use.sum() < _FEWEST:
        return None
    frequencies = _shown(orders, size, reach * steep)
    terms = [_second(wave, reach)[use] for wave in _waves(rows, frequencies)]
    weights, left = _fitted(np.stack(terms, axis=1) if terms else np.empty((use.sum(), 0)), bend[use], expected[use])
    return _Ripples(frequencies, weights, MAD * float(np.median(np.abs(left) / expected[use])))


def _without(view: DecodedView, found: _Ripples, size: int) -> DecodedView:
    """The view with these ripples taken from its coordinate, by a table along the projector."""
    if not found.weights.any():
        return view
    places = np.arange(-1.0, size + 1, 1 / _PER_PIXEL)
    table = sum(weight * wave for weight, wave in zip(found.weights, _waves(places, found.frequencies), strict=True))
    ripple = np.interp(view.coordinate, places, np.asarray(table))
    return replace(view, coordinate=(view.coordinate - ripple).astype(np.float32))


def _along(values: NDArray[np.float32], axis: str) -> NDArray[np.float32]:
    """With the coordinate rising along the second axis."""
    return values if axis == "x" else values.T


def _shown(orders: Collection[int], size: int, reach_px: float) -> list[float]:
    """Frequencies that second differences over so many projector pixels show, radians per pixel."""
    frequencies = [2 * np.pi * order / size for order in sorted(orders)]
    return [own for own in frequencies if 4 * np.sin(own * reach_px / 2) ** 2 > _LEAST_SHOWN]


def _reach(finest: Sequence[int], size: int, slope: float) -> int:
    """Camera pixels across half a ripple of the order in the middle, over which second differences show it best."""
    frequencies = [2 * np.pi * order / size for order in finest]
    return max(1, round(np.pi / (float(np.median(frequencies)) * slope))) if frequencies and slope > 0 else 1


def _waves(coordinate: Array, frequencies: list[float]) -> list[Array]:
    """Cosine and sine of every ripple."""
    return [f(frequency * (coordinate + 0.5)) for frequency in frequencies for f in (np.cos, np.sin)]


def _second(values: Array, reach: int) -> Array:
    return np.asarray(values[:, 2 * reach :] + values[:, : -2 * reach] - 2 * values[:, reach:-reach])


def _shifted(noise: Array, reach: int) -> Array:
    """Variance of both neighbours."""
    return np.asarray(noise[:, 2 * reach :] ** 2 + noise[:, : -2 * reach] ** 2)


def _fitted(terms: Array, bend: Array, expected: Array) -> tuple[Array, Array]:
    """Amplitudes by robust least squares, 0 where noise may have made them, and what they leave."""
    weights, left = np.zeros(terms.shape[1]), bend
    for _ in range(_ROUNDS if terms.shape[1] else 0):
        middle = np.median(left)
        near = np.abs(left - middle) < _OUTLIER * MAD * np.median(np.abs(left - middle))
        scale = 1.0 / expected[near]
        design = np.column_stack([terms[near], np.ones(near.sum())]) * scale[:, None]
        normal = design.T @ design
        weights = np.linalg.lstsq(normal, design.T @ (bend[near] * scale), rcond=None)[0][:-1]
        left = bend - terms @ weights
    if len(weights):
        spread = (MAD * np.median(np.abs(left) / expected)) ** 2 * np.diag(np.linalg.pinv(normal))[:-1]
        told = (weights**2 / np.maximum(spread, 1e-30)).reshape(-1, 2).sum(1) > _TOLD
        weights = weights * np.repeat(told, 2)
    return weights, left
