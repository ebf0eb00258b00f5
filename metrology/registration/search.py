"""Candidate placements of the rig: every way in which pairs of found rivets can be pairs of the nominal pattern.

Two points fix a placement up to the turn about the line through them; that turn is taken from the nominal placement
or, without one, from the skin's direction. Its error moves points off the skin, hardly along it, so candidates are
counted by agreement along the skin. No random draws: the same scan gives the same candidates.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from metrology.arrays import Array, Ints
from metrology.panel import Placement

_MAX_PAIRS = 60  # of found rivets; with 3 in 10 of them false, half the pairs are still true ones
_MAX_CANDIDATES = 20_000
_KEPT = 20
_NEIGHBOURS = 8


@dataclass(frozen=True)
class PointPattern:
    """Rivets as points: positions (n, 3) mm, unit outward normals (n, 3), diameters (n,) mm with NaN where unknown."""

    positions: Array
    normals: Array
    diameters: Array

    def __len__(self) -> int:
        return len(self.positions)


@dataclass(frozen=True)
class SearchLimits:
    """How far a candidate may be from the nominal placement and from agreement."""

    tolerance_mm: float
    """Between a found and a nominal rivet, along the skin."""
    off_skin_mm: float
    """The same across the skin, before the turn about the line of the pair is refined."""
    max_turn_rad: float
    max_shift_mm: float
    """max_turn_rad, max_shift_mm: of the rig against its nominal placement."""
    diameter_ratio: float
    """Heads whose diameters differ by a larger factor are different rivets."""


def estimated_normals(positions: Array) -> Array:
    """Normals of a pattern from neighbours' positions, taken to face +z; +z itself where rivets are in a row."""
    normals = np.tile([0.0, 0.0, 1.0], (len(positions), 1))
    if len(positions) < 4:
        return normals
    _, neighbours = cKDTree(positions).query(positions, k=min(_NEIGHBOURS, len(positions)))
    for k, near in enumerate(neighbours):
        centred = positions[near] - positions[near].mean(0)
        _, spread, axes = np.linalg.svd(centred, full_matrices=False)
        if spread[1] > 0.2 * spread[0]:  # neighbours span a surface, not a line
            normals[k] = axes[2] * (1.0 if axes[2, 2] >= 0 else -1.0)
    return normals


def motion(placement: Placement, prior: Placement, middle: Array) -> tuple[float, float]:
    """Shift in mm and turn in rad from one placement to another.

    A rig may be turned about itself or about the patch it looks at: the shift is the smaller one of its own
    centre's and that of the middle of what it sees (rig frame).
    """
    turn = float(Rotation.from_matrix(placement.R @ prior.R.T).magnitude())
    rig = float(np.linalg.norm(placement.t - prior.t))
    patch = float(np.linalg.norm(placement.to_panel(middle) - prior.to_panel(middle)))
    return min(rig, patch), turn


def candidates(
    found: PointPattern, nominal: PointPattern, prior: Placement | None, limits: SearchLimits
) -> list[Placement]:
    """The placements under which most found rivets lie on nominal ones, best first, different in what they match."""
    if len(found) < 2 or len(nominal) < 2:
        return []
    R, t = _hypotheses(found, nominal, prior, limits)
    if len(R) == 0:
        return []
    matches = _matches(R, t, found, nominal, limits)
    count = (matches >= 0).sum(1)
    kept: dict[tuple[int, ...], Placement] = {}
    for k in np.argsort(-count, kind="stable"):
        if len(kept) == _KEPT or count[k] < count.max() / 2:
            break
        kept.setdefault(tuple(matches[k]), Placement(R[k], t[k]))
    return list(kept.values())


def _hypotheses(
    found: PointPattern, nominal: PointPattern, prior: Placement | None, limits: SearchLimits
) -> tuple[Array, Array]:
    """Rotations (m, 3, 3) and translations (m, 3) from pairs of equal length."""
    tree = cKDTree(nominal.positions)
    rotations, translations, count = [], [], 0
    for a, b in _spread_pairs(found.positions):
        i, j = _equal_pairs(a, b, found, nominal, tree, prior, limits)
        R = _turns(found, nominal, a, b, i, j, prior)
        middle = (found.positions[a] + found.positions[b]) / 2
        t = (nominal.positions[i] + nominal.positions[j]) / 2 - R @ middle
        proper = np.abs(np.linalg.det(R) - 1) < 1e-6  # not where a normal lies along its line
        R, t = R[proper], t[proper]
        rotations.append(R)
        translations.append(t)
        count += len(R)
        if count > _MAX_CANDIDATES:
            break
    return np.concatenate(rotations), np.concatenate(translations)


def _spread_pairs(positions: Array) -> Iterator[tuple[int, int]]:
    """Pairs of points with long lines between them, each point in turn, so that no false point is in most of them."""
    distance = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    partners = np.argsort(-distance, axis=1, kind="stable")
    given: set[tuple[int, int]] = set()
    for rank in range(len(positions) - 1):
        for a in range(len(positions)):
            pair = (min(a, int(partners[a, rank])), max(a, int(partners[a, rank])))
            if pair not in given:
                given.add(pair)
                yield pair
                if len(given) == _MAX_PAIRS:
                    return


def _equal_pairs(
    a: int, b: int, found: PointPattern, nominal: PointPattern, tree: cKDTree, prior: Placement | None,
    limits: SearchLimits,
) -> tuple[Ints, Ints]:  # fmt: skip
    """Nominal pairs (i, j) that the found pair (a, b) could be."""
    line = found.positions[b] - found.positions[a]
    length = float(np.linalg.norm(line))
    if prior is None:
        first = np.arange(len(nominal))
    else:
        # A rig turned about itself moves the field by its distance times the angle.
        reach = limits.max_shift_mm + np.linalg.norm(found.positions[a]) * np.sin(limits.max_turn_rad)
        first = np.array(tree.query_ball_point(prior.to_panel(found.positions[a]), reach), dtype=np.intp)
    first = first[alike(found.diameters[a], nominal.diameters[first], limits.diameter_ratio)]
    second = np.flatnonzero(alike(found.diameters[b], nominal.diameters, limits.diameter_ratio))
    i, j = (grid.ravel() for grid in np.meshgrid(first, second, indexing="ij"))
    lines = nominal.positions[j] - nominal.positions[i]
    lengths = np.linalg.norm(lines, axis=1)
    slack = np.sqrt(2) * limits.tolerance_mm
    fits = (np.abs(lengths - length) <= slack) & (lengths > 0)
    if prior is not None:
        cosine = lines @ (prior.R @ line) / np.maximum(lengths * length, 1e-12)
        fits &= np.arccos(np.clip(cosine, -1, 1)) <= limits.max_turn_rad + slack / max(length, slack)
    return i[fits], j[fits]


def alike(diameter: ArrayLike, diameters: Array, ratio: float) -> NDArray[np.bool_]:
    """Whether diameters differ by less than a factor; unknown ones (NaN) are alike to all."""
    return np.asarray(~(np.abs(np.log(diameters / np.asarray(diameter))) > np.log(ratio)))


def _turns(
    found: PointPattern, nominal: PointPattern, a: int, b: int, i: Ints, j: Ints, prior: Placement | None
) -> Array:
    """(m, 3, 3) rotations that lay the found line on each nominal line."""
    line = found.positions[b] - found.positions[a]
    lines = nominal.positions[j] - nominal.positions[i]
    if prior is None:
        start = frames(line[None], (found.normals[a] + found.normals[b])[None])
        return np.asarray(frames(lines, nominal.normals[i] + nominal.normals[j]) @ np.transpose(start, (0, 2, 1)))
    expected = prior.R @ line
    axis = np.cross(expected, lines)
    sine, cosine = np.linalg.norm(axis, axis=1), lines @ expected
    angle = np.arctan2(sine, cosine)
    rotvec = axis * (angle / np.maximum(sine, 1e-12))[:, None]
    return np.asarray(Rotation.from_rotvec(rotvec.reshape(-1, 3)).as_matrix() @ prior.R)


def frames(lines: Array, normals: Array) -> Array:
    """(m, 3, 3) right-handed frames: columns along the line, across it, and near the normal."""
    x = lines / np.linalg.norm(lines, axis=1, keepdims=True)
    y = np.cross(normals, x)
    y /= np.maximum(np.linalg.norm(y, axis=1, keepdims=True), 1e-12)
    return np.stack([x, y, np.cross(x, y)], axis=2)


def _matches(R: Array, t: Array, found: PointPattern, nominal: PointPattern, limits: SearchLimits) -> Ints:
    """(m, n) nominal rivet under each found one, −1 where none is."""
    at = np.einsum("mij,nj->mni", R, found.positions) + t[:, None]
    reach = float(np.hypot(limits.tolerance_mm, limits.off_skin_mm))
    _, nearest = cKDTree(nominal.positions).query(at, distance_upper_bound=reach)
    missed = nearest == len(nominal)
    nearest = np.where(missed, 0, nearest)
    offset = at - nominal.positions[nearest]
    normal = nominal.normals[nearest]
    across = (offset * normal).sum(2)
    along = np.linalg.norm(offset - across[..., None] * normal, axis=2)
    missed |= (along > limits.tolerance_mm) | (np.abs(across) > limits.off_skin_mm)
    missed |= ~alike(found.diameters, nominal.diameters[nearest], limits.diameter_ratio)
    return np.where(missed, -1, nearest)
