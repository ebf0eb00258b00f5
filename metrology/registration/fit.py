"""The placement that fits correspondences best: a rigid motion by robust least squares with a weak prior.

The prior (the placement before the fit) decides nothing where rivets or seams do; it keeps in place what they leave
open, such as the turn about a single row of rivets or the shift along a lone seam.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from metrology.arrays import Array
from metrology.panel import NominalSeam, Placement, foot_on

_STEPS = 10
_CONVERGED = 1e-6  # mm and rad
# A seam's stations share its deviations from the drawing, so they count as this many points and no more.
_INDEPENDENT_STATIONS = 5


@dataclass(frozen=True)
class FitWeights:
    """Standard deviations that weigh the residuals."""

    rivet_mm: float = 0.5
    """Of a rivet's position against the nominal one."""
    normal_rad: float = 0.035
    """Of the skin's direction against the nominal one."""
    seam_mm: float = 1.0
    """Of a seam's course against the nominal one."""
    prior_mm: float = 50.0
    prior_rad: float = 0.1
    """prior_mm, prior_rad: of the placement before the fit, in shift and turn."""


@dataclass(frozen=True)
class Correspondences:
    """What belongs together: n rivets with positions in both frames, and pieces of seams with their nominal seam."""

    found: Array
    nominal: Array
    """found, nominal: (n, 3): rivets in the rig frame and in the panel frame, mm."""
    found_normals: Array
    nominal_normals: Array
    """found_normals, nominal_normals: (n, 3): unit normals; NaN where unknown."""
    seams: Sequence[tuple[Array, NominalSeam]] = ()
    """sequence of ((k, 3), NominalSeam): stations in the rig frame."""


def fit_placement(pairs: Correspondences, start: Placement, prior: Placement, weights: FitWeights) -> Placement:
    """Fit the placement to correspondences by iteratively reweighted Gauss-Newton steps from `start`.

    The motion is a turn ω and a shift τ at the middle c of what was found, x → exp(ω)(x − c) + c + τ, so that the
    prior on the shift means the field of view and not the far-away rig. Cauchy weights 1/(1 + r²) keep single rivets
    that were matched wrongly or stand far off from pulling.
    """
    middle_rig = np.concatenate([pairs.found, *(stations for stations, _ in pairs.seams)]).mean(0)
    placement = start
    turned = Rotation.from_matrix(start.R @ prior.R.T).as_rotvec()
    moved = np.concatenate([turned, start.to_panel(middle_rig) - prior.to_panel(middle_rig)])
    for _ in range(_STEPS):
        middle = placement.to_panel(middle_rig)
        blocks = [_rivets(pairs, placement, middle, weights), _normals(pairs, placement, weights)]
        blocks += [_seam(stations, seam, placement, middle, weights) for stations, seam in pairs.seams]
        # Prior: the whole motion so far, which is small enough for turns to add.
        scale = 1 / np.repeat([weights.prior_rad, weights.prior_mm], 3)
        blocks.append((np.diag(scale), moved * scale))
        jacobian = np.concatenate([block[0] for block in blocks])
        residual = np.concatenate([block[1] for block in blocks])
        step = -np.linalg.solve(jacobian.T @ jacobian, jacobian.T @ residual)
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        placement = replace(placement, R=turn @ placement.R, t=turn @ (placement.t - middle) + middle + step[3:])
        moved = moved + step
        if np.abs(step).max() < _CONVERGED:
            break
    return placement


def cross_matrix(arms: Array) -> Array:
    """(n, 3, 3) d(ω × r)/dω = −[r]× for arms r (n, 3)."""
    matrix = np.zeros((len(arms), 3, 3))
    matrix[:, 0, 1], matrix[:, 0, 2] = arms[:, 2], -arms[:, 1]
    matrix[:, 1, 0], matrix[:, 1, 2] = -arms[:, 2], arms[:, 0]
    matrix[:, 2, 0], matrix[:, 2, 1] = arms[:, 1], -arms[:, 0]
    return matrix


def _weighted(jacobian: Array, residual: Array, share: float = 1.0) -> tuple[Array, Array]:
    """Rows (n, k, 6) and (n, k) with Cauchy weights per point, flattened."""
    weight = np.sqrt(share / (1 + (residual**2).sum(1)))
    rows = (jacobian * weight[:, None, None]).reshape(-1, 6)
    return rows, (residual * weight[:, None]).ravel()


def _rivets(pairs: Correspondences, placement: Placement, middle: Array, weights: FitWeights) -> tuple[Array, Array]:
    at = placement.to_panel(pairs.found)
    identity = np.broadcast_to(np.eye(3), (len(at), 3, 3))
    jacobian = np.concatenate([cross_matrix(at - middle), identity], axis=2)
    return _weighted(jacobian / weights.rivet_mm, (at - pairs.nominal) / weights.rivet_mm)


def _normals(pairs: Correspondences, placement: Placement, weights: FitWeights) -> tuple[Array, Array]:
    known = np.isfinite(pairs.found_normals + pairs.nominal_normals).all(1)
    at = pairs.found_normals[known] @ placement.R.T
    jacobian = np.concatenate([cross_matrix(at), np.zeros((len(at), 3, 3))], axis=2)
    return _weighted(jacobian / weights.normal_rad, (at - pairs.nominal_normals[known]) / weights.normal_rad)


def _seam(
    stations: Array, seam: NominalSeam, placement: Placement, middle: Array, weights: FitWeights
) -> tuple[Array, Array]:
    at = placement.to_panel(stations)
    foot = foot_on(seam.course, at)
    # Only the distance from the line counts: what lies along the tangent is left free.
    across = np.eye(3) - foot.tangent[:, :, None] * foot.tangent[:, None, :]
    motion = np.concatenate([cross_matrix(at - middle), np.broadcast_to(np.eye(3), (len(at), 3, 3))], axis=2)
    share = min(1.0, _INDEPENDENT_STATIONS / len(at))
    return _weighted(across @ motion / weights.seam_mm, foot.offset / weights.seam_mm, share)
