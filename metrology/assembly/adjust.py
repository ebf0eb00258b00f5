"""The placements of all scans at once, from everything that any two of them share and from the nominal pattern.

Unknown is a small motion of each scan about the middle of its skin. Residuals are weighed by their standard deviations
and, robustly, by Cauchy's weights, so that a head that was changed between two scans does not pull; Gauss-Newton steps
lead to the joint minimum, with the covariance of all placements. No chain of pairs is followed: an error that a loop
of stations shows is shared out over all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from metrology.arrays import Array, Ints
from metrology.assembly.overlap import SeamTies, SkinTies
from metrology.assembly.scan import PanelScan
from metrology.panel import Placement
from metrology.registration.fit import cross_matrix

HEAD_ALONG_MM = 0.02  # standard deviation of a head's place along the skin
HEAD_OFF_MM = 0.02  # and across it
SKIN_MM = 0.02  # of a cell of skin: mostly the rig's own error of the field, which neighbouring cells share
SEAM_MM = 0.05  # of a seam's course
NOMINAL_MM = 0.5  # of a drilled hole against the drawing
# Cells of skin and seam positions share their errors with their neighbours, so they count for fewer.
_INDEPENDENT_CELLS, _INDEPENDENT_POSITIONS = 12, 4
_HELD = 1e6  # weight of what is held
_WEAK_MM, _WEAK_RAD = 200.0, 0.2  # keeps what nothing else decides where it was
_CONVERGED = 1e-7


@dataclass(frozen=True)
class Tie:
    """What two scans, by their numbers, share."""

    first: int
    second: int
    heads: Ints
    """(m, 2) of int."""
    skin: SkinTies
    seam: SeamTies


@dataclass(frozen=True)
class NominalTie:
    """Heads of a scan (n, 3, rig frame) and where the pattern has them (n, 3, panel frame)."""

    scan: int
    found: Array
    nominal: Array


@dataclass(frozen=True)
class Adjusted:
    """Placements of all scans."""

    placements: tuple[Placement, ...]
    covariance: Array = field(repr=False)
    """(6 n, 6 n): of each scan's turn (rad) and shift (mm) about the middle of its skin, panel frame."""
    scatter: float
    """Size of the residuals against their standard deviations, at least 1; the covariance is scaled by its square."""

    def moved(self, motion: Placement) -> Adjusted:
        """The same in another frame."""
        placements = tuple(Placement(motion.R @ p.R, motion.R @ p.t + motion.t) for p in self.placements)
        turn = np.kron(np.eye(2 * len(placements)), motion.R)
        return replace(self, placements=placements, covariance=turn @ self.covariance @ turn.T)

    def place_covariance(self, scans: Sequence[PanelScan], number: int, point: Array) -> Array:
        """(3, 3) covariance of a point (3,) of the panel frame that a scan saw, from its placement alone."""
        middle = self.placements[number].to_panel(scans[number].skin.middle)
        rows = np.hstack([cross_matrix((point - middle)[None])[0], np.eye(3)])
        block = slice(6 * number, 6 * number + 6)
        return np.asarray(rows @ self.covariance[block, block] @ rows.T)


def adjusted(
    scans: Sequence[PanelScan], start: Sequence[Placement], ties: Sequence[Tie], nominal: Sequence[NominalTie] = (),
    steps: int = 8,
) -> Adjusted:  # fmt: skip
    """Adjust placements jointly; without a nominal pattern the first scan stays where it is."""
    placements = list(start)
    for _ in range(steps):
        jacobian, residual, _ = _system(scans, placements, ties, nominal)
        normal = jacobian.T @ jacobian
        step = np.asarray(-np.linalg.solve(normal, jacobian.T @ residual), float)
        for k, scan in enumerate(scans):
            placements[k] = _moved(placements[k], scan.skin.middle, step[6 * k : 6 * k + 6])
        if np.abs(step).max() < _CONVERGED:
            break
    jacobian, residual, real = _system(scans, placements, ties, nominal)
    freedom = max(int(real.sum()) - 6 * (len(scans) - (not nominal)), 1)
    scatter = float(np.sqrt(max(1.0, (residual[real] ** 2).sum() / freedom)))
    return Adjusted(tuple(placements), np.asarray(np.linalg.inv(jacobian.T @ jacobian), float) * scatter**2, scatter)


def _moved(placement: Placement, middle_rig: Array, step: Array) -> Placement:
    middle = placement.to_panel(middle_rig)
    turn = Rotation.from_rotvec(step[:3]).as_matrix()
    # Rounding adds up over many turns: the nearest rotation again.
    u, _, vt = np.linalg.svd(turn @ placement.R)
    return replace(placement, R=u @ vt, t=turn @ (placement.t - middle) + middle + step[3:])


def _system(
    scans: Sequence[PanelScan], placements: Sequence[Placement], ties: Sequence[Tie], nominal: Sequence[NominalTie]
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Weighted Jacobian and residuals, and which of these are measurements."""
    middles = [p.to_panel(scan.skin.middle) for p, scan in zip(placements, scans, strict=True)]
    n = len(scans)
    parts: list[tuple[Array, Array]] = []
    for tie in ties:
        parts += _of_tie(scans, placements, middles, tie)
    for given in nominal:
        at = placements[given.scan].to_panel(given.found)
        rows = np.zeros((len(at), 3, 6 * n))
        rows[:, :, 6 * given.scan : 6 * given.scan + 6] = _motion(at, middles[given.scan])
        parts.append(_weighted(rows / NOMINAL_MM, (at - given.nominal) / NOMINAL_MM))
    measured = sum(len(residual) for _, residual in parts)
    weak = np.tile(np.repeat([1 / _WEAK_RAD, 1 / _WEAK_MM], 3), n)
    if not nominal:
        weak[:6] = _HELD
    jacobian = np.concatenate([*(rows for rows, _ in parts), np.diag(weak)])
    residual = np.concatenate([*(values for _, values in parts), np.zeros(6 * n)])
    return jacobian, residual, np.arange(len(residual)) < measured


def _of_tie(
    scans: Sequence[PanelScan], placements: Sequence[Placement], middles: Sequence[Array], tie: Tie
) -> list[tuple[Array, Array]]:
    i, j, n = tie.first, tie.second, len(scans)

    def rows_of(first: Array, second: Array) -> tuple[Array, Array]:
        """(k, 3, 6 n) and (k, 3): second minus first, panel frame."""
        a, b = placements[i].to_panel(first), placements[j].to_panel(second)
        rows = np.zeros((len(a), 3, 6 * n))
        rows[:, :, 6 * i : 6 * i + 6] = -_motion(a, middles[i])
        rows[:, :, 6 * j : 6 * j + 6] = _motion(b, middles[j])
        return rows, b - a

    parts = []
    if len(tie.heads):
        one, two = scans[i].pattern, scans[j].pattern
        rows, apart = rows_of(one.positions[tie.heads[:, 0]], two.positions[tie.heads[:, 1]])
        normals = np.nan_to_num(one.normals[tie.heads[:, 0]]) @ placements[i].R.T
        off = normals[:, :, None] * normals[:, None, :]
        scale = (np.eye(3) - off) / HEAD_ALONG_MM + off / HEAD_OFF_MM
        parts.append(_weighted(scale @ rows / np.sqrt(2), np.einsum("kij,kj->ki", scale, apart) / np.sqrt(2)))
    if len(tie.skin):
        rows, apart = rows_of(tie.skin.first, tie.skin.second)
        normal = tie.skin.normal @ placements[i].R.T
        sigma = np.hypot(tie.skin.sigma, SKIN_MM)
        share = min(1.0, _INDEPENDENT_CELLS / len(tie.skin))
        flat = np.einsum("ki,kij->kj", normal, rows)[:, None] / sigma[:, None, None]
        parts.append(_weighted(flat, (normal * apart).sum(1)[:, None] / sigma[:, None], share))
    if len(tie.seam):
        rows, apart = rows_of(tie.seam.first, tie.seam.second)
        tangent = tie.seam.tangent @ placements[i].R.T
        across = np.eye(3) - tangent[:, :, None] * tangent[:, None, :]
        share = min(1.0, _INDEPENDENT_POSITIONS / len(tie.seam))
        parts.append(_weighted(across @ rows / SEAM_MM, np.einsum("kij,kj->ki", across, apart) / SEAM_MM, share))
    return parts


def _motion(at: Array, middle: Array) -> Array:
    """(k, 3, 6) how points move with the turn about the middle and the shift."""
    return np.concatenate([cross_matrix(at - middle), np.broadcast_to(np.eye(3), (len(at), 3, 3))], axis=2)


def _weighted(jacobian: Array, residual: Array, share: float = 1.0) -> tuple[Array, Array]:
    """Rows (k, d, 6 n) and (k, d) with Cauchy's weights, one for each point, flattened."""
    weight = np.sqrt(share / (1 + (residual**2).sum(1) / 4))
    return (jacobian * weight[:, None, None]).reshape(-1, jacobian.shape[2]), (residual * weight[:, None]).ravel()
