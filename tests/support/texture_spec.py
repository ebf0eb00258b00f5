"""What a synthetic texture of riveted skin shows, and its truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array

Image = NDArray[np.float32]


@dataclass(frozen=True)
class TextureSpec:
    """What to paint.

    Attributes
    ----------
    width, height : int
        Pixels.
    rivets : (least, most)
        How many rims to place.
    radius_px : (least, most)
        Of the rims.
    contrast : (least, most)
        Of the rims, grey levels below the skin at the rim's darkest after the blur; drawn log-uniformly.
    noise : float
        Standard deviation of the sensor's noise, grey levels.
    grain : float
        Standard deviation of the brushed grain, grey levels.
    tilt_deg : float
        Largest slant of the panel.
    partial, glints, slots, bright : float
        Share of rims with a hidden arc of 30° to 110°, with a glint near them, with a screw slot, and brighter than the
        skin.
    seams, scratches, highlights, stickers, holes : int
        Of each.
    """

    width: int = 1624
    height: int = 1234
    rivets: tuple[int, int] = (16, 30)
    radius_px: tuple[float, float] = (10.0, 38.0)
    contrast: tuple[float, float] = (4.0, 30.0)
    noise: float = 2.0
    grain: float = 0.6
    tilt_deg: float = 35.0
    partial: float = 0.3
    glints: float = 0.25
    slots: float = 0.1
    bright: float = 0.05
    seams: int = 2
    scratches: int = 14
    highlights: int = 3
    stickers: int = 2
    holes: int = 2


@dataclass(frozen=True)
class RimTruth:
    """A rim as painted: the ellipse of its centre line (semi-axes, px; angle in radians) and how well it can be seen.

    Attributes
    ----------
    u, v, a, b, angle : float
    contrast : float
        Grey levels; negative where the rim is brighter than the skin.
    coverage : float
        Share of the rim that is not hidden.
    sigma_px : float
        Half-width of gap and blur.
    glint : bool
    """

    u: float
    v: float
    a: float
    b: float
    angle: float
    contrast: float
    coverage: float
    sigma_px: float
    glint: bool


@dataclass(frozen=True)
class Texture:
    """A painted image.

    Attributes
    ----------
    image : (h, w) uint8
    rims : tuple of RimTruth
    seams : tuple of (n, 2) ndarray
        u, v along the seams' centre lines.
    """

    image: NDArray[np.uint8]
    rims: tuple[RimTruth, ...]
    seams: tuple[Array, ...]
