"""Both edges of a gap from what both cameras see of it, at all stations of a seam at once.

The seam's stations share the gap's shape: the chamfers' widths, the floor's depth (or sealant up to the edges), the
direction of the walls, and each camera's blur. Each station has its own borders C (where the skins end) and its own
brightness of every region (`gap_view`). Least squares over all pixels, Levenberg–Marquardt with the levels and then
the borders eliminated, finds them; the ideal edges D′ and G′ lie a chamfer's width beyond the borders.

What limits the shape is not noise but how well the model renders the gap. That error is common to all stations, so
in the fit of the shape each of n stations gets n times its variance: more stations do not make it smaller.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metrology.seams.blur import PixelBlur, blurred_step
from metrology.seams.gap_floor import Floor
from metrology.seams.gap_profiles import Profiles
from metrology.seams.gap_view import (
    CHAMFER_A,
    CHAMFER_B,
    DARK_FLOOR,
    DARK_WALL,
    DIFFERENCE,
    LEVELS,
    LIT_FLOOR,
    LIT_WALL,
    MORE_LENS,
    MORE_SPILL,
    NODES_PER_PX,
    NOMINAL,
    SKIN_A,
    SKIN_B,
    SLOPE_A,
    SLOPE_B,
    TABLES,
    normal_equations,
)

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# What the stations share, in this order (mm, tangents, px).
WIDTH_A, WIDTH_B, DEPTH, LEAN, LEAN_CHANGE, SPILL, LENSES = range(7)
# What is known of it beforehand: broken edges are tenths of a millimetre wide, substructure lies a few millimetres
# down, edges are cut square to the skin, lenses blur by half a pixel, and a little light goes to its neighbours. Mean
# and standard deviation.
_BROKEN_EDGE_MM = (0.3, 0.5)
_GAP_DEPTH_MM = (2.0, 3.0)
_SQUARE = (0.0, 0.05)
_SPILL = (0.08, 0.1)
_LENS_PX = (0.45, 0.25)
# Both edges of a joint are broken by one rule (within 0.1 mm each, 95 %), and both cameras have like lenses.
_ALIKE_EDGES_MM = 0.07
_ALIKE_LENSES_PX = 0.1
_LOWEST = (0.0, 0.0, 0.0, -0.5, -0.5, 0.0)
_HIGHEST = (2.0, 2.0, 12.0, 0.5, 0.5, 0.24)
_LENS_BOUNDS_PX = (0.05, 2.0)
# How much a station's levels scatter about the seam's usual ones, relative to the skin's: grain, smudges, highlights.
_LEVEL_SCATTER = np.full(LEVELS, 0.05)
_LEVEL_SCATTER[[SLOPE_A, SLOPE_B]] = 0.02
# Error of the rendered brightness, relative to the skin's.
_RENDERING = 0.004
# So many stations, evenly spread, tell the shape; so few of them choose where to start from.
_SHAPE_STATIONS = 24
_START_STATIONS = 6
_START_CHAMFERS_MM = (0.05, 0.35, 0.7)
_START_DEPTHS_MM = (1.0, 3.0)
# Chamfers are taken for real where leaving them out costs more than this in squared standard deviations: then their
# two widths earn their keep (Bayesian information of about a hundred independent pixels).
_PROOF = 9.0
# Stations whose squared residuals exceed the usual ones so many times tell less about the shape (Cauchy), and so many
# times: nothing, they show something else than this gap.
_DOUBTFUL, _ODD = 3.0, 8.0
# Pixel and spill reach so far along the diagonal, px; the tail of the lens's Gaussian, standard deviations.
_BLUR_REACH_PX, _LENS_TAIL = 2.2, 4.5
# No border moves farther in one iteration, mm.
_STRIDE_MM = 0.3


# What only open gaps have: sealant fills the chamfers too, and hides the walls.
_OF_OPEN_GAPS = (WIDTH_A, WIDTH_B, DEPTH, LEAN, LEAN_CHANGE)
# The floor's depth as the points show it varies and errs by this.
_FLOOR_SIGMA_MM = 0.2


@dataclass(frozen=True)
class GapFit:
    """Fitted borders and shape.

    Attributes
    ----------
    borders : (n, 2) ndarray
        x of C on skins A and B, mm.
    chamfers_mm : (2,) ndarray
        Widths of A's and B's.
    leans : (n,) ndarray
        Tangent of the walls' angle from the skin's normal, towards B with depth.
    sealed : bool
        Whether the gap's floor joins both edges.
    sigma_own_mm, sigma_common_mm : (n,) ndarray, float
        Standard deviation of the width: by each station's own pixels, and by the common shape.
    sound : (n,) ndarray of bool
        Whether a station shows the gap that its seam has.
    """

    borders: Array
    chamfers_mm: Array
    leans: Array
    sealed: bool
    sigma_own_mm: Array
    sigma_common_mm: float
    sound: NDArray[np.bool_]


@dataclass(frozen=True)
class _State:
    """Parameters with the normal equations there: blocks of [two borders, shared] per station."""

    borders: Array
    shared: Array
    floor: Floor
    normals: Array
    gradients: Array
    levels: Array
    costs: Array


_OF_STATIONS = ("borders", "normals", "gradients", "levels", "costs")


class _Knowledge:
    """Prior of what is shared: quadratic form about a mean; what is held fixed has no say."""

    def __init__(self, ambient: Array, floor: Floor, fixed: tuple[int, ...] = ()) -> None:
        cameras = len(ambient)
        depth = _GAP_DEPTH_MM if floor.depth_mm is None else (floor.depth_mm, _FLOOR_SIGMA_MM)
        if floor.sealed:
            depth = (max(floor.depth_mm or 0.0, 0.0), _FLOOR_SIGMA_MM)
        spread = [_BROKEN_EDGE_MM, _BROKEN_EDGE_MM, depth, _SQUARE, _SQUARE, _SPILL]
        spread += [_LENS_PX] * cameras
        spread += [level for share in ambient for level in _levels_beforehand(float(share))]
        self.mean, sigma = np.array(spread, float).T
        self.precision = np.diag(sigma**-2.0)
        self._alike(WIDTH_A, WIDTH_B, _ALIKE_EDGES_MM)
        for camera in range(1, cameras):
            self._alike(LENSES, LENSES + camera, _ALIKE_LENSES_PX)
        self.fixed = (*fixed, *(_OF_OPEN_GAPS if floor.sealed else ()))
        self.free = np.setdiff1d(np.arange(len(sigma)), self.fixed)

    def _alike(self, i: int, j: int, sigma: float) -> None:
        difference = np.zeros(len(self.mean))
        difference[[i, j]] = 1.0, -1.0
        self.precision += np.outer(difference, difference) / sigma**2

    def cost(self, shared: Array) -> float:
        away = shared - self.mean
        return float(away @ self.precision @ away)

    def gradient(self, shared: Array) -> Array:
        return np.asarray(-(self.precision @ (shared - self.mean)))


def fit_gap(profiles: Profiles, chamfer_slope: float, floors: Sequence[Floor]) -> GapFit:
    """Fit borders and shape.

    Parameters
    ----------
    profiles : Profiles
    chamfer_slope : float
        Tangent of the chamfers' angle against the skin.
    floors : sequence of Floor
        What may close the gap below; the pictures decide.
    """
    chosen = _evenly(len(profiles.stations), _SHAPE_STATIONS)
    shape, doubt = _fit_shape(profiles, chosen, chamfer_slope, floors)
    final = _fit_borders(profiles, shape, _like(shape, profiles.at(chosen), profiles), chamfer_slope)
    sound = _is_sound(final, profiles)
    if not sound.all() and sound.any():
        # Where a shadow or a scratch was taken for a border, its neighbours know better.
        stray = np.flatnonzero(~sound)
        near = [np.interp(profiles.places[stray], profiles.places[sound], side) for side in final.borders[sound].T]
        again = _fit_borders(profiles.at(stray), shape, np.stack(near, axis=1), chamfer_slope)
        final = _with_stations(final, stray, again)
        sound = _is_sound(final, profiles)
    across = np.array([-1.0, 1.0])
    own = np.sqrt(np.einsum("i,nij,j->n", across, np.linalg.inv(final.normals[:, :2, :2]), across))
    widths = final.borders @ across
    return GapFit(
        borders=final.borders,
        chamfers_mm=shape.shared[[WIDTH_A, WIDTH_B]],
        leans=shape.shared[LEAN] + profiles.places * shape.shared[LEAN_CHANGE],
        sealed=shape.floor.sealed,
        sigma_own_mm=own * _excess_scatter(widths, own),
        sigma_common_mm=float(np.hypot(_common_sigma(shape, profiles.ambient), doubt)),
        sound=sound,
    )


def _evenly(n: int, most: int) -> Indices:
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.int64))


def _fit_shape(profiles: Profiles, chosen: Indices, slope: float, floors: Sequence[Floor]) -> tuple[_State, float]:
    """The most likely shape from several starts, and what the doubt about chamfers adds to the width's σ.

    Without chamfers where they are not proven.
    """
    few, some = profiles.at(chosen[_evenly(len(chosen), _START_STATIONS)]), profiles.at(chosen)
    ambient = profiles.ambient
    best = min(
        _first_looks(few, slope, floors), key=lambda look: _posterior_cost(look, _Knowledge(ambient, look.floor))
    )
    free = _descend(some, _like(best, few, some), best.shared, best.floor, slope, 30)
    if best.floor.sealed:
        return free, 0.0
    bare = free.shared.copy()
    bare[[WIDTH_A, WIDTH_B]] = 0.0
    inwards = 0.5 * free.shared[[WIDTH_A, WIDTH_B]] * [1.0, -1.0]
    plain = _descend(some, free.borders + inwards, bare, free.floor, slope, 30, (WIDTH_A, WIDTH_B))
    limit = _DOUBTFUL * float(np.median(free.costs))
    bare_knowledge = _Knowledge(ambient, free.floor, (WIDTH_A, WIDTH_B))
    worse = _posterior_cost(plain, bare_knowledge, limit) - _posterior_cost(
        free, _Knowledge(ambient, free.floor), limit
    )
    doubt = 1.0 / (1.0 + np.exp(0.5 * abs(worse - _PROOF)))
    spread = float(np.sqrt(doubt * (1 - doubt))) * abs(_mean_width(plain) - _mean_width(free))
    return (plain if worse < _PROOF else free), spread


def _first_looks(few: Profiles, slope: float, floors: Sequence[Floor]) -> list[_State]:
    """Fits of a few stations from every start."""
    looks = []
    for floor in floors:
        usual = _Knowledge(few.ambient, floor).mean
        depths = _START_DEPTHS_MM if floor.depth_mm is None and not floor.sealed else usual[[DEPTH]]
        for depth in depths:
            for chamfer in (0.0,) if floor.sealed else _START_CHAMFERS_MM:
                shared = usual.copy()
                shared[[WIDTH_A, WIDTH_B, DEPTH]] = chamfer, chamfer, depth
                borders = np.outer(few.half_widths + 0.4 * chamfer, [-1.0, 1.0])
                looks.append(_descend(few, borders, shared, floor, slope, 10))
    return looks


def _like(found: _State, stations: Profiles, others: Profiles) -> Array:
    """(n, 2) borders of other stations, as far from where they are expected as those found."""
    shift = np.median(found.borders - np.outer(stations.half_widths, [-1.0, 1.0]), axis=0)
    return np.asarray(np.outer(others.half_widths, [-1.0, 1.0]) + shift)


def _posterior_cost(state: _State, known: _Knowledge, limit: float | None = None) -> float:
    """What the pictures and what is known beforehand have against a state; doubtful stations from `limit` on."""
    limit = _DOUBTFUL * float(np.median(state.costs)) if limit is None else limit
    return _trusted_cost(state, limit) + known.cost(state.shared)


def _mean_width(state: _State) -> float:
    """Median of the stations' widths, mm."""
    between = state.borders[:, 1] - state.borders[:, 0]
    return float(np.median(between) - state.shared[WIDTH_A] - state.shared[WIDTH_B])


def _levels_beforehand(ambient: float) -> list[tuple[float, float]]:
    """Mean and standard deviation of a seam's usual levels relative to the skin's, before any is seen.

    Matt surfaces turned from the light, and shadows with a part of the sky: a wall sees half of it at most, the floor
    of a deep gap less.
    """
    known = {
        SKIN_A: (1.0, 0.1), SKIN_B: (1.0, 0.1), SLOPE_A: (0.0, 0.01), SLOPE_B: (0.0, 0.01),
        CHAMFER_A: (0.6, 0.3), CHAMFER_B: (0.6, 0.3), LIT_WALL: (0.3, 0.3), LIT_FLOOR: (0.4, 0.4),
        DARK_WALL: (0.5 * ambient, 0.5 * ambient), DARK_FLOOR: (0.25 * ambient, 0.25 * ambient),
    }  # fmt: skip
    return [known[level] for level in range(LEVELS)]


def _state(profiles: Profiles, borders: Array, shared: Array, floor: Floor, slope: float, with_shape: bool) -> _State:
    n, k = profiles.sizes.shape
    size = 2 + len(shared)
    state = _State(
        borders, shared, floor, np.zeros((n, size, size)), np.zeros((n, size)), np.zeros((n, k, LEVELS)), np.zeros(n)
    )
    normal_equations(
        profiles.x, profiles.grey, profiles.variance, profiles.sizes, profiles.places, borders, shared,
        _tables(profiles.normals, shared, with_shape), floor.sealed,
        profiles.tilts, slope, profiles.eyes, profiles.lamps, profiles.px_mm, _LEVEL_SCATTER**-2.0,
        with_shape,
        state.normals, state.gradients, state.levels, state.costs,
    )  # fmt: skip
    return state


def _tables(normals: Array, shared: Array, with_shape: bool) -> Array:
    """(k, TABLES, nodes) blurred steps of the cameras, and how they change."""
    spill, lenses = float(shared[SPILL]), [float(lens) for lens in shared[LENSES : LENSES + len(normals)]]
    reach = _BLUR_REACH_PX + _LENS_TAIL * max(lenses)
    changes = {NOMINAL: (0.0, 0.0)}
    if with_shape:
        changes |= {MORE_LENS: (DIFFERENCE, 0.0), MORE_SPILL: (0.0, DIFFERENCE)}
    return np.array([
        [blurred_step((float(u), float(v)), PixelBlur(lens + changes[i][0], spill + changes[i][1]), NODES_PER_PX, reach)
         for i in range(TABLES if with_shape else 1)]
        for (u, v), lens in zip(normals, lenses, strict=True)
    ])  # fmt: skip


def _descend(
    profiles: Profiles, borders: Array, shared: Array, floor: Floor, slope: float, iterations: int,
    fixed: tuple[int, ...] = (),
) -> _State:  # fmt: skip
    """Levenberg–Marquardt on borders and shape, the borders eliminated (Schur complement)."""
    n = len(profiles.stations)
    cautious = replace(profiles, variance=profiles.variance + n * _RENDERING**2)
    known = _Knowledge(profiles.ambient, floor, fixed)
    state = _state(cautious, borders, shared, floor, slope, True)
    damping = 1e-2
    for _ in range(iterations):
        by_border, by_shape = _step(state, known, damping)
        tried = _within_bounds(state.shared + by_shape, len(profiles.ambient))
        new = _state(cautious, state.borders + by_border, tried, floor, slope, True)
        limit = _DOUBTFUL * float(np.median(state.costs))
        gain = _trusted_cost(state, limit) - _trusted_cost(new, limit)
        gain += known.cost(state.shared) - known.cost(tried)
        if gain > 0:
            settled = gain < 1e-3
            state, damping = new, max(0.2 * damping, 1e-6)
            if settled:
                break
        else:
            damping *= 8.0
            if damping > 1e4:
                break
    return state


def _trusted_cost(state: _State, limit: float) -> float:
    """Sum of the stations' costs; beyond the limit only their logarithms count."""
    return float(
        np.where(state.costs < limit, state.costs, limit * (1 + np.log(np.maximum(state.costs / limit, 1)))).sum()
    )


def _within_bounds(shared: Array, cameras: int) -> Array:
    shared = shared.copy()
    shared[:LENSES] = np.clip(shared[:LENSES], _LOWEST, _HIGHEST)
    shared[LENSES : LENSES + cameras] = np.clip(shared[LENSES : LENSES + cameras], *_LENS_BOUNDS_PX)
    return shared


def _trust(state: _State) -> Array:
    """Stations' weights: one for those with usual costs."""
    return np.minimum(1.0, _DOUBTFUL * np.median(state.costs) / np.maximum(state.costs, 1e-12))


def _shape_normal(state: _State, known: _Knowledge, damping: float) -> tuple[Array, Array, Array]:
    """Normal matrix of what is shared with the borders eliminated, and the stations' blocks that went into it."""
    own = state.normals[:, :2, :2] * (1.0 + damping * np.eye(2)) + 1e-9 * np.eye(2)
    cross, inverse = state.normals[:, :2, 2:], np.asarray(np.linalg.inv(own), float)
    trust = _trust(state)
    shape = np.einsum("n,nab->ab", trust, state.normals[:, 2:, 2:]) + known.precision
    shape = shape + damping * np.diag(np.diag(shape)) - np.einsum("n,nia,nij,njb->ab", trust, cross, inverse, cross)
    return shape, cross, inverse


def _step(state: _State, known: _Knowledge, damping: float) -> tuple[Array, Array]:
    shape, cross, inverse = _shape_normal(state, known, damping)
    trust = _trust(state)
    right = trust @ state.gradients[:, 2:] + known.gradient(state.shared)
    right -= np.einsum("n,nia,nij,nj->a", trust, cross, inverse, state.gradients[:, :2])
    by_shape = np.zeros(len(state.shared))
    free = known.free
    by_shape[free] = np.linalg.solve(shape[np.ix_(free, free)], right[free])
    by_border = np.einsum("nij,nj->ni", inverse, state.gradients[:, :2] - cross @ by_shape)
    return np.clip(by_border, -_STRIDE_MM, _STRIDE_MM), by_shape


def _is_sound(state: _State, profiles: Profiles) -> NDArray[np.bool_]:
    """Whether each station's residuals are like the others'."""
    per_bin = state.costs / np.maximum(profiles.sizes.sum(axis=1), 1)
    return np.asarray(per_bin < _ODD * np.median(per_bin))


def _fit_borders(profiles: Profiles, shape: _State, borders: Array, slope: float) -> _State:
    """Every station's borders with the shape known, each station by itself."""
    careful = replace(profiles, variance=profiles.variance + _RENDERING**2)
    state = _state(careful, borders, shape.shared, shape.floor, slope, False)
    damping = np.full(len(borders), 1e-2)
    for _ in range(10):
        own = state.normals[:, :2, :2] * (1.0 + damping[:, None, None] * np.eye(2)) + 1e-9 * np.eye(2)
        moves = np.clip(np.linalg.solve(own, state.gradients[:, :2, None])[..., 0], -_STRIDE_MM, _STRIDE_MM)
        if np.abs(moves).max() < 1e-4:
            break
        new = _state(careful, state.borders + moves, shape.shared, shape.floor, slope, False)
        better = new.costs < state.costs
        damping = np.where(better, 0.2 * damping, 8.0 * damping)
        state = _with_stations(state, np.flatnonzero(better), _at(new, better))
    return state


def _at(state: _State, which: NDArray[np.bool_]) -> _State:
    """Some of the stations."""
    return replace(state, **{name: getattr(state, name)[which] for name in _OF_STATIONS})


def _with_stations(state: _State, which: Indices, others: _State) -> _State:
    """The state with some of its stations replaced."""
    changed = {}
    for name in _OF_STATIONS:
        changed[name] = getattr(state, name).copy()
        changed[name][which] = getattr(others, name)
    return replace(state, **changed)


def _excess_scatter(widths: Array, sigma: Array) -> float:
    """By how much widths of stations that share no pixel scatter more than expected; 1 where they do not.

    Neighbouring stations' strips overlap, the next but one does not.
    """
    if len(widths) < 8:
        return 1.0
    difference = np.abs(widths[2:] - widths[:-2]) / np.hypot(sigma[2:], sigma[:-2])
    return max(1.0, 1.4826 * float(np.median(difference)))


def _common_sigma(shape: _State, ambient: Array) -> float:
    """Standard deviation of the stations' mean width by what they have in common."""
    plain = shape.shared[WIDTH_A] == shape.shared[WIDTH_B] == 0.0
    known = _Knowledge(ambient, shape.floor, (WIDTH_A, WIDTH_B) if plain else ())
    normal, cross, inverse = _shape_normal(shape, known, 0.0)
    across = np.array([-1.0, 1.0])
    # W = x_B − x_A − w_A − w_B; with the shape, the borders move along.
    by_shape = -np.einsum("i,nij,nja->a", across, inverse, cross) / len(shape.borders)
    by_shape[[WIDTH_A, WIDTH_B]] -= 1.0
    free = known.free
    variance = by_shape[free] @ np.linalg.solve(normal[np.ix_(free, free)], by_shape[free])
    variance += np.einsum("i,nij,j->", across, inverse, across) / len(shape.borders) ** 2
    return float(np.sqrt(variance))
