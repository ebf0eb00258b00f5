"""The shape of a gap that all its stations share, found from several starts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.results import COVERAGE_95
from metrology.seams.gap.chamfers import PROOF, doubt_of_sealant, weigh_chamfers
from metrology.seams.gap.floor import Floor
from metrology.seams.gap.prior import DEPTH, WIDTH_A, WIDTH_B, Prior
from metrology.seams.gap.profiles import Profiles
from metrology.seams.gap.solver import ACROSS, State, fit_shape_from

Indices = NDArray[np.int64]

# So many stations, evenly spread, tell the shape; so few that look like the rest choose where to start from.
_SHAPE_STATIONS = 24
_START_STATIONS = 6
_START_CHAMFERS_MM = (0.05, 0.35, 0.7, 1.05)
_START_DEPTHS_MM = (1.0, 3.0)
_START_ITERATIONS, _ITERATIONS = 10, 30
# In a band as narrow as the blur (its width at half height) two broken edges look like anything, px.
_RESOLVED_PX = 2.0


def fit_shape(profiles: Profiles, floors: Sequence[Floor]) -> tuple[State, Array, float]:
    """The most likely shape, borders to start from for all stations, and the standard deviation of the mean width."""
    some = profiles.at(_evenly(len(profiles.stations), _SHAPE_STATIONS))
    few = some.at(_usual(some, _START_STATIONS))
    # Sealant has neither chamfers nor walls: an open gap must earn its parameters.
    looks = [_first_look(few, floor) for floor in floors]
    look = min(looks, key=lambda look: _cost(look) - (PROOF if look.known.floor.sealed else 0.0))
    return _fit_some(some, profiles, _like(look, few, some), look.shared, look.known)


def fit_shape_again(profiles: Profiles, found: State) -> tuple[State, Array, float]:
    """The same from what was found for all stations with other variances or levels' courses."""
    chosen = _evenly(len(profiles.stations), _SHAPE_STATIONS)
    known = Prior(profiles, found.known.floor)
    return _fit_some(profiles.at(chosen), profiles, found.borders[chosen], found.shared, known)


def sealant_doubt(profiles: Profiles, found: State) -> float:
    """The standard uncertainty of the width by not knowing that a gap is sealed; nothing where points show it."""
    floor = found.known.floor
    if not floor.sealed or floor.depth_mm is not None:
        return 0.0
    width = float(np.median(found.widths))
    if width < _RESOLVED_PX / float(np.median(profiles.px_mm)):
        return width / COVERAGE_95
    chosen = _usual(profiles, _START_STATIONS)
    some = profiles.at(chosen)
    sealed = fit_shape_from(some, found.borders[chosen], found.shared, found.known, _START_ITERATIONS)
    return doubt_of_sealant(sealed, some)


def _fit_some(
    some: Profiles, profiles: Profiles, borders: Array, shared: Array, known: Prior
) -> tuple[State, Array, float]:
    """Some of the stations fitted from a start; what follows for all of them."""
    free = fit_shape_from(some, borders, shared, known, _ITERATIONS)
    shape, doubt = (free, 0.0) if known.floor.sealed else weigh_chamfers(free, some)
    sigma = known.strain(shape.shared) * shape.mean_width_sigma
    return shape, _like(shape, some, profiles), float(np.hypot(sigma, doubt))


def _evenly(n: int, most: int) -> Indices:
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.int64))


def _usual(profiles: Profiles, most: int) -> Indices:
    """So many stations, evenly spread over the half whose pictures depart least from the seam's usual one.

    Letters or a sticker across the seam may lie on most of a few stations: from such a start the fit goes astray.
    """
    reach = float(np.abs(profiles.x).max())
    places = np.linspace(-reach, reach, profiles.x.shape[2])
    away = np.zeros(len(profiles.stations))
    for camera, sizes in enumerate(profiles.sizes.T):
        seen = np.flatnonzero(sizes)
        pictures = [
            np.interp(places, profiles.x[row, camera, : sizes[row]], profiles.grey[row, camera, : sizes[row]])
            for row in seen
        ]
        if pictures:
            away[seen] += np.abs(pictures - np.median(pictures, axis=0)).mean(axis=1)
    half = np.sort(np.argsort(away, kind="stable")[: (len(away) + 1) // 2])
    return half[_evenly(len(half), most)]


def _first_look(few: Profiles, floor: Floor) -> State:
    """A few stations' fit from the best of all starts: with usual cameras first, then with square walls."""
    known = Prior(few, floor)
    depths = _START_DEPTHS_MM if floor.depth_mm is None and not floor.sealed else known.mean[[DEPTH]]
    looks = []
    for chamfer in (0.0,) if floor.sealed else _START_CHAMFERS_MM:
        starts = []
        for depth in depths:
            shared = known.mean.copy()
            shared[[WIDTH_A, WIDTH_B, DEPTH]] = chamfer, chamfer, depth
            # What is detected as the band's border lies on the chamfer.
            borders = np.outer(few.half_widths + 0.4 * chamfer, ACROSS)
            starts.append(fit_shape_from(few, borders, shared, known.of_usual_cameras(), _START_ITERATIONS))
        best = min(starts, key=_cost)
        for freer in (known.of_square_walls(), known):
            best = fit_shape_from(few, best.borders, best.shared, freer, _START_ITERATIONS)
        looks.append(best)
    return min(looks, key=_cost)


def _cost(state: State) -> float:
    return state.cost(state.limit)


def _like(found: State, stations: Profiles, others: Profiles) -> Array:
    """(n, 2) borders of other stations, as far from where they are expected as those found."""
    shift = np.median(found.borders - np.outer(stations.half_widths, ACROSS), axis=0)
    return np.asarray(np.outer(others.half_widths, ACROSS) + shift)
