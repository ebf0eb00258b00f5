"""What a code's frames say of its conventions: phase offsets, sign of the steps, order of the bits, stripes' borders.

Counts without a common factor leave a pattern: the lattice coordinates of their wrapped phases have one and the same
fraction at every pixel, and that fraction tells the offsets. Against Gray code, phases must rise where the stripes'
numbers rise, and the borders of stripes lie at one phase.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.binary_code import gray_swings
from metrology.errors import SceneError
from metrology.fringe import FringeCode
from metrology.gray import resolved_bits, runs_along_rows, stripe_numbers
from metrology.unwrap import order_lattice

_LEAST_AMPLITUDE = 0.02  # of the range
_LEAST_PIXELS = 500
_LEAST_BY_ONE = 0.75  # of neighbours in two stripes: how many are in this and the next; half where bits are misread
_LEAST_AGREEMENT = 0.7  # length of the mean of unit vectors: below, there is no one fraction
_SAME = 0.04  # of a lattice step: offsets this near are alike; or as near as the pixels' own fractions are
_APART = 0.1  # radians: offsets farther apart are not the same one
_NEAR = 12  # pixels over which stripe numbers are seen to rise
_USUAL = (0.0, -np.pi / 2, np.pi / 2, np.pi)  # cosine, sine and their negatives


@dataclass(frozen=True)
class CodeGuess:
    """Conventions under which a camera's frames agree."""

    direction: int
    """Sign of the phase steps; that of codes without Gray code cannot be told and is 1."""
    lsb_first: bool
    """Whether the Gray-code frames begin with the finest stripes."""
    code: FringeCode
    """With the phase offsets and the shift of the stripes that were found."""
    agreement: float
    """From 0, chance, to 1."""
    inverse_first: bool = False
    """Whether each bit's inverse comes before the bit."""
    binary: bool = False
    """Whether the stripes count in plain binary, not in Gray code."""
    others: tuple[float, ...] = ()
    """Offsets at which the counts agree as well; the coordinate is then another part of the projector's width."""


def guess_code(frames: NDArray, code: FringeCode, saturation: float) -> CodeGuess:
    """Find the conventions of one camera's frames.

    Parameters
    ----------
    frames : (code.frames, h, w) ndarray of uint8 or uint16
        Of one exposure: count by count, step by step, then Gray code, as shown.
    code : FringeCode
        Its shift is not looked at; its offset is taken where it fits, one for all counts.
    saturation : float
        Grey level from which a sample counts as saturated.

    Raises
    ------
    SceneError
        Where no conventions make the frames agree.
    """
    levels = frames.astype(np.float32)
    plain = replace(code, phase_offsets_rad=(), gray=code.gray and replace(code.gray, shift=0.0))
    turns, lit = _phases(levels, plain, saturation)
    if lit.sum() < _LEAST_PIXELS:
        raise SceneError(f"found {int(lit.sum())} pixels with fringes or stripes, expected at least {_LEAST_PIXELS}")
    if plain.gray and plain.gray.references and np.median((levels[-2] - levels[-1])[lit]) < 0:
        raise SceneError("found the all-white frame darker than the all-black one, expected white before black")
    if plain.gray is None:
        return _from_counts(turns[:, lit].astype(float), plain, code.phase_offsets_rad)
    return _from_stripes(levels, turns, lit, plain)


def _phases(levels: NDArray, code: FringeCode, saturation: float) -> tuple[NDArray, NDArray[np.bool_]]:
    """(counts, h, w) wrapped phases in turns, and where all frames carry their pattern."""
    # A bright stripe may be clipped and still is bright; fringes may not, where they are shown.
    measured = levels[: code.fringe_frames] if code.counts else levels
    lit = (measured.max(0) < saturation) | bool(code.gray and code.gray.inverse and not code.counts)
    lit &= levels.max(0) - levels.min(0) > 2 * _LEAST_AMPLITUDE * saturation
    turns = []
    for k, steps in enumerate(code.step_counts):
        own = code.count_of == k
        phasor = np.tensordot(np.exp(-1j * code.step_angles[own]), levels[: code.fringe_frames][own], 1) * 2 / steps
        lit &= np.abs(phasor) > _LEAST_AMPLITUDE * saturation
        turns.append(np.angle(phasor) / (2 * np.pi))
    return np.array(turns).reshape(-1, *levels.shape[1:]), lit


def _from_counts(turns: Array, code: FringeCode, declared: tuple[float, ...]) -> CodeGuess:
    """Offsets from the fractions of the lattice coordinates; those declared, or else the usual ones, where they fit."""
    if len(code.counts) == 1:
        return CodeGuess(1, False, code, 1.0)
    lattice = order_lattice(code.counts)
    mean = np.exp(2j * np.pi * (lattice.to_lattice @ turns)).mean(1)
    agreement = float(np.abs(mean).min())
    if agreement < _LEAST_AGREEMENT:
        raise SceneError(
            f"found fringes that contradict each other whatever their offsets (agreement {agreement:.2f} of 1), "
            f"expected counts {', '.join(map(str, code.counts))} in this order, their steps even over a whole turn"
        )
    fraction = np.angle(mean) / (2 * np.pi)
    # What makes the pixels' fractions differ (gamma, light that changes) may well move their mean by as much.
    same = max(_SAME, float(np.sqrt(-2 * np.log(agreement))) / (2 * np.pi))
    alike = np.ones(len(code.counts)) / (2 * np.pi)
    others: list[float] = []

    def missed(psi: float) -> float:
        return float(np.abs(_fraction(lattice.to_lattice @ (alike * psi) - fraction)).max())

    fitting = _alike(missed, same)
    if len(set(declared)) == 1 and missed(declared[0]) <= same:
        offsets = np.array(declared)
    elif fitting:
        usual = [psi for psi in _USUAL if missed(psi) <= same]
        best = usual[0] if usual else min(fitting, key=abs)
        apart = [psi for psi in fitting if abs(np.angle(np.exp(1j * (psi - best)))) > _APART]
        others = [psi for psi in apart if not _one_range(psi, best, missed, same)]
        offsets = np.full(len(code.counts), best)
    else:
        f = lattice.counts
        offsets = 2 * np.pi * (lattice.basis - np.outer(f, f @ lattice.basis) / (f @ f)) @ fraction
    told = replace(code, phase_offsets_rad=tuple(float(o) for o in offsets))
    return CodeGuess(1, False, told, agreement, others=tuple(others))


def _alike(missed: Callable[[float], float], same: float) -> list[float]:
    """Offsets, one for all counts, at which the fractions are hit; counts such as 1, 8, 64 leave several of them."""
    grid = np.linspace(-np.pi, np.pi, 721)[:-1]
    off = np.array([missed(float(psi)) for psi in grid])
    least = (off <= np.roll(off, 1)) & (off < np.roll(off, -1)) & (off <= same)
    return [float(psi) for psi in grid[least]]


def _one_range(a: float, b: float, missed: Callable[[float], float], same: float) -> bool:
    """Whether all offsets between two, the shorter way round, fit."""
    between = a + np.linspace(0, 1, 32) * np.angle(np.exp(1j * (b - a)))
    return all(missed(float(psi)) <= same for psi in between)


def _from_stripes(levels: NDArray, turns: NDArray, lit: NDArray[np.bool_], code: FringeCode) -> CodeGuess:
    """The order of the bits that leaves the smoothest stripes, the sign of the phase, and where the borders lie."""
    assert code.gray is not None
    inverses = (False, True) if code.gray.inverse else (False,)
    orders = list(product((False, True), inverses, (False, True)))  # plain binary, inverse first, finest bit first
    read = {order: _numbers(levels, code, order, lit) for order in orders}
    smoothness = {order: _smooth(number, lit) for order, (number, _) in read.items()}
    # In a wrong order few bits are told apart, and the stripes of few bits are always smooth.
    best_order = max(orders, key=lambda order: (read[order][1], smoothness[order]))
    binary, turned, lsb = best_order
    smooth, number = smoothness[best_order], read[best_order][0]
    by_one = _by_one(number, lit)
    if smooth < _LEAST_AGREEMENT or by_one < _LEAST_BY_ONE:
        raise SceneError(
            f"found stripes whose numbers jump between neighbouring pixels (by one in {by_one:.0%}), expected "
            f"{code.gray.bits} bits of Gray code or plain binary, from the coarsest or the finest on"
            f"{', each beside its inverse' if code.gray.inverse else ', no inverses'}"
        )
    if not code.counts:
        return CodeGuess(1, lsb, code, smooth, turned, binary)
    if not runs_along_rows(np.where(lit, number, np.nan).astype(np.float32)):
        number, turns, lit = number.T, turns.transpose(0, 2, 1), lit.T
    k = int(np.argmin(code.counts))
    rising = _rising(number, turns[k], lit)
    direction = 1 if rising >= 0 else -1
    phase = direction * turns[k]
    per_fringe = code.gray.stripes / code.counts[k]
    pairs = lit[:, :-1] & lit[:, 1:] & (np.abs(np.diff(number, axis=1)) == 1)
    at = np.exp(2j * np.pi * per_fringe * phase)
    mean = (at[:, :-1][pairs] + at[:, 1:][pairs]).mean() / 2 if pairs.any() else 0j
    if per_fringe % 1:
        raise SceneError(f"found {per_fringe:g} stripes per fringe, expected a whole number to tell their borders by")
    best, agreement = 0.0, -1.0
    for whole in range(int(per_fringe)):
        shift = float(np.angle(mean) / (2 * np.pi)) % 1 + whole
        expected = (number + 0.5 + shift) / per_fringe
        off = float(np.mean(np.abs(_fraction(phase - expected)[lit]) < 0.55 / per_fringe))
        if off > agreement + 1e-3:
            best, agreement = shift, off
    best -= per_fringe if best > per_fringe / 2 else 0.0
    agreement = min(agreement, abs(rising))  # where a stripe is a fringe, its phase may be any
    if min(agreement, float(np.abs(mean))) < _LEAST_AGREEMENT / 2:
        raise SceneError(
            f"found fringes and stripes that do not fit each other ({agreement:.0%} of the pixels do), expected "
            f"{code.counts[k]} fringes and {code.gray.stripes} stripes over the same part of the projector"
        )
    near = abs(best) < 0.02
    gray = replace(code.gray, shift=0.0 if near else round(best, 3))
    return CodeGuess(direction, lsb, replace(code, gray=gray), agreement, turned, binary)


def _numbers(
    levels: NDArray, code: FringeCode, order: tuple[bool, bool, bool], lit: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], int]:
    """(h, w) stripe numbers with the bits in an order, of a code alone the resolved ones; and how many bits."""
    gray = code.gray
    assert gray is not None
    binary, inverse_first, lsb = order
    stripes = levels[code.fringe_frames : code.fringe_frames + gray.stripe_frames]
    if gray.inverse:
        swing = (stripes[::2] - stripes[1::2]) * (-1 if inverse_first else 1)
    elif gray.references:
        swing = stripes - 0.5 * (levels[-1] + levels[-2])
    elif code.counts:
        swing = stripes - levels[: code.fringe_frames].mean(0)
    else:
        swing = stripes - 0.5 * (stripes.max(0) + stripes.min(0))
    swing = swing[::-1] if lsb else swing
    swing = gray_swings(swing) if binary else swing
    bits = len(swing) if code.counts else resolved_bits(swing, lit)
    return stripe_numbers(swing[:bits] > 0), bits


def _smooth(number: NDArray[np.int64], lit: NDArray[np.bool_]) -> float:
    """Share of lit neighbours, along both image directions, whose stripes are neighbours."""
    shares = []
    for axis in (0, 1):
        steps = np.abs(np.diff(number, axis=axis))
        both = lit[:-1] & lit[1:] if axis == 0 else lit[:, :-1] & lit[:, 1:]
        shares.append(float((steps[both] <= 1).mean()) if both.any() else 0.0)
    return min(shares)


def _by_one(number: NDArray[np.int64], lit: NDArray[np.bool_]) -> float:
    """Of lit neighbours that see different stripes, the share that sees one and the next; 1 where there are none."""
    changes = []
    for axis in (0, 1):
        steps = np.abs(np.diff(number, axis=axis))
        both = lit[:-1] & lit[1:] if axis == 0 else lit[:, :-1] & lit[:, 1:]
        changes.append(steps[both & (steps > 0)])
    among = np.concatenate(changes)
    return float((among == 1).mean()) if among.size else 1.0


def _rising(number: NDArray[np.int64], turns: NDArray, lit: NDArray[np.bool_]) -> float:
    """From 1 where all phases rise along rows as the stripes' numbers do, to −1 where all fall; near 0: no fringes."""
    rise = np.sign(number[:, _NEAR:] - number[:, :-_NEAR])
    both = lit[:, _NEAR:] & lit[:, :-_NEAR] & (rise != 0)
    change = np.cumsum(_fraction(np.diff(turns, axis=1, prepend=0.0)), axis=1)
    step = change[:, _NEAR:] - change[:, :-_NEAR]
    return float((np.sign(step) * rise)[both].mean()) if both.any() else 0.0


def _fraction(value: NDArray) -> NDArray:
    """Turns from −½ to ½."""
    return np.asarray(value - np.rint(value))
