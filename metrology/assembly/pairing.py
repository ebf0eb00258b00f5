"""Where two scans stand to each other: every way in which pairs of heads can be the same, weighed by the evidence.

Two heads and the skin's direction fix a placement. Few of the heads of two neighbouring stations are shared, and
patterns are regular, so that geometry alone often fits in several ways. What tells them apart is what rivets and seams
have of their own: a head's height, small errors of its place, a seam's profile. The evidence is the logarithm of how
much more probable the two scans are as views of one skin than as views of two that are built alike.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from metrology.arrays import Array, Ints
from metrology.assembly.adjust import Tie, adjusted
from metrology.assembly.overlap import (
    DIAMETER_RATIO,
    HEAD_REACH_MM,
    head_partners,
    heads_expected,
    seam_ties,
    skin_ties,
)
from metrology.assembly.scan import PanelScan
from metrology.panel import Placement
from metrology.registration.search import PointPattern, alike, frames
from metrology.results import COVERAGE_95

HEAD_SIGMA_MM = 0.02
"""Standard deviation of a head's place along the skin, in each direction, with what a rig's field adds."""
_JITTER_MM = 0.3  # usual deviation of a drilled hole from its place in the pattern
_HEIGHT_FLOOR_MM = 0.005  # what two rigs or placements differ by beyond the stated uncertainties
_LENGTH_TOLERANCE_MM = 0.15
_SHORTEST_MM = 15.0
_MOST_CANDIDATES = 1500
_KEPT = 8
_ARM_MM = 20.0  # a normal counts as a second point so far above the head
# Evidence of the heads alone that a seam's profile does not make up for, and how far behind the best one.
_HOPELESS, _BEHIND = -15.0, 25.0
_LOOKED_AT = 3
_FEWEST_CELLS = 3
_NOT_THE_SAME = float(np.log(0.02))  # a head that was drilled out, or set anew, between the scans
_NOT_FOUND = float(np.log(0.05))
_PROFILE_MM = 10.0  # seam positions farther apart are independent
_SKIN_APART_MM = 0.15  # a skin that is farther off in the middle of the cells is another one
ENOUGH = float(np.log(1000.0))
"""Evidence from which on two scans are taken for neighbours."""
DISTINCT = float(np.log(20.0))
"""By how much the best placement has to be more probable than the next."""


@dataclass(frozen=True)
class Neighbours:
    """Two scans of one skin."""

    placement: Placement
    """From the second scan's rig frame to the first one's."""
    evidence: float
    """Natural logarithm of the odds."""
    rival: float
    """The evidence of the best placement that pairs heads otherwise; −inf where there is none."""
    heads: Ints
    """(m, 2) of int: heads that are the same."""

    @property
    def ambiguous(self) -> bool:
        """Whether another placement is almost as probable."""
        return self.evidence - self.rival < DISTINCT

    @property
    def convincing(self) -> bool:
        """Whether the two are neighbours, placed in one way only."""
        return self.evidence >= ENOUGH and not self.ambiguous


def neighbours(first: PanelScan, second: PanelScan, near: Placement | None = None) -> Neighbours | None:
    """The most probable placement of the second scan to the first; None where no two heads fit and the skins meet.

    Parameters
    ----------
    near : Placement, optional
        Where the second scan is expected, from its rig frame to the first one's; looked at beside what the heads say.
    """
    starts = [_by_heads(first, second, start) for start in _starts(first, second)]
    ranked = sorted(((_of_heads(first, second, *start), start[0]) for start in starts), key=lambda each: -each[0])
    hopeful = [start for evidence, start in ranked[:_LOOKED_AT] if evidence > max(ranked[0][0] - _BEHIND, _HOPELESS)]
    given = [] if near is None else [near]
    judged = [judged_at(first, second, start) for start in [*given, *hopeful]]
    found = sorted((each for each in judged if each is not None), key=lambda each: -each.evidence)
    if not found:
        return None
    rivals = [each.evidence for each in found[1:] if _other(found[0], each)]
    return replace(found[0], rival=max(rivals, default=float("-inf")))


def judged_at(first: PanelScan, second: PanelScan, start: Placement) -> Neighbours | None:
    """Two scans near a placement, refined on all that they share; None where their skins do not meet there."""
    placement = start
    for _ in range(2):
        ties = skin_ties(first, second, placement)
        if len(ties) < _FEWEST_CELLS:
            return None
        heads = head_partners(first, second, placement)
        placement = _refined(first, second, placement, Tie(0, 1, heads, ties, seam_ties(first, second, placement)))
    apart = ((placement.to_panel(ties.second) - ties.first) * ties.normal).sum(1)
    if np.median(np.abs(apart)) > _SKIN_APART_MM:
        return None
    heads = head_partners(first, second, placement)
    evidence = _of_heads(first, second, placement, heads) + _of_profiles(first, second, placement)
    return Neighbours(placement, evidence, float("-inf"), heads)


def _by_heads(first: PanelScan, second: PanelScan, start: Placement) -> tuple[Placement, Ints]:
    """A placement fitted to the heads and the skin's directions alone, and which of them are the same."""
    heads = head_partners(first, second, start)
    if len(heads) < 2:
        return start, heads
    arms = [
        np.concatenate([p.positions[k], p.positions[k] + _ARM_MM * _normals(p)[k]])
        for p, k in ((first.pattern, heads[:, 0]), (second.pattern, heads[:, 1]))
    ]
    placement = rigid(arms[1], arms[0])
    return placement, head_partners(first, second, placement)


def rigid(points: Array, onto: Array) -> Placement:
    """The motion that lays points (n, 3) on others best (Kabsch 1976)."""
    middle, target = points.mean(0), onto.mean(0)
    u, _, vt = np.linalg.svd((points - middle).T @ (onto - target))
    R = vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
    return Placement(R, target - R @ middle)


def _refined(first: PanelScan, second: PanelScan, placement: Placement, tie: Tie) -> Placement:
    """The joint adjustment, for the two alone."""
    return adjusted([first, second], [Placement(np.eye(3), np.zeros(3)), placement], [tie], steps=2).placements[1]


def _other(best: Neighbours, each: Neighbours) -> bool:
    """Whether two placements differ by more than a head's reach where the second scan has its heads."""
    return float(np.linalg.norm(best.placement.t - each.placement.t)) > 3 * HEAD_REACH_MM


def _starts(first: PanelScan, second: PanelScan) -> list[Placement]:
    """Placements of pairs of equal length, those that pair most heads of equal heights first, each pairing once."""
    R, t = _hypotheses(first, second)
    if len(R) == 0:
        return []
    a, b = first.pattern, second.pattern
    at = np.einsum("mij,nj->mni", R, b.positions) + t[:, None]
    alike_ab = alike(b.diameters[:, None], a.diameters, DIAMETER_RATIO)
    distance = np.linalg.norm(at[:, :, None] - a.positions, axis=3)
    distance[:, ~alike_ab] = np.inf
    nearest = distance.argmin(2)
    met = np.take_along_axis(distance, nearest[..., None], 2)[..., 0] <= HEAD_REACH_MM
    unlike = np.abs(_height_chi(first, second))[nearest, np.arange(len(b))] > 4
    score = np.where(met, np.where(unlike, -0.5, 1.0), 0.0).sum(1)
    pairing = np.where(met, nearest, -1)
    kept: dict[tuple[int, ...], Placement] = {}
    for k in np.argsort(-score, kind="stable"):
        kept.setdefault(tuple(pairing[k]), Placement(R[k], t[k]))
        if len(kept) == _KEPT:
            break
    return list(kept.values())


def _height_chi(first: PanelScan, second: PanelScan) -> Array:
    """(na, nb) differences of heads' heights in standard deviations; 0 where one was not measured."""
    a, b = first.heights, second.heights
    sigma = np.sqrt((a[:, None, 1] ** 2 + b[None, :, 1] ** 2) / COVERAGE_95**2 + 2 * _HEIGHT_FLOOR_MM**2)
    return np.nan_to_num((a[:, None, 0] - b[None, :, 0]) / sigma)


def _hypotheses(first: PanelScan, second: PanelScan) -> tuple[Array, Array]:
    """Rotations (m, 3, 3) and translations (m, 3) that lay a pair of the second scan's heads on one of the first's."""
    a, b = first.pattern, second.pattern
    none = np.empty((0, 3, 3)), np.empty((0, 3))
    if len(a) < 2 or len(b) < 2:
        return none
    i, j = np.triu_indices(len(a), 1)
    k, m = np.nonzero(~np.eye(len(b), dtype=bool))
    one, two = a.positions[j] - a.positions[i], b.positions[m] - b.positions[k]
    length, other = np.linalg.norm(one, axis=1), np.linalg.norm(two, axis=1)
    same = np.abs(length[:, None] - other) < _LENGTH_TOLERANCE_MM
    same &= (length > _SHORTEST_MM)[:, None]
    sizes = alike(a.diameters[:, None], b.diameters, DIAMETER_RATIO)
    same &= sizes[i[:, None], k] & sizes[j[:, None], m]
    p, q = np.nonzero(same)
    chi = np.abs(_height_chi(first, second))
    unlike = np.maximum(chi[i[p], k[q]], chi[j[p], m[q]])
    best = np.argsort(unlike, kind="stable")[:_MOST_CANDIDATES]
    p, q = p[best], q[best]
    normal_a, normal_b = _normals(a), _normals(b)
    onto = frames(one[p], normal_a[i[p]] + normal_a[j[p]])
    of = frames(two[q], normal_b[k[q]] + normal_b[m[q]])
    R = onto @ np.transpose(of, (0, 2, 1))
    t = (a.positions[i[p]] + a.positions[j[p]]) / 2 - np.einsum(
        "mij,mj->mi", R, (b.positions[k[q]] + b.positions[m[q]]) / 2
    )
    proper = np.abs(np.linalg.det(R) - 1) < 1e-6
    return R[proper], t[proper]


def _normals(pattern: PointPattern) -> Array:
    """Normals of heads; the mean of the others' where one is unknown."""
    known = np.asarray(np.isfinite(pattern.normals).all(axis=1))
    mean = pattern.normals[known].mean(0) if known.any() else np.array([0.0, 0.0, -1.0])
    return np.where(known[:, None], pattern.normals, mean)


def _of_heads(first: PanelScan, second: PanelScan, placement: Placement, heads: Ints) -> float:
    """How much more probable the heads are as those of one skin than as those of two that are built alike."""
    expected_a, expected_b = heads_expected(first, second, placement)
    expected_a[heads[:, 0]] = expected_b[heads[:, 1]] = False
    missing = _NOT_FOUND * float(expected_a.sum() + expected_b.sum())
    return sum([*_of_places(first, second, placement, heads), *_of_heights(first, second, heads)], missing)


def _of_places(first: PanelScan, second: PanelScan, placement: Placement, heads: Ints) -> Iterator[float]:
    """Heads' places along the skin, without the three coordinates that the placement itself takes up."""
    if len(heads) == 0:
        return
    apart = placement.to_panel(second.pattern.positions[heads[:, 1]]) - first.pattern.positions[heads[:, 0]]
    normal = _normals(first.pattern)[heads[:, 0]]
    apart -= (apart * normal).sum(1, keepdims=True) * normal
    squared = (apart**2).sum(1)
    sigma2, jitter2 = 2 * HEAD_SIGMA_MM**2, 2 * _JITTER_MM**2
    gain = 0.5 * float(np.log(jitter2 / sigma2))
    yield -3 * gain
    for distance2 in squared:
        yield max(2 * gain - 0.5 * distance2 / sigma2 + 0.5 * distance2 / jitter2, _NOT_THE_SAME)


def _of_heights(first: PanelScan, second: PanelScan, heads: Ints) -> Iterator[float]:
    spread = float(np.nanstd(np.concatenate([first.heights[:, 0], second.heights[:, 0]]))) if len(heads) else 0.0
    for a, b in heads:
        (one, u_one), (two, u_two) = first.heights[a], second.heights[b]
        if not np.isfinite(one + two):
            continue
        sigma = float(np.sqrt((u_one**2 + u_two**2) / COVERAGE_95**2 + 2 * _HEIGHT_FLOOR_MM**2))
        yield _ratio(one - two, sigma, np.sqrt(2) * spread)


def _of_profiles(first: PanelScan, second: PanelScan, placement: Placement) -> float:
    """Steps along shared seams; the seams' own scatter of steps says how little a chance agreement means."""
    ties = seam_ties(first, second, placement)
    known = np.isfinite(ties.steps).all(1)
    if known.sum() < 3:
        return 0.0
    steps, u95 = ties.steps[known], ties.step_u95[known]
    sigma = np.sqrt((np.nan_to_num(u95) ** 2).sum(1) / COVERAGE_95**2 + 2 * (2 * _HEIGHT_FLOOR_MM) ** 2)
    spread = float(np.sqrt(2) * np.std(steps))
    length = float(np.ptp((ties.second[known] - ties.second[known].mean(0)) @ ties.tangent[known].mean(0)))
    independent = max(1.0, length / _PROFILE_MM)
    each = [_ratio(d, s, spread) for d, s in zip(steps[:, 0] - steps[:, 1], sigma, strict=True)]
    return float(np.mean(each)) * independent


def _ratio(difference: float, sigma: float, spread: float) -> float:
    """Log-odds that two values are of one thing rather than of two out of a spread."""
    spread = max(spread, sigma)
    return max(
        float(np.log(spread / sigma) - 0.5 * (difference / sigma) ** 2 + 0.5 * (difference / spread) ** 2),
        _NOT_THE_SAME,
    )
