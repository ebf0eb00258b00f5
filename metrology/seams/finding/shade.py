"""How much of the projector's light reaches the bottom of a narrow band.

Paint of reflectance r sends back r times the fringes and r times the mean light: its fringe amplitude B falls with its
mean level A. Into a gap the projector's narrow beam shines less than the light from all around: there B falls by more.
Bands too narrow for points of their own are told apart so.
"""

from __future__ import annotations

import numpy as np

from metrology.arrays import Array, Mask
from metrology.cloud import DecodedView
from metrology.seams.finding.medians import row_medians

# The black level is at most what this share of the pixels stays below; every so many pixels are looked at.
_DARKEST = 0.002
_EVERY = 8


def black_level(view: DecodedView) -> float:
    """Grey level of no light, or more where all of the image is lit: the darkest pixels'."""
    return float(np.nanquantile(view.texture[::_EVERY, ::_EVERY], _DARKEST))


def projected_share(texture: Array, modulation: Array, band: Mask, skin: Mask, black: float) -> Array:
    """Fringe amplitude of a band over that of paint as dark, for each piece of a line.

    ``q = (B / B_skin) / ((A − black) / (A_skin − black))``: 1 for paint, less in a gap. Too large a black level raises
    q of what is darker than the skin, and lowers that of what is brighter: the black level lies between 0 and the one
    given, and the greatest q of both tells.

    Parameters
    ----------
    texture, modulation : (p, n) ndarray
        A and B, grey levels.
    band : (n,) ndarray of bool
        Places in the band.
    skin : (p, n) ndarray of bool
        Places on the skin beside it.

    Returns
    -------
    (p,) ndarray
        NaN where the band is black.
    """
    own, beside = row_medians(texture, band), row_medians(texture, skin)
    level = own - black
    with np.errstate(divide="ignore", invalid="ignore"):
        bright = np.maximum((beside - black) / level, beside / own)
        shares = row_medians(modulation, band) / row_medians(modulation, skin) * bright
    return np.where(level > 0, shares, np.nan)
