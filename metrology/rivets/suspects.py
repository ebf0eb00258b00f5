"""Suspects: ellipses that arcs of an image support, before the joint fit decides (paper §3.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.rivets.arc_fit import fit_candidates, strike_repeats
from metrology.rivets.arcs import Arcs, RidgeField, trace_arcs, vote_centres
from metrology.rivets.ellipse import Ellipse
from metrology.rivets.evidence import ring_evidence
from metrology.rivets.local_votes import Ballot
from metrology.rivets.settings import RivetSettings
from metrology.rivets.shapes import CircleShapes

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]

# Scales of the ridges, px of the level: full resolution sees the whole blur, lower ones have averaged over pixels.
_FULL_SCALE, _REDUCED_SCALE = 1.4, 1.0
_POSITION_NOISE = 0.35  # of a ridge point across its ridge, px of the level
_WINDOW = 7  # ridge points to either side from which an arc's curvature is taken
_RADIUS_STEP = 0.5  # between radii that are voted for, px of the level
_PLANE_RATIO = 1.35  # of the radii that share an accumulator
_PEAKS = 150  # kept per accumulator
# Of an ellipse by ridge points. The sagitta of a quarter turn, 0.29 r, is three times the position noise for the
# smallest heads looked for at half resolution (4 px of the level): a shorter arc may as well be straight.
_LEAST_COVERAGE = 0.25
_SUSPECT_COVERAGE = 0.38  # of a suspect that is fitted without being voted on
_SECTORS = 24
# Of the tens of thousands of places in an image that are voted in, noise alone comes that far in one of thousands
# of images.
_LEAST_VOTES = 5.5
# Heads do not overlap: about a clear ring no other is looked for within so many of its radii, nor, beside it, where the
# centres are closer than this share of both radii.
_SHADOW, _APART = 1.6, 0.85


@dataclass(frozen=True)
class Level:
    """One resolution at which arcs are traced.

    Attributes
    ----------
    reduction : int
        Pixels of the image per pixel of the level.
    least, most : float
        Radii looked for, pixels of the image.
    """

    reduction: int
    least: float
    most: float


def levels_for(least: float, most: float) -> list[Level]:
    """Resolutions for radii from `least` to `most` pixels: heads of few pixels at full resolution, others at half.

    A thin ring loses contrast at a lower resolution, so even large heads are traced at half resolution; only those
    beyond 70 px, where the gap itself is wide, at a quarter.
    """
    bounds = [(1, 0.0, 6.0), (2, 5.5, 70.0), (4, 60.0, np.inf)]
    return [Level(k, max(a, least), min(b, most)) for k, a, b in bounds if max(a, least) < min(b, most)]


@dataclass(frozen=True)
class Evidence:
    """What a suspect's ring must show in the image: contrast over its noise, and share of its sectors that show it."""

    score: float
    hits: float


# To be fitted where the shape is known, where it is not, and to be beyond doubt without knowing it.
KNOWN_SHAPE, ANY_SHAPE, STRONG = Evidence(11.0, 0.66), Evidence(6.0, 0.5), Evidence(16.0, 0.8)


@dataclass(frozen=True)
class Traces:
    """Arcs of an image at one resolution, dark ones and bright ones, and the votes of its pixels."""

    level: Level
    size: tuple[int, int]
    dark: Arcs
    bright: Arcs
    ballot: Ballot

    def stronger(self, least: float) -> Traces:
        """The points of at least this strength."""
        return Traces(self.level, self.size, self.dark.stronger(least), self.bright.stronger(least), self.ballot)


def trace(image: Float32, level: Level, settings: RivetSettings) -> Traces:
    """Reduce an image and trace its arcs."""
    k = level.reduction
    small = image
    if k > 1:
        small = cv2.resize(image, None, fx=1 / k, fy=1 / k, interpolation=cv2.INTER_AREA).astype(np.float32)
    field = RidgeField.of(small, _FULL_SCALE if k == 1 else _REDUCED_SCALE)
    thresholds = settings.ridge_low, settings.ridge_high
    dark, bright = (trace_arcs(field, polarity, thresholds, _WINDOW, _POSITION_NOISE) for polarity in (1, -1))
    return Traces(level, (small.shape[0], small.shape[1]), dark, bright, Ballot.of(field, level.most / k))


@dataclass(frozen=True)
class Candidates:
    """Ellipses that arcs of one polarity support.

    Attributes
    ----------
    traces : Traces
    polarity : float
        +1 dark, −1 bright.
    rows : (n, 7) ndarray
        Ellipses (u, v, semi-axes, angle) in pixels of the level, then coverage and agreement.
    """

    traces: Traces
    polarity: float
    rows: Array

    @property
    def in_image(self) -> Array:
        """The rows in pixels of the image."""
        k = self.traces.level.reduction
        return np.column_stack([(self.rows[:, :2] + 0.5) * k - 0.5, self.rows[:, 2:4] * k, self.rows[:, 4:]])

    def beside(self, rings: Array) -> Candidates:
        """Those that may be heads beside the rings (rows of u, v, radius), in pixels of the image."""
        return Candidates(self.traces, self.polarity, self.rows[~shadowed(self.in_image, rings)])


def candidates(traces: Traces, shapes: CircleShapes, settings: RivetSettings) -> list[Candidates]:
    """Ellipses that arcs support, dark ones and bright ones."""
    both = []
    for polarity, arcs in ((1.0, traces.dark), (-1.0, traces.bright)):
        rows = _candidates(arcs, traces.size, traces.level, shapes, settings)
        both.append(Candidates(traces, polarity, _distinct(rows[rows[:, 5] >= _LEAST_COVERAGE])))
    return both


def suspects(image: Float32, supported: Sequence[Candidates], evidence: Evidence) -> list[Ellipse]:
    """Candidates whose ring shows in the image, in its pixels, best supported first."""
    found = [np.empty((0, 7))]
    for some in supported:
        rows = some.in_image
        rows = rows[rows[:, 5] >= _SUSPECT_COVERAGE]
        shown = np.zeros((len(rows), 2))
        ring_evidence(image, rows[:, :5], np.full(len(rows), some.polarity), _SECTORS, shown)
        found.append(rows[(shown[:, 0] > evidence.score) & (shown[:, 1] >= evidence.hits)])
    return [Ellipse.of(row[:5]) for row in _distinct(np.concatenate(found))]


def confirmed(supported: Sequence[Candidates], settings: RivetSettings) -> list[Ellipse]:
    """Candidates put where most votes of the pixels round them agree, where these confirm them; in pixels of the image.

    Half of the sectors without a rim vote for it by chance.
    """
    found = [np.empty((0, 7))]
    for some in supported:
        rows = some.rows.copy()
        rows[:, 5:] = some.traces.ballot.poll(rows[:, :5], some.polarity)
        clear = (rows[:, 5] > _LEAST_VOTES) & (rows[:, 6] > 0.5 * (1 + settings.min_coverage))
        found.append(Candidates(some.traces, some.polarity, rows[clear]).in_image)
    return [Ellipse.of(row[:5]) for row in _distinct(np.concatenate(found))]


def shadowed(ellipses: Array, rings: Array) -> NDArray[np.bool_]:
    """Which ellipses (rows of u, v, semi-axes, …) cannot be other heads beside rings (rows of u, v, radius).

    The flanks of a ring, its highlights and its recess make such, and curves that share a part of it. Larger ones about
    the same centre may be heads round a recess.
    """
    if len(rings) == 0:
        return np.zeros(len(ellipses), bool)
    radii = np.sqrt(ellipses[:, 2:3] * ellipses[:, 3:4])
    distance = np.hypot(ellipses[:, :1] - rings[:, 0], ellipses[:, 1:2] - rings[:, 1])
    within = np.where(
        distance < 0.3 * rings[:, 2], radii < _SHADOW * rings[:, 2], distance < _APART * (radii + rings[:, 2])
    )
    return np.asarray(within.any(axis=1))


def _candidates(
    arcs: Arcs, size: tuple[int, int], level: Level, shapes: CircleShapes, settings: RivetSettings
) -> Array:
    """(n, 7) ellipses in pixels of the level that ridge points support, then coverage and agreement."""
    k = level.reduction
    radii = np.arange(max(level.least / k, 2.5), level.most / k + _RADIUS_STEP, _RADIUS_STEP)
    planes = max(1, int(np.ceil(np.log(radii[-1] / radii[0]) / np.log(_PLANE_RATIO))))
    edges = np.geomspace(radii[0], radii[-1] + 1e-6, planes + 1)
    starts = vote_centres(arcs, size, radii, edges, shapes.matrices, shapes.cell / k, settings.min_support, _PEAKS)
    if len(starts) == 0:
        return np.empty((0, 7))
    order = np.argsort(arcs.v, kind="stable")
    v = arcs.v[order]
    rows = np.searchsorted(v, np.arange(size[0] + 2)).astype(np.int64)
    expected = shapes.at(starts[:, 0] * k, starts[:, 1] * k)
    ellipses, coverage, agreement = np.zeros((len(starts), 5)), np.zeros(len(starts)), np.zeros(len(starts))
    fit_candidates(
        starts, arcs.u[order], v, arcs.nu[order], arcs.nv[order], rows, expected, ellipses, coverage, agreement
    )
    return np.column_stack([ellipses, coverage, agreement])


def _distinct(rows: Array) -> Array:
    """Candidates in order of support without those that repeat a better one."""
    order = np.argsort(-rows[:, 5] * rows[:, 6], kind="stable")
    rows = rows[order]
    alive = np.ones(len(rows), np.bool_)
    strike_repeats(rows, alive)
    return rows[alive]
