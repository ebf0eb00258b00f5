"""How wide a gap's chamfers are where the pictures leave it open: the median of all that is likely.

A chamfer narrower than the blur looks much like blur, and a square edge is a kind of its own. So no single best fit
stands for what is known: the rest is fitted for each of many widths, square edges among them, and the chamfers
are the median over them, each weighted by its likelihood; how far apart the gap's likely widths lie goes into the
uncertainty.

Sealant in a narrow gap looks much like the broken edges of a still narrower open one. It is taken for sealant unless
the pictures ask for a gap, so every open gap that they do not exclude goes into the uncertainty.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrology.arrays import Array
from metrology.results import COVERAGE_95
from metrology.seams.gap.floor import Floor
from metrology.seams.gap.prior import DEPTH, SLOPE, WIDTH_A, WIDTH_B, Prior
from metrology.seams.gap.profiles import Profiles
from metrology.seams.gap.solver import ACROSS, State, fit_shape_from

# Square edges that cost so much more than chamfers, in squared standard deviations, are out of the question (five σ).
_CERTAIN = 25.0
# Widths tried: so far apart (a quarter of a usual pixel, 0.2 mm), and up to where one costs so much more than the best
# that it has no weight.
_STEP_MM, _WIDEST_MM = 0.05, 1.0
_NO_WEIGHT = 12.0
# Before any picture is seen: drawings ask for broken edges; of four joints one may have been left square.
_SQUARE_SHARE = 0.25
_ITERATIONS = 12
# Open gaps that are to look like sealant: edges broken up to here, a floor as deep as usual; their fit starts far off.
_WIDEST_BROKEN_MM, _DEPTH_MM = 0.55, 2.0
_RIVAL_ITERATIONS = 40
# A floor that is less deep than so many times the chamfers may be their lower ends.
_SHALLOW = 2.0
# Share of what is likely that U95 is to cover.
_COVERAGE = 0.95
# An open gap is taken for real where sealant costs more than this in squared standard deviations: then its chamfers
# earn their keep (Bayesian information of about a hundred independent pixels).
PROOF = 9.0


def weigh_chamfers(free: State, some: Profiles) -> tuple[State, float]:
    """The shape with the median chamfers, and the standard uncertainty of the gap's width by not knowing them.

    It is that of a normal distribution as wide as 95 % of what is likely: where square edges are all but certain, what
    little speaks for wide chamfers does not count.

    Parameters
    ----------
    free : State
        The best fit.
    some : Profiles
        What it was fitted to.
    """
    expected = 0.5 * float(free.shared[WIDTH_A] + free.shared[WIDTH_B])
    square = _with_chamfers(free, some, 0.0)
    if square.cost(free.limit) - free.cost(free.limit) > _CERTAIN:
        return free, _doubt_of_floor(free, some)
    states, costs = [square], [square.cost(free.limit)]
    tried = np.unique(np.append(np.arange(_STEP_MM, _WIDEST_MM, _STEP_MM), max(expected, 0.01)))
    for width in tried:
        states.append(_with_chamfers(states[-1], some, float(width)))
        costs.append(states[-1].cost(free.limit))
        if width > expected and costs[-1] > min(costs) + _NO_WEIGHT:
            break
    chamfers = np.append(0.0, tried)[: len(states)]
    # What is not rendered well tells less of what it is.
    flattened = np.array(costs) / free.excess_misfit
    weights, widths = _weights(flattened, free, chamfers), np.array([np.median(s.widths) for s in states])
    chamfer = float(np.interp(0.5, np.cumsum(weights), chamfers))
    median = _with_chamfers(states[int(np.abs(chamfers - chamfer).argmin())], some, chamfer)
    away = np.abs(widths - np.median(median.widths))
    order = np.argsort(away)
    reached = min(int(np.searchsorted(np.cumsum(weights[order]), _COVERAGE)), len(order) - 1)
    return median, float(away[order[reached]]) / COVERAGE_95


def _doubt_of_floor(free: State, some: Profiles) -> float:
    """The standard uncertainty of the width by a gap that may be hidden between wider chamfers.

    Where the floor seems to lie right below the chamfers and no points show it, a groove in the shape of a V looks like
    a shallow gap as wide as its ground. Every wider chamfer that the pictures do not exclude leaves a narrower gap.
    """
    chamfer = 0.5 * float(free.shared[WIDTH_A] + free.shared[WIDTH_B])
    shallow = free.shared[DEPTH] < _SHALLOW * chamfer * free.shared[SLOPE]
    if free.known.floor.depth_mm is not None or not shallow:
        return 0.0
    found, rival, rivals = float(np.median(free.widths)), free, []
    for wider in np.arange(chamfer, chamfer + 0.5 * found + _STEP_MM, _STEP_MM):
        rival = _with_chamfers(rival, some, float(wider))
        rivals += [rival, _above_deep_floor(free, some, float(wider))]
    most = free.cost(free.limit) + PROOF * free.excess_misfit
    away = [abs(float(np.median(r.widths)) - found) for r in rivals if r.cost(free.limit) < most]
    return max(away, default=0.0) / COVERAGE_95


def _above_deep_floor(found: State, some: Profiles, width_mm: float) -> State:
    """Everything else fitted to chamfers of this width, from a floor as deep as usual and usual levels."""
    shared, levels = found.shared.copy(), found.known.lenses.stop
    shared[DEPTH], shared[levels:] = _DEPTH_MM, found.known.mean[levels:]
    return _with_chamfers(replace(found, shared=shared), some, width_mm, _RIVAL_ITERATIONS)


def doubt_of_sealant(sealed: State, some: Profiles) -> float:
    """The standard uncertainty of a sealed gap's width by open ones with broken edges that look nearly as well.

    Within the same dark band the widest chamfers that the pictures do not exclude leave the narrowest gap. Its floor
    lies as deep as floors do: right below the chamfers it would be sealant once more.
    """
    known = Prior(some, Floor(sealed=False, depth_mm=_DEPTH_MM)).without_chamfers()
    shared = np.concatenate([sealed.shared[: known.lenses.stop], known.mean[known.lenses.stop :]])
    shared[DEPTH] = known.mean[DEPTH]
    rival = fit_shape_from(some, sealed.borders, shared, known, _RIVAL_ITERATIONS)
    band, widest = float(np.median(sealed.widths)), 0.0
    for chamfer in np.arange(_STEP_MM, min(_WIDEST_BROKEN_MM, 0.5 * band), _STEP_MM):
        rival = _with_chamfers(rival, some, float(chamfer), _RIVAL_ITERATIONS)
        if rival.cost(sealed.limit) - sealed.cost(sealed.limit) < PROOF * sealed.excess_misfit:
            widest = float(chamfer) + _STEP_MM
    return min(2.0 * widest, band) / COVERAGE_95


def _with_chamfers(start: State, some: Profiles, width_mm: float, iterations: int = _ITERATIONS) -> State:
    """Everything else fitted to chamfers of this width."""
    shared = start.shared.copy()
    shared[[WIDTH_A, WIDTH_B]] = width_mm
    # A chamfer's middle stays where it is.
    wider = shared[[WIDTH_A, WIDTH_B]] - start.shared[[WIDTH_A, WIDTH_B]]
    borders = start.borders + 0.5 * wider * ACROSS
    return fit_shape_from(some, borders, shared, start.known.without_chamfers(), iterations)


def _weights(costs: Array, free: State, chamfers: Array) -> Array:
    """Posterior probabilities of the widths tried: square edges have a share of their own, the rest a density."""
    prior = np.array([_prior_cost(free, width) for width in chamfers])
    fine = np.arange(0.0, 5.0, 0.01)
    norm = 0.01 * np.exp(-0.5 * (np.array([_prior_cost(free, width) for width in fine]) - prior.min())).sum()
    # Trapezoids.
    spacing = 0.5 * (np.diff(chamfers, append=chamfers[-1]) + np.diff(chamfers, prepend=0.0))
    weights = np.exp(-0.5 * (costs - costs.min() - prior.min())) * spacing / norm * (1 - _SQUARE_SHARE)
    weights[0] += np.exp(-0.5 * (costs[0] - costs.min() - prior[0])) * _SQUARE_SHARE
    return np.asarray(weights / weights.sum())


def _prior_cost(state: State, width_mm: float) -> float:
    """What is known against chamfers of this width, beside the other parameters' share."""
    shared = state.known.mean.copy()
    shared[[WIDTH_A, WIDTH_B]] = width_mm
    return state.known.cost(shared)
