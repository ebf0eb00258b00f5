"""Suspects: ellipses that arcs of an image support, before the joint fit decides (paper §3.1)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from metrology.arrays import Array, Float32
from metrology.rivets.arc_fit import fit_candidates, strike_repeats
from metrology.rivets.arcs import Arcs, RidgeField, trace_arcs, vote_centres
from metrology.rivets.ellipse import Ellipse
from metrology.rivets.evidence import ring_evidence
from metrology.rivets.settings import RivetSettings
from metrology.rivets.shapes import CircleShapes

# Scales of the ridges, px of the level: full resolution sees the whole blur, lower ones have averaged over pixels.
_FULL_SCALE, _REDUCED_SCALE = 1.4, 1.0
_POSITION_NOISE = 0.35  # of a ridge point across its ridge, px of the level
_WINDOW = 7  # ridge points to either side from which an arc's curvature is taken
_RADIUS_STEP = 0.5  # between radii that are voted for, px of the level
_PLANE_RATIO = 1.35  # of the radii that share an accumulator
_PEAKS = 150  # kept per accumulator
_LEAST_COVERAGE = 0.38  # of a suspect by ridge points
_LEAST_TRACE = 0.25  # the same where the image shows the ring plainly
_SECTORS = 24


@dataclass(frozen=True)
class Level:
    """One resolution at which arcs are traced."""

    reduction: int
    """Pixels of the image per pixel of the level."""
    least: float
    most: float
    """least, most: radii looked for, pixels of the image."""


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
    """Arcs of an image at one resolution: dark ones and bright ones."""

    level: Level
    size: tuple[int, int]
    dark: Arcs
    bright: Arcs

    def stronger(self, least: float) -> Traces:
        """The points of at least this strength."""
        return Traces(self.level, self.size, self.dark.stronger(least), self.bright.stronger(least))


def trace(image: Float32, level: Level, settings: RivetSettings) -> Traces:
    """Reduce an image and trace its arcs."""
    k = level.reduction
    small = image
    if k > 1:
        small = cv2.resize(image, None, fx=1 / k, fy=1 / k, interpolation=cv2.INTER_AREA).astype(np.float32)
    field = RidgeField.of(small, _FULL_SCALE if k == 1 else _REDUCED_SCALE)
    thresholds = settings.ridge_low, settings.ridge_high
    dark, bright = (trace_arcs(field, polarity, thresholds, _WINDOW, _POSITION_NOISE) for polarity in (1, -1))
    return Traces(level, (small.shape[0], small.shape[1]), dark, bright)


def suspects(
    image: Float32, traces: Traces, shapes: CircleShapes, settings: RivetSettings, evidence: Evidence
) -> list[Ellipse]:
    """Ellipses that arcs support and whose ring shows in the image, in its pixels, best supported first."""
    k = traces.level.reduction
    found = []
    for polarity, arcs in ((1.0, traces.dark), (-1.0, traces.bright)):
        candidates = _candidates(arcs, traces.size, traces.level, shapes, settings)
        least = _LEAST_COVERAGE if evidence is STRONG else _LEAST_TRACE
        candidates = _distinct(candidates[candidates[:, 5] >= least])
        candidates[:, :2] = (candidates[:, :2] + 0.5) * k - 0.5
        candidates[:, 2:4] *= k
        shown = np.zeros((len(candidates), 2))
        ring_evidence(image, candidates[:, :5], np.full(len(candidates), polarity), _SECTORS, shown)
        traced = candidates[:, 5] >= _LEAST_COVERAGE
        plain = (shown[:, 0] > KNOWN_SHAPE.score) & (shown[:, 1] >= KNOWN_SHAPE.hits)
        found.append(candidates[(traced | plain) & (shown[:, 0] > evidence.score) & (shown[:, 1] >= evidence.hits)])
    return [Ellipse.of(c[:5]) for c in _distinct(np.concatenate(found))]


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
    points = arcs.u[order], v, arcs.nu[order], arcs.nv[order]
    fit_candidates(starts, *points, rows, expected, shapes.freedom, ellipses, coverage, agreement)
    return np.column_stack([ellipses, coverage, agreement])


def _distinct(candidates: Array) -> Array:
    """Candidates in order of support without those that repeat a better one."""
    order = np.argsort(-candidates[:, 5] * candidates[:, 6], kind="stable")
    candidates = candidates[order]
    alive = np.ones(len(candidates), np.bool_)
    strike_repeats(candidates, alive)
    return candidates[alive]
