"""What the residuals of a seam's skin lines say of the lines' uncertainty.

Neighbouring points' errors go together, across the seam (clumping) and along it (shared noise).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrology.arrays import Array
from metrology.seams.skins.sections import Section
from metrology.seams.skins.skin_lines import CLUMPING_MEDIAN

# Sections this near to one, before and behind, tell how even its skin is: seven strips, 16 mm.
_HEREABOUTS = 3
# By chance the median of seven is seldom more than twice the usual.
_BY_CHANCE, _OF_A_BEND = 2.0, 10.0
# Residuals are compared along the seam this far, mm, and from so many sections on.
_REACH_MM = 16.0
_FEWEST_SECTIONS = 8
_ROUNDING_MM = 1e-6


def clumpings(sections: Sequence[Section | None]) -> Array:
    """(n,) how much more each section's skin lines vary than if its points were independent.

    How neighbouring points' errors go together is the same all along; one section tells it poorly, and one with dirt in
    it wrongly. Where all in a row have much more, the skin is bent as no line with the seam's curvature is: a dent near
    by. With a bend of βx² over a side of length L that begins δ from the edge, the residuals' four stretches vary by
    (βL²/16)², and the line is off by β (L²/6 + Lδ) at the edge: ten times what independent stretches would make it.
    """
    single = np.array([np.nan if section is None else section.clumping for section in sections])
    known = np.isfinite(single)
    if not known.any():
        return np.ones(len(sections))
    usual = float(np.median(single[known]))
    padded = np.pad(single, _HEREABOUTS, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _HEREABOUTS + 1)
    local = np.full(len(sections), usual)
    local[known] = np.nanmedian(windows[known], axis=1)
    bent = np.maximum(local - _BY_CHANCE * usual, 0.0)
    return np.asarray(np.maximum(usual / CLUMPING_MEDIAN, 1.0) + _OF_A_BEND * bent)


def shared_share(sections: Sequence[Section | None], s_mm: Array, half_length: float) -> float:
    """How much of the residuals' variance goes on along the seam, from stretches of skin at the same distance from it.

    Errors of the fringes and of matching follow the fringes' and the pixel grid's directions: along some seams they are
    the same from station to station.

    Parameters
    ----------
    sections : sequence of Section or None
        Of one seam, in order.
    s_mm : (n,) ndarray
    half_length : float
        ε_d, mm.
    """
    known = np.array([k for k, section in enumerate(sections) if section is not None], int)
    if len(known) < _FEWEST_SECTIONS:
        return 0.0
    stretches = np.array([section.stretches for section in sections if section is not None])
    away = np.abs(s_mm[known][None] - s_mm[known][:, None])
    near = (away <= _REACH_MM + _ROUNDING_MM) & (away >= 2 * half_length - _ROUNDING_MM)
    if not near.any():
        return 0.0
    products = stretches @ stretches.T
    return float(np.clip(products[near].mean() / np.diag(products).mean(), 0.0, 1.0))
