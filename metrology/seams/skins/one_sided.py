"""Skin that is bent on one side of a seam only, as a dent's foot bends it: what the skin lines make of it.

Both skin lines have one curvature. Where one side bends by itself, the common curvature takes half of the bend, and
lines and step give way: by β (L²/6 + L δ) for a bend of βx² over a side of length L that begins δ from the line's end.
What is left of the points' residuals is small, a thirtieth of βL², but of a known shape: side A's turn one way, side
B's the other. How far neighbouring sections' residuals go along with it says how far the step may be off.

Where a foot begins farther out, both lines fit well, and the step is off all the same. But the line on its side leans:
the kink between both lines changes along the seam as no plate of metal is twisted.

And what a curvature of its own on each side would make of the step is a rival of the common one: where that is another
over 30 mm along a seam, the step rests on what both sides are taken to have in common, and may be off by as much. So
may one of which a border cuts the strip, by what a twist of the skin makes of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrology.arrays import Array
from metrology.results import COVERAGE_95, SeamStation
from metrology.robust import MAD
from metrology.seams.skins.sections import Section
from metrology.seams.skins.step import step_gradient

_FEWEST_POINTS = 5  # of each stretch
_FEWEST_SECTIONS = 8
# Sections this near to one, before and behind: seven strips, 16 mm.
_HEREABOUTS = 3
_BY_CHANCE = 2.0  # times the seam's usual is what chance makes of seven sections
# A foot that begins beside the edge, in the middle of a side or near its end moves the step by −0.05 to 0.3 of the kink
# times the side's length, most where the kink itself is past its greatest: this share of what it is within 12 mm.
_OF_A_KINK = 0.125
_KINKED = 6
_QUIET, _KINKS_BY_CHANCE = 0.25, 3.0  # the quietest quarter of a seam has no dent beside it; chance makes so much of it
_LINE_ROUNDS = 20
_RIVAL = 7  # sections before and behind over which the rival's step is averaged: by itself it scatters twice as much
_BESIDE, _MOST_KINK = 3, 0.03  # sections before and behind; 1.7°, of 15 mm of skin 0.4 mm
_TOLD = 0.002  # share of the bend's shape (its square) that lines leave: 0.02 where all of both sides is seen


def with_one_sided_bends(
    rows: Sequence[SeamStation], sections: Sequence[Section | None], edges_mm: Sequence[tuple[float, float]]
) -> list[SeamStation]:
    """The rows of a seam with a U95 of the step that holds what bends of one side may move it by.

    Parameters
    ----------
    sections : sequence of Section or None
        Of one seam, in order, as their own points give them.
    edges_mm : sequence of (float, float)
        x of both edges.
    """
    moved = step_moved_by_bends(sections, edges_mm)
    if np.isfinite(moved).sum() < _FEWEST_SECTIONS:
        return list(rows)
    padded = np.pad(moved**2, _HEREABOUTS, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _HEREABOUTS + 1)
    known = np.isfinite(windows)
    power = np.where(known, windows, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    usual = float(np.median(power[np.isfinite(moved)]))
    bent = np.maximum(power - _BY_CHANCE * usual, 0.0)
    u95 = COVERAGE_95 * np.sqrt(np.maximum(bent, _step_moved_by_kinks(sections)))
    u95 = np.maximum(u95, np.abs(_rival_step(sections)))
    u95 = np.maximum(u95, [0.0 if section is None else section.twist_step for section in sections])
    return [
        row.changed(step_u95_mm=float(off)) if row.step_u95_mm is not None and row.step_u95_mm < off else row
        for row, off in zip(rows, u95, strict=True)
    ]


def stand_out(sections: Sequence[Section | None]) -> list[bool]:
    """Whether the skin lines of each section meet at another angle than those just before and behind it.

    Plates do not; a bead or a drop beside the seam that covers a good part of one side's points draws its line there.
    """
    kinks = np.array([np.nan if s is None else s.b.coefficients[1] - s.a.coefficients[1] for s in sections])
    found = []
    for k, kink in enumerate(kinks):
        beside = np.concatenate([kinks[max(0, k - _BESIDE) : k], kinks[k + 1 : k + 1 + _BESIDE]])
        beside = beside[np.isfinite(beside)]
        found.append(len(beside) > _BESIDE and bool(abs(kink - np.median(beside)) > _MOST_KINK))
    return found


def _rival_step(sections: Sequence[Section | None]) -> Array:
    """(n,) by how much the steps hereabouts would be others with a curvature of its own on each side, mm."""
    moved = np.array([0.0 if section is None else section.own_curvatures_step for section in sections])
    known = np.array([section is not None for section in sections], float)
    window = np.ones(2 * _RIVAL + 1)
    total, count = (np.convolve(np.pad(values, _RIVAL), window, "valid") for values in (moved, known))
    return np.asarray(total / np.maximum(count, 1.0))


def _step_moved_by_kinks(sections: Sequence[Section | None]) -> Array:
    """(n,) mean square of what the step may be off where the kink between both skin lines changes along a seam, mm²."""
    kinks = np.array([np.nan if s is None else s.b.coefficients[1] - s.a.coefficients[1] for s in sections])
    lengths = [s.misfit[1].max() - s.misfit[1].min() for s in sections if s is not None]
    known = np.isfinite(kinks)
    if known.sum() < _FEWEST_SECTIONS:
        return np.zeros(len(sections))
    # Plates may be twisted against each other evenly.
    along, changed = np.arange(len(kinks))[known], kinks[known]
    line = np.stack([np.ones(len(along)), along], axis=1)
    weights = np.ones(len(along))
    for _ in range(_LINE_ROUNDS):
        fit = np.linalg.lstsq(line * weights[:, None], changed * weights)[0]
        off = changed - line @ fit
        weights = 1 / np.sqrt(1 + (off / (2 * MAD * float(np.median(np.abs(off))) + 1e-12)) ** 2)
    power, count = np.zeros(len(kinks)), np.zeros(len(kinks))
    power[known], count[known] = off**2, 1.0
    window = np.ones(2 * _KINKED + 1)
    power, count = (np.convolve(np.pad(a, _KINKED), window, "valid") for a in (power, count))
    power /= np.maximum(count, 1.0)
    quiet = float(np.quantile(power[known], _QUIET))
    side = 0.5 * float(np.median(lengths))
    return np.asarray((_OF_A_KINK * side) ** 2 * np.maximum(power - _KINKS_BY_CHANCE * quiet, 0.0))


def step_moved_by_bends(sections: Sequence[Section | None], edges_mm: Sequence[tuple[float, float]]) -> Array:
    """(n,) by how much each section's step is off if what its residuals show is a bend of one side, mm; NaN if unknown.

    The bend is βx² from the edge on, β on side A and −β on side B: what both have in common is the common curvature.
    """
    moved = np.full(len(sections), np.nan)
    misfits = {k: s.misfit for k, s in enumerate(sections) if s is not None and s.misfit[0].min() >= _FEWEST_POINTS}
    if not misfits:
        return moved
    index = np.array(list(misfits))
    count, x, residual = np.array(list(misfits.values())).transpose(1, 0, 2)
    first, last = np.array([edges_mm[k] for k in index]).T[..., None]
    a = (x < 0).astype(float)
    b = 1 - a
    lines = np.stack([a, a * x, b, b * x, x * x], axis=-1)
    bend = a * (first - x) ** 2 - b * (x - last) ** 2
    weighted = (lines * count[..., None]).transpose(0, 2, 1)
    taken = np.linalg.solve(weighted @ lines + 1e-12 * np.eye(5), weighted @ bend[..., None])
    left = bend - (lines @ taken)[..., 0]
    size = (count * left**2).sum(axis=1)
    seen = size > _TOLD * (count * bend**2).sum(axis=1)
    gradient = np.array([step_gradient(*edges_mm[k]) for k in index])
    step = (gradient[:, None] @ taken)[:, 0, 0]
    moved[index[seen]] = (step * (count * left * residual).sum(axis=1) / np.where(seen, size, 1.0))[seen]
    return moved
