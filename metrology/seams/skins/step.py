"""Step of a seam from its skin lines, and its uncertainty (paper §4.2, eqs 6–8)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrology.arrays import Array
from metrology.fits import SectionFit, SkinLine
from metrology.results import COVERAGE_95, SeamStation
from metrology.seams.skins.sections import Section


def signed_distance(x: float, h: float, line: SkinLine) -> float:
    """Distance of a point from a skin line, positive outside the skin: eqs 7 and 8 with a sign, curved lines too."""
    return (h - line.height(x)) / float(np.hypot(1.0, line.slope(x)))


def step_height(section: Section | SectionFit, a: float, b: float) -> float:
    """H_gap, eq 6 with a sign: how much higher side B lies than side A, as the mean of what both edges say."""
    d_prime = -signed_distance(a, section.a.height(a), section.b)
    g_prime = signed_distance(b, section.b.height(b), section.a)
    return 0.5 * (d_prime + g_prime)


def step_gradient(a: float, b: float) -> Array:
    """(5,) derivative of the step by a's c_0, c_1, b's c_0, c_1, c_2: how the skin lines' covariance enters."""
    middle = 0.5 * (a + b)
    # Both curves share c_2, which cancels in their difference.
    return np.array([-1.0, -middle, 1.0, middle, 0.0])


def step_u95(section: Section, a: float, b: float) -> float:
    """Expanded uncertainty of the step, from the skin lines' covariance."""
    gradient = step_gradient(a, b)
    return COVERAGE_95 * float(np.sqrt(gradient @ section.covariance @ gradient))


def with_unresolved_bends(rows: Sequence[SeamStation], station_step: float, half_length: float) -> list[SeamStation]:
    """What a seam station's strip does not resolve, added to the step's uncertainty.

    The mean over ±ε_d of a step that bends along the seam by h″ is off by ``h″ ε_d²/6``; the nearest seam stations
    before and behind that share no point with it tell h″.
    """
    apart = int(np.ceil(2 * half_length / station_step))
    step = np.array([np.nan if row.step_mm is None else row.step_mm for row in rows])
    bend = np.zeros(len(rows))
    bend[apart:-apart] = step[2 * apart :] - 2 * step[apart:-apart] + step[: -2 * apart]
    missed = np.nan_to_num(bend) / (apart * station_step) ** 2 * half_length**2 / 6
    return [
        row.changed(step_u95_mm=float(np.hypot(row.step_u95_mm, COVERAGE_95 * off))) if row.step_u95_mm else row
        for row, off in zip(rows, missed, strict=True)
    ]
