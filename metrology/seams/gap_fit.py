"""Both edges of a gap from what both cameras see of it, at all stations of a seam at once.

The seam's stations share the gap's shape: the chamfers' widths, the floor's depth (or sealant up to the edges), the
direction of the walls, and each camera's blur. Each station has its own borders C (where the skins end) and its own
brightness of every region (`gap_view`). The ideal edges D′ and G′ lie a chamfer's width beyond the borders.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.seams.gap_floor import Floor
from metrology.seams.gap_knowledge import LEAN, LEAN_CHANGE, SLOPE, WIDTH_A, WIDTH_B
from metrology.seams.gap_profiles import Profiles
from metrology.seams.gap_shape import fit_shape
from metrology.seams.gap_solver import ACROSS, State, fit_borders_from

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Stations whose squared residuals exceed the usual ones so many times show something else than this gap.
_ODD = 8.0
# From so many widths on their scatter tells their uncertainty.
_MIN_WIDTHS = 8
_MAD = 1.4826


@dataclass(frozen=True)
class GapFit:
    """Fitted borders and shape.

    Attributes
    ----------
    borders : (n, 2) ndarray
        x of C on skins A and B, mm.
    chamfers_mm : (2,) ndarray
        Widths of A's and B's.
    chamfer_slope : float
        Tangent of their angle against the skin.
    leans : (n,) ndarray
        Tangent of the walls' angle from the skin's normal, towards B with depth.
    sealed : bool
        Whether sealant joins both edges.
    sigma_own_mm, sigma_common_mm : (n,) ndarray, float
        Standard deviation of the width: by each station's own pixels, and by the common shape.
    sound : (n,) ndarray of bool
        Whether a station shows the gap that its seam has.
    """

    borders: Array
    chamfers_mm: Array
    chamfer_slope: float
    leans: Array
    sealed: bool
    sigma_own_mm: Array
    sigma_common_mm: float
    sound: Mask


def fit_gap(profiles: Profiles, floors: Sequence[Floor]) -> GapFit:
    """Fit borders and shape.

    Parameters
    ----------
    profiles : Profiles
    floors : sequence of Floor
        What may close the gap below; the pictures decide.
    """
    shape, borders, sigma_common = fit_shape(profiles, floors)
    final = fit_borders_from(profiles, borders, shape)
    sound = _is_sound(final, profiles)
    if not sound.all() and sound.any():
        # Where a shadow or a scratch was taken for a border, its neighbours know better.
        places = profiles.places
        near = [np.interp(places[~sound], places[sound], side) for side in final.borders[sound].T]
        again = fit_borders_from(profiles.at(np.flatnonzero(~sound)), np.stack(near, axis=1), shape)
        final = final.with_stations(~sound, again)
        sound = _is_sound(final, profiles)
    own = np.sqrt(ACROSS @ np.linalg.inv(final.normals[:, :2, :2]) @ ACROSS)
    return GapFit(
        borders=final.borders,
        chamfers_mm=shape.shared[[WIDTH_A, WIDTH_B]],
        chamfer_slope=float(shape.shared[SLOPE]),
        leans=shape.shared[LEAN] + profiles.places * shape.shared[LEAN_CHANGE],
        sealed=shape.known.floor.sealed,
        sigma_own_mm=own * _excess_scatter(final.widths, own),
        sigma_common_mm=sigma_common,
        sound=sound,
    )


def _is_sound(state: State, profiles: Profiles) -> Mask:
    """Whether each station's residuals are like the others'."""
    per_bin = state.costs / np.maximum(profiles.sizes.sum(axis=1), 1)
    return np.asarray(per_bin < _ODD * np.median(per_bin))


def _excess_scatter(widths: Array, sigma: Array) -> float:
    """By how much widths of stations that share no pixel scatter more than expected; 1 where they do not.

    Neighbouring stations' strips overlap, the next but one does not.
    """
    if len(widths) < _MIN_WIDTHS:
        return 1.0
    difference = np.abs(widths[2:] - widths[:-2]) / np.hypot(sigma[2:], sigma[:-2])
    return max(1.0, _MAD * float(np.median(difference)))
