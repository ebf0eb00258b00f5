"""Both edges of a gap from what both cameras see of it, at all stations of a seam at once.

The seam's stations share the gap's shape: the chamfers' widths, the floor's depth (or sealant up to the edges), the
direction of the walls, and each camera's blur. Each station has its own borders C (where the skins end) and its own
brightness of every region (`model`). The ideal edges D′ and G′ lie a chamfer's width beyond the borders.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from metrology.arrays import Array, Mask
from metrology.robust import MAD
from metrology.seams.gap.floor import Floor
from metrology.seams.gap.lap_shadow import wall_and_shadow
from metrology.seams.gap.levels import COURSE_SCATTER, courses
from metrology.seams.gap.prior import LEAN, LEAN_CHANGE, SLOPE, WIDTH_A, WIDTH_B
from metrology.seams.gap.profiles import Profiles
from metrology.seams.gap.shape import fit_shape, fit_shape_again, sealant_doubt
from metrology.seams.gap.solver import ACROSS, State, fit_borders_from

# Stations whose squared residuals exceed the usual ones so many times show something else than this gap.
_ODD = 8.0
# From so many widths on their scatter tells their uncertainty: that it is more than expected, and (to a fifth) less.
_MIN_WIDTHS, _MANY_WIDTHS = 8, 32
# Where they scatter so many times more than expected, pixels' noise is taken for larger by that from then on.
_STREAKY = 1.5
# The levels' courses follow from the fit, and the fit from them.
_LEVEL_ROUNDS = 2
# What a step's wall and shadow send back differs from the gap's own walls: that share of their width is not known.
_WALL_SHARE = 0.1


@dataclass(frozen=True)
class GapFit:
    """Fitted borders and shape."""

    borders: Array
    """(n, 2): x of C on skins A and B, mm."""
    chamfers_mm: Array
    """(2,): widths of A's and B's."""
    chamfer_slope: float
    """Tangent of their angle against the skin."""
    leans: Array
    """(n,): tangent of the walls' angle from the skin's normal, towards B with depth."""
    sealed: bool
    """Whether sealant joins both edges."""
    sigma_own_mm: Array
    sigma_common_mm: float
    """sigma_own_mm, sigma_common_mm: (n,), float: standard deviation of the width: by each station's own pixels, and by
    the common shape."""
    sound: Mask
    """(n,) of bool: whether a station shows the gap that its seam has."""


def fit_gap(profiles: Profiles, floors: Sequence[Floor]) -> GapFit:
    """Fit borders and shape.

    Parameters
    ----------
    floors : sequence of Floor
        What may close the gap below; the pictures decide.
    """
    shape, borders, sigma_common = fit_shape(profiles, floors)
    final = fit_borders_from(profiles, borders, shape)
    scatter = _scatter(final)
    if scatter > _STREAKY:
        profiles = replace(profiles, variance=scatter**2 * profiles.variance)
    for _ in range(_LEVEL_ROUNDS):
        along = courses(profiles.places, final.levels - final.usual_levels)
        profiles = replace(profiles, courses=along, level_scatter=COURSE_SCATTER)
        shape, borders, sigma_common = fit_shape_again(profiles, final)
        final = fit_borders_from(profiles, borders, shape)
    beside_step = _WALL_SHARE * float(np.median(wall_and_shadow(profiles).max(axis=1)))
    sigma_common = float(np.linalg.norm([sigma_common, sealant_doubt(profiles, final), beside_step]))
    sound = _is_sound(final, profiles)
    if not sound.all() and sound.any():
        # Where a shadow or a scratch was taken for a border, its neighbours know better.
        places = profiles.places
        near = [np.interp(places[~sound], places[sound], side) for side in final.borders[sound].T]
        again = fit_borders_from(profiles.at(np.flatnonzero(~sound)), np.stack(near, axis=1), shape)
        final = final.with_stations(~sound, again)
        sound = _is_sound(final, profiles)
    return GapFit(
        borders=final.borders,
        chamfers_mm=shape.shared[[WIDTH_A, WIDTH_B]],
        chamfer_slope=float(shape.shared[SLOPE]),
        leans=shape.shared[LEAN] + profiles.places * shape.shared[LEAN_CHANGE],
        sealed=shape.known.floor.sealed,
        sigma_own_mm=_sigma(final) * _scatter(final),
        sigma_common_mm=sigma_common,
        sound=sound,
    )


def _is_sound(state: State, profiles: Profiles) -> Mask:
    """Whether each station's residuals are like the others'."""
    per_bin = state.costs / np.maximum(profiles.sizes.sum(axis=1), 1)
    return np.asarray(per_bin < _ODD * np.median(per_bin))


def _sigma(state: State) -> Array:
    """(n,) of each station's width with the shape known, mm."""
    return np.asarray(np.sqrt(ACROSS @ np.linalg.inv(state.normals[:, :2, :2]) @ ACROSS))


def _scatter(state: State) -> float:
    """How much widths of stations that share no pixel scatter about their neighbours' mean, relative to expectation.

    Neighbouring stations' strips overlap, the next but one does not. Pixels' errors go together along streaks, which
    makes it more than expected; the errors of rendering that are reckoned with are much the same at all stations, which
    makes it less.
    """
    widths, sigma = state.widths, _sigma(state)
    if len(widths) < _MIN_WIDTHS:
        return 1.0
    expected = np.sqrt(sigma[2:-2] ** 2 + 0.25 * (sigma[:-4] ** 2 + sigma[4:] ** 2))
    ratio = MAD * float(np.median(np.abs(widths[2:-2] - 0.5 * (widths[:-4] + widths[4:])) / expected))
    return ratio if len(widths) >= _MANY_WIDTHS else max(1.0, ratio)
