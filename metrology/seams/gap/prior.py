"""What a seam's stations share, and what is known of it before any picture is seen.

All of it is wide: it decides only what the pictures leave open, and goes into the uncertainty as such.
"""

from __future__ import annotations

import itertools
from copy import copy

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.seams.gap.floor import Floor
from metrology.seams.gap.model import (
    CHAMFER_A,
    CHAMFER_B,
    DARK_FLOOR,
    DARK_WALL,
    LEVELS,
    LIT_FLOOR,
    LIT_WALL,
    SKIN_A,
    SKIN_B,
    SKY,
    SLOPE_A,
    SLOPE_B,
)
from metrology.seams.gap.profiles import Profiles

# What is shared, in this order: the chamfers' widths, the floor's depth (mm), the walls' lean in the middle of the
# seam, the chamfers' slope, the lean's change from the middle to the end (tangents), spill, each camera's lens (px),
# each camera's usual levels.
WIDTH_A, WIDTH_B, DEPTH, LEAN, SLOPE, LEAN_CHANGE, SPILL, LENSES = range(8)

# Means and standard deviations. Broken edges are tenths of a millimetre wide and, broken by hand, keep the drawing's
# angle within some six degrees; substructure lies a few millimetres down; edges are cut square to the skin within two
# degrees. A lens at f/8 blurs by diffraction alone by 0.42 λ N = 1.9 µm, half a pixel of 3.45 µm, and defocus adds as
# much and more; a little light goes to a pixel's neighbours.
_BROKEN_EDGE_MM = (0.3, 0.5)
_GAP_DEPTH_MM = (2.0, 3.0)
_SQUARE = (0.0, 0.03)
# Of the slope, relative to the drawn one.
_SLOPE_SIGMA = 0.2
_SPILL = (0.05, 0.1)
_LENS_PX = (0.55, 0.5)
# The floor's depth as the points show it varies and errs by this.
_FLOOR_SIGMA_MM = 0.2
# Both edges of a joint are broken by one tool, and both cameras have like lenses, to this standard deviation. Turned
# from highlights, a chamfer looks alike from both cameras; that of the other side is turned the other way, and where
# the skin is glossy one of them may well be half as bright again.
_ALIKE_EDGES_MM = 0.05
_ALIKE_LENSES_PX = 0.1
_ALIKE_VIEWS, _ALIKE_SIDES = 0.1, 0.3
# Bounds, up to the lenses (the slope's are its own); and of the lenses.
_LOWEST = (0.0, 0.0, 0.0, -0.5, 0.0, -0.5, 0.0)
_HIGHEST = (2.0, 2.0, 12.0, 0.5, np.inf, 0.5, 0.24)
_LENS_BOUNDS_PX = (0.05, 2.0)
# Of the slope, relative to the drawn one: of 45°, between 27° and 63°.
_SLOPE_BOUNDS = np.array([0.5, 2.0])
# Of walls and chamfers.
_DIRECTIONS = (LEAN, SLOPE, LEAN_CHANGE)
_NO_CHANCE = 3.0  # standard deviations
# What only open gaps have: sealant fills the chamfers too, and hides the walls.
_OF_OPEN_GAPS = (WIDTH_A, WIDTH_B, DEPTH, *_DIRECTIONS)


class Prior:
    """Normal prior of what is shared.

    Parameters
    ----------
    profiles : Profiles
        Of what stands around the gap: cameras, lamp, chamfers as drawn.
    """

    def __init__(self, profiles: Profiles, floor: Floor) -> None:
        self.floor = floor
        ambient, slope = profiles.ambient, profiles.chamfer_slope
        self.lenses = range(LENSES, LENSES + len(ambient))
        # Direct light grazes the walls.
        grazing = float(np.median(np.abs(profiles.lamps[:, 0]) / profiles.lamps[:, 1]))
        spread = [_BROKEN_EDGE_MM, _BROKEN_EDGE_MM, _depth(floor), _SQUARE, (slope, _SLOPE_SIGMA * slope)]
        spread += [_SQUARE, _SPILL]
        spread += [_LENS_PX] * len(ambient)
        spread += [level for share in ambient for level in _levels(float(share), grazing)]
        self.mean, sigma = np.array(spread, float).T
        self.precision = np.diag(sigma**-2.0)
        self._alike(WIDTH_A, WIDTH_B, _ALIKE_EDGES_MM)
        for lens in self.lenses[1:]:
            self._alike(LENSES, lens, _ALIKE_LENSES_PX)
        levels = range(self.lenses.stop, len(self.mean), LEVELS)
        for first in levels:
            self._alike(first + CHAMFER_A, first + CHAMFER_B, _ALIKE_SIDES)
        for first, second in itertools.pairwise(levels):
            for chamfer in (CHAMFER_A, CHAMFER_B):
                self._alike(first + chamfer, second + chamfer, _ALIKE_VIEWS)
        self.free = np.setdiff1d(np.arange(len(sigma)), _OF_OPEN_GAPS if floor.sealed else ())

    def _alike(self, i: int, j: int, sigma: float) -> None:
        difference = np.zeros(len(self.mean))
        difference[[i, j]] = 1.0, -1.0
        self.precision += np.outer(difference, difference) / sigma**2

    def without_chamfers(self) -> Prior:
        """The same with both chamfers held as they are."""
        return self._holding(WIDTH_A, WIDTH_B, SLOPE)

    def of_usual_cameras(self) -> Prior:
        """The same with blur and directions held as they are: far from the solution they would go astray."""
        return self._holding(*_DIRECTIONS, SPILL, *self.lenses)

    def of_square_walls(self) -> Prior:
        """The same with directions held as they are."""
        return self._holding(*_DIRECTIONS)

    def _holding(self, *fixed: int) -> Prior:
        """The same with so much more held fixed."""
        other = copy(self)
        other.free = np.setdiff1d(self.free, fixed)
        return other

    def cost(self, shared: Array) -> float:
        """Squared standard deviations from the mean."""
        away = shared - self.mean
        return float(away @ self.precision @ away)

    def strain(self, shared: Array) -> float:
        """How many times farther than expected the directions of walls and chamfers are from their means; 1 at least.

        Far beyond what edges are cut to, they stand in for something that the model does not hold, and do so less well
        than their own uncertainty says (Birge 1932). Where one is as far off as none is by chance, it counts alone.
        """
        chosen = list(_DIRECTIONS)
        away = np.abs(shared - self.mean)[chosen] * np.sqrt(np.diag(self.precision)[chosen])
        worst = float(away.max())
        return worst if worst > _NO_CHANCE else float(np.sqrt(max(1.0, np.mean(away**2))))

    @property
    def limits(self) -> tuple[Array, Array, NDArray[np.int64], Array, Array]:
        """Mean, precision, what is free, and the lowest and highest values that can be."""
        bounds = np.stack([np.full(len(self.mean), -np.inf), np.full(len(self.mean), np.inf)])
        bounds[:, :LENSES] = _LOWEST, _HIGHEST
        bounds[:, SLOPE] = _SLOPE_BOUNDS * self.mean[SLOPE]
        bounds[:, self.lenses.start : self.lenses.stop] = np.array(_LENS_BOUNDS_PX)[:, None]
        return self.mean, self.precision, self.free, bounds[0], bounds[1]


def _depth(floor: Floor) -> tuple[float, float]:
    if floor.sealed:
        return max(floor.depth_mm or 0.0, 0.0), _FLOOR_SIGMA_MM
    return _GAP_DEPTH_MM if floor.depth_mm is None else (floor.depth_mm, _FLOOR_SIGMA_MM)


def _levels(ambient: float, grazing: float) -> list[tuple[float, float]]:
    """Of a seam's usual levels, relative to the skin's.

    A chamfer at 45° is 0.7 times as bright as skin that is matt, and hardly lit where the skin shines towards the
    cameras: anything from 0.1 to 0.8, which is 0.35 for two views that are alike. Substructure is primed, mostly
    darker than skin. Walls are cut through metal that sends back about half of what it gets: of the ambient light
    half the sky at most, of the direct light what `grazing` (the tangent of the lamp's angle) leaves. In the depth
    of a gap there is less sky; but as far as what does not follow the fringes is the sensor's dark level, all of it
    is there, and does not darken towards the walls.
    """
    dark, spread, direct = 0.25 * ambient, 0.35 * ambient, 0.5 * grazing
    known = {
        SKIN_A: (1.0, 0.1), SKIN_B: (1.0, 0.1), SLOPE_A: (0.0, 0.01), SLOPE_B: (0.0, 0.01),
        CHAMFER_A: (0.45, 0.5), CHAMFER_B: (0.45, 0.5), LIT_FLOOR: (0.4, 0.3),
        LIT_WALL: (dark + direct, spread + direct), DARK_WALL: (dark, spread), DARK_FLOOR: (dark, spread),
        SKY: (dark, spread),
    }  # fmt: skip
    return [known[level] for level in range(LEVELS)]
