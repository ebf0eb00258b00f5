"""What the projector's gamma, flicker and vibration leave in a decoded coordinate, from the scan itself.

A projector that is not linear adds harmonics to its fringes. With N steps those of order m N ± 1 pass for fringe: the
coordinate ripples with m N times the fringe's phase, φ = 2π f (ξ + ½)/W, the same way wherever a column is seen. Light
that is not the same in every frame (flicker), and steps that are not where they should be (vibration), make it ripple
with the phase itself and with twice the phase. Two cameras see the same ripple and match it away. One camera would
measure it as relief, so the ripple of every count is fitted to second differences of the coordinate, in which a smooth
skin hardly shows, and taken out.

What second differences scatter beyond the stated σ, for whatever reason, is added to it: three steps leave no residual
from which the noise could be told.
"""

from __future__ import annotations

from dataclasses import replace

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
    coordinate, sigma = (_along(values, code.axis) for values in (view.coordinate, view.sigma))
    stride = max(1, len(coordinate) // _ROWS)
    rows, noise = coordinate[::stride].astype(float), sigma[::stride].astype(float)
    slope = np.abs(np.diff(rows, axis=1))
    if not np.isfinite(slope).any():
        return view
    steep = float(np.nanmedian(slope))
    reach = _reach(code, size, steep)
    bend = _second(rows, reach)
    expected = np.sqrt(_shifted(noise, reach) + 4 * noise[:, reach:-reach] ** 2)
    use = np.isfinite(bend) & np.isfinite(expected)
    if use.sum() < _FEWEST:
        return view
    frequencies = _frequencies(code, size, reach * steep)
    terms = [_second(wave, reach)[use] for wave in _waves(rows, frequencies)]
    weights, left = _fitted(np.stack(terms, axis=1) if terms else np.empty((use.sum(), 0)), bend[use], expected[use])
    ripple = np.zeros(view.coordinate.shape)
    for weight, wave in zip(weights, _waves(view.coordinate.astype(float), frequencies), strict=True):
        ripple += weight * wave
    inflation = max(1.0, MAD * float(np.median(np.abs(left) / expected[use])))
    return replace(
        view,
        coordinate=(view.coordinate - ripple).astype(np.float32),
        sigma=(view.sigma * np.float32(inflation)).astype(np.float32),
    )


def _along(values: NDArray[np.float32], axis: str) -> NDArray[np.float32]:
    """With the coordinate rising along the second axis."""
    return values if axis == "x" else values.T


def _frequencies(code: FringeCode, size: int, reach_px: float) -> list[float]:
    """Of the ripples that second differences over so many projector pixels show, radians per pixel, each once."""
    orders = {
        count * times
        for count, steps in zip(code.counts, code.step_counts, strict=True)
        for times in (*_UNEVEN, *(steps * order for order in _ORDERS))
    }
    frequencies = [2 * np.pi * order / size for order in sorted(orders)]
    return [own for own in frequencies if 4 * np.sin(own * reach_px / 2) ** 2 > _LEAST_SHOWN]


def _reach(code: FringeCode, size: int, slope: float) -> int:
    """Camera pixels across half a ripple of the projector's gamma, over which second differences show it best."""
    first = [2 * np.pi * count * steps / size for count, steps in zip(code.counts, code.step_counts, strict=True)]
    return max(1, round(np.pi / (float(np.median(first)) * slope))) if first and slope > 0 else 1


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
