"""Skin that is bent on one side of a seam only, as a dent's foot bends it: what the skin lines make of it.

Both skin lines have one curvature. Where one side bends by itself, the common curvature takes half of the bend, and
lines and step give way: by β (L²/6 + L δ) for a bend of βx² over a side of length L that begins δ from the line's end.
What is left of the points' residuals is small, a thirtieth of βL², but of a known shape: side A's turn one way, side
B's the other. How far neighbouring sections' residuals go along with it says how far the step may be off.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrology.arrays import Array
from metrology.results import COVERAGE_95, SeamStation
from metrology.seams.skins.sections import Section
from metrology.seams.skins.step import step_gradient

_FEWEST_POINTS = 5  # of each stretch
_FEWEST_SECTIONS = 8
# Sections this near to one, before and behind: seven strips, 16 mm.
_HEREABOUTS = 3
_BY_CHANCE = 2.0  # times the seam's usual is what chance makes of seven sections
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
    u95 = COVERAGE_95 * np.sqrt(np.maximum(power - _BY_CHANCE * usual, 0.0))
    return [
        row.changed(step_u95_mm=float(off)) if row.step_u95_mm is not None and row.step_u95_mm < off else row
        for row, off in zip(rows, u95, strict=True)
    ]


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
