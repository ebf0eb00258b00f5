"""Which fringe counts to project: the least phase noise at a bearable risk of fringe-order slips."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from metrology.errors import SceneError, UsageError
from metrology.unwrap import heterodyne_beats, order_lattice, slip_probability

# Counts below this share of the largest one carry little information about the position.
_LEAST_SHARE = 0.5


@dataclass(frozen=True)
class CountChoice:
    """A set of fringe counts and what it promises."""

    counts: tuple[int, ...]
    """Falling."""
    sigma_px: float
    """Standard deviation of the fused coordinate, projector pixels."""
    slip_probability: float
    """Share of pixels with a wrong fringe order under maximum-likelihood unwrapping."""
    margin_rad: float
    """Least phase error that can make the order slip."""
    heterodyne: bool
    """Whether the paper's heterodyne can unwrap it too."""


def recommend_counts(
    size: int,
    noise: float,
    modulation: float,
    *,
    steps: int = 4,
    counts: int = 3,
    finest_period_px: float = 18.0,
    max_slip_probability: float = 1e-6,
    choices: int = 5,
) -> list[CountChoice]:
    """The best sets of fringe counts for a projector and a camera's noise, best first.

    Among the sets whose slip probability is low enough, the one with the least σ; where none is, the least likely to
    slip.

    Parameters
    ----------
    size : int
        Projector pixels along the fringe axis.
    noise : float
        Standard deviation of a camera sample, grey levels.
    modulation : float
        Fringe amplitude in the darkest regions to be measured, grey levels.
    steps : int
        Phase steps.
    counts : int
        Number of fringe counts, 2 … 4.
    finest_period_px : float
        Least fringe period the projector's and cameras' optics resolve with full contrast, projector pixels.
    choices : int
        How many sets to return at most.
    """
    largest = int(size / finest_period_px)
    _check(largest, noise, modulation, steps, counts)
    sigma_phase = np.sqrt(2 / steps) * noise / modulation
    found = []
    for rest in combinations(range(int(np.ceil(_LEAST_SHARE * largest)), largest), counts - 1):
        chosen = (largest, *rest[::-1])
        if np.gcd.reduce(chosen) == 1:
            found.append(_judge(chosen, size, sigma_phase))
    if not found:
        raise UsageError(f"fringe counts: found no {counts} counts up to {largest} without a common factor")
    found.sort(key=lambda choice: (max(choice.slip_probability, max_slip_probability), choice.sigma_px))
    return found[:choices]


def _check(largest: int, noise: float, modulation: float, steps: int, counts: int) -> None:
    if not (noise > 0 and modulation > 0):
        raise UsageError(f"fringe counts: found noise {noise:g}, modulation {modulation:g}; expected positive levels")
    if steps < 3:
        raise UsageError(f"fringe counts: found {steps} steps, expected at least 3")
    if not 2 <= counts <= 4:
        raise UsageError(f"fringe counts: found {counts} counts to choose, expected 2 … 4")
    if largest < 2 * counts:
        raise UsageError(f"fringe counts: found room for {largest} fringes, expected at least {2 * counts}")


def _judge(counts: tuple[int, ...], size: int, sigma_phase: float) -> CountChoice:
    lattice = order_lattice(counts)
    return CountChoice(
        counts=counts,
        sigma_px=float(size / (2 * np.pi) * sigma_phase / np.linalg.norm(counts)),
        slip_probability=slip_probability(lattice.shortest, sigma_phase),
        margin_rad=float(np.pi * lattice.shortest),
        heterodyne=_closes(counts),
    )


def _closes(counts: tuple[int, ...]) -> bool:
    try:
        heterodyne_beats(counts)
    except SceneError:
        return False
    return True
