"""The projector of a rig whose cameras are calibrated, from scans of anything with depth.

Every measured point is where the cameras say, and its decoded coordinate is the projector's column (row, for fringes
along y) that lights it: that is the projector's view of a known shape. Medians of blocks wider than a fringe average
out the ripple of the projector's gamma. Fringes along one axis tell a projector's columns and nothing of its rows:
these follow from square pixels and from a light that covers what was seen, and are marked as assumed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from metrology.arrays import Array
from metrology.calibration.bundle import lens_vector
from metrology.calibration.distortion_model import PINHOLE, Evidence, choose_terms
from metrology.calibration.lens import INTRINSICS, project
from metrology.calibration.linear_projector import linear_projector
from metrology.cloud import Reconstruction
from metrology.device_plausibility import check_device
from metrology.errors import CalibrationError, RigError
from metrology.fringe import Axis
from metrology.rig import Device
from metrology.robust import MAD

_POSE = ("rx", "ry", "rz", "tx", "ty", "tz")
_BLOCKS_ACROSS = 40
_LEAST_PER_BLOCK = 20
_LEAST_BLOCKS = 60
_ROUNDS = 3
_HUBER = 2.5  # robust standard deviations at which the loss turns linear
_FAR_OFF = 1e6  # standard deviations: a step that leads there is taken back
_COVERAGE = 2.0
_SQUARE = 0.005  # standard deviation of fy/fx − 1 where one of them is not seen
_WORST_FOCAL = 0.05  # U95 over the focal length from which the scans count as flat


@dataclass(frozen=True)
class SeenPoints:
    """Points of one scan and what the projector shows there."""

    axis: Axis
    """Of the coordinate."""
    points: Array
    """(n, 3): rig frame, mm."""
    coordinate: Array
    """(n,): decoded, projector pixels."""
    block: NDArray[np.int64]
    """(n,) int array: blocks of the left image to which the points belong, 0 … m − 1."""


@dataclass(frozen=True)
class FittedProjector:
    """A projector and how well it is known."""

    device: Device
    sigma: Mapping[str, float]
    """Standard deviations of fx, fy, cx, cy, distortion terms (px), rx, ry, rz (rad), tx, ty, tz (mm)."""
    rms_px: float
    """Of the blocks' decoded minus projected coordinates."""
    blocks: int
    terms: tuple[str, ...]
    """Distortion terms that the scans support."""
    evidence: tuple[Evidence, ...]
    assumed: str | None
    """"rows", "columns" or None: what no fringes showed."""
    place_u95_mm: float
    """Of the projector's centre, the worst direction, 95 %."""
    assumed_u95_px: float
    """Of the rows or columns that no fringes showed, where the scans have points; 0 where none are assumed."""

    @property
    def summary(self) -> dict[str, object]:
        """What a rig file keeps of it."""
        return {
            "rms_px": self.rms_px,
            "blocks": self.blocks,
            "distortion_terms": list(self.terms),
            "sigma": dict(self.sigma),
            "place_u95_mm": self.place_u95_mm,
            "assumed": self.assumed,
            "assumed_u95_px": self.assumed_u95_px,
        }


def seen_points(reconstruction: Reconstruction, axis: Axis) -> SeenPoints:
    """The good points of a scan in blocks of the left image, every few pixels."""
    width = reconstruction.flags.shape[1]
    side = max(width // _BLOCKS_ACROSS, 8)
    stride = max(side // 8, 1)
    sample = np.s_[::stride, ::stride]
    good = (reconstruction.flags[sample] == 0) & np.isfinite(reconstruction.points[sample][..., 2])
    good &= np.isfinite(reconstruction.left.coordinate[sample])
    v, u = np.nonzero(good)
    whole = (v * stride // side) * (width // side + 1) + u * stride // side
    _, block, count = np.unique(whole, return_inverse=True, return_counts=True)
    kept = count >= min(_LEAST_PER_BLOCK, (side // stride) ** 2 // 3)
    keep = kept[block]
    renumbered = np.cumsum(kept) - 1
    return SeenPoints(
        axis,
        reconstruction.points[sample][good][keep].astype(float),
        reconstruction.left.coordinate[sample][good][keep].astype(float),
        renumbered[block[keep]].astype(np.int64),
    )


def fit_projector(scans: Sequence[SeenPoints], size: tuple[int, int]) -> FittedProjector:
    """The projector of `size` (width, height) that explains all scans of one rig."""
    blocks = sum(int(scan.block.max(initial=-1)) + 1 for scan in scans)
    if blocks < _LEAST_BLOCKS:
        raise CalibrationError(f"found {blocks} blocks of measured points, expected at least {_LEAST_BLOCKS}")
    device = linear_projector([(scan.axis, scan.points, scan.coordinate) for scan in scans], size)
    axes = {scan.axis for scan in scans}
    assumed = None if len(axes) == 2 else "rows" if "x" in axes else "columns"
    problem = _Problem(scans, size, assumed, device)

    def fit(terms: tuple[str, ...]) -> tuple[float, int]:
        freedom = problem.blocks - len((*PINHOLE, *terms, *_POSE))
        try:
            found = problem.solve(terms)
            check_device(found.device, projector=True)
        except (CalibrationError, RigError):
            if not terms:
                raise
            return np.inf, freedom  # terms that no lens has, or that lead nowhere, are not supported by the scans
        return found.chi2, freedom

    terms, evidence = choose_terms("projector", fit, problem.blocks)
    found = problem.solve(terms)
    if problem.blocks <= len(found.names):
        raise CalibrationError(f"found {problem.blocks} blocks, expected more than {len(found.names)} unknowns")
    sigma = dict(zip(found.names, np.sqrt(np.diag(found.covariance)), strict=True))
    focal = _COVERAGE * sigma["fx" if assumed != "columns" else "fy"] / found.device.K[0, 0]
    if not focal < _WORST_FOCAL:
        raise CalibrationError(
            f"found scans that leave the projector's focal length uncertain by ±{focal:.0%} (95 %), expected at most "
            f"±{_WORST_FOCAL:.0%}: what they show is flat; add a scan of something with depth, or of a plane tilted "
            "another way, nearer and farther"
        )
    return FittedProjector(
        found.device,
        sigma,
        float(np.sqrt(np.mean(found.residual**2))),
        problem.blocks,
        terms,
        tuple(evidence),
        assumed,
        _COVERAGE * _place_sigma(found),
        _COVERAGE * _assumed_sigma(found, np.concatenate(problem.middles), assumed) if assumed else 0.0,
    )


@dataclass(frozen=True)
class _Solution:
    device: Device
    names: tuple[str, ...]
    covariance: Array
    residual: Array  # px, of the blocks
    chi2: float


class _Problem:
    """Blocks' medians against a projector; the medians are taken of what a model leaves, so that blocks may bend."""

    def __init__(self, scans: Sequence[SeenPoints], size: tuple[int, int], assumed: str | None, start: Device) -> None:
        self.scans, self.size, self.assumed, self.start = scans, size, assumed, start
        self.middles = [_block_means(scan) for scan in scans]
        self.blocks = sum(len(middle) for middle in self.middles)
        self.solved: dict[tuple[str, ...], _Solution] = {}

    def solve(self, terms: tuple[str, ...]) -> _Solution:
        """Least squares with Huber's loss; kept for each set of distortion terms."""
        if terms not in self.solved:
            device = self.start
            for _ in range(_ROUNDS):
                found = self._once(device, terms)
                device = found.device
            self.solved[terms] = found
        return self.solved[terms]

    def _once(self, device: Device, terms: tuple[str, ...]) -> _Solution:
        names = (*PINHOLE, *terms, *_POSE)
        x = start = _packed(device, names)
        observed = [
            _coordinate(device, scan.axis, middle) + _block_medians(scan, device)
            for scan, middle in zip(self.scans, self.middles, strict=True)
        ]
        rows = np.concatenate(self.middles)
        shown = self._middle_of_light(device, rows)

        def residuals(x: Array) -> Array:
            try:
                tried = _unpacked(x, names, self.size)
            except CalibrationError:
                if x is start:
                    raise
                return np.full(self.blocks + 3 * (self.assumed is not None), _FAR_OFF)  # a step beyond all bounds
            parts = [
                (_coordinate(tried, scan.axis, middle) - seen) / scale
                for scan, middle, seen in zip(self.scans, self.middles, observed, strict=True)
            ]
            return np.concatenate([*parts, self._assumptions(tried, rows, shown)])

        scale = 1.0
        first = residuals(x)[: self.blocks]
        scale = max(MAD * float(np.median(np.abs(first))), 1e-4)
        found = least_squares(residuals, x, loss="huber", f_scale=_HUBER, x_scale="jac", max_nfev=200)
        off = found.fun[: self.blocks]
        weight = np.minimum(1.0, _HUBER / np.maximum(np.abs(off), 1e-9))
        s2 = float(np.sum(weight * off**2)) / max(self.blocks - len(names), 1)
        jacobian = found.jac.copy()
        jacobian[: self.blocks] /= np.sqrt(s2)  # what is assumed keeps its own standard deviation
        # Of its columns at one scale: what is hardly known must not pass for what is known exactly.
        norms = np.linalg.norm(jacobian, axis=0)
        inverse = np.linalg.pinv(jacobian / norms, rcond=1e-12) / norms[:, None]
        covariance = inverse @ inverse.T
        return _Solution(
            _unpacked(found.x, names, self.size),
            names,
            covariance,
            off * scale,
            float(np.sum(weight * (off * scale) ** 2)),
        )

    def _middle_of_light(self, device: Device, points: Array) -> tuple[float, float]:
        """Where the middle of what is lit lies along the axis that no fringes show, and how sure that is, px."""
        along = 1 if self.assumed == "rows" else 0
        seen = device.project(points)[:, along]
        span = float(np.ptp(seen))
        side = self.size[along]
        return (side - 1) / 2, max((side - span) / np.sqrt(12), 1.0)

    def _assumptions(self, device: Device, points: Array, shown: tuple[float, float]) -> Array:
        if self.assumed is None:
            return np.empty(0)
        along = 1 if self.assumed == "rows" else 0
        side = self.size[along]
        seen = device.project(points)[:, along]
        return np.array(
            [
                (device.K[1, 1] / device.K[0, 0] - 1) / _SQUARE,
                (device.K[along, 2] - (side - 1) / 2) / (side / 2),
                ((seen.max() + seen.min()) / 2 - shown[0]) / shown[1],
            ]
        )


def _block_means(scan: SeenPoints) -> Array:
    count = np.bincount(scan.block)
    return np.column_stack([np.bincount(scan.block, column) / count for column in scan.points.T])


def _block_medians(scan: SeenPoints, device: Device) -> Array:
    """(m,) median of decoded minus projected coordinate in each block."""
    off = scan.coordinate - _coordinate(device, scan.axis, scan.points)
    ordered = off[np.lexsort((off, scan.block))]
    count = np.bincount(scan.block)
    first = np.cumsum(count) - count
    return np.asarray((ordered[first + (count - 1) // 2] + ordered[first + count // 2]) / 2)


def _coordinate(device: Device, axis: Axis, points: Array) -> Array:
    turned = points @ device.R.T + device.t
    return project(turned, lens_vector(device)).pixels[:, 0 if axis == "x" else 1]


def _packed(device: Device, names: Sequence[str]) -> Array:
    values = dict(zip(INTRINSICS, lens_vector(device), strict=True))
    values |= dict(zip(_POSE, np.r_[cv2.Rodrigues(device.R)[0][:, 0], device.t], strict=True))
    return np.array([values[name] for name in names])


def _unpacked(x: Array, names: Sequence[str], size: tuple[int, int]) -> Device:
    values = dict.fromkeys(INTRINSICS, 0.0) | dict(zip(names, x, strict=True))
    K = np.array([[values["fx"], 0, values["cx"]], [0, values["fy"], values["cy"]], [0, 0, 1.0]])
    R = np.asarray(cv2.Rodrigues(np.array([values[name] for name in _POSE[:3]]))[0], float)
    try:
        terms = np.array([values[name] for name in INTRINSICS[4:]])
        return Device(*size, K, terms, R, np.array([values[name] for name in _POSE[3:]]))
    except RigError as problem:
        raise CalibrationError(
            f"found no projector that explains the scans ({problem}), expected scans of one rig"
        ) from None


def _place_sigma(found: _Solution) -> float:
    """Standard deviation of the centre of projection in its worst direction, mm."""
    jacobian = _derivatives(found, lambda device: device.centre)
    return float(np.sqrt(np.linalg.eigvalsh(jacobian @ found.covariance @ jacobian.T)[-1]))


def _assumed_sigma(found: _Solution, points: Array, assumed: str) -> float:
    """Largest standard deviation, over points (n, 3), of the coordinate along the axis that no fringes showed, px."""
    axis: Axis = "y" if assumed == "rows" else "x"
    jacobian = _derivatives(found, lambda device: _coordinate(device, axis, points))
    return float(np.sqrt(np.einsum("ij,jk,ik->i", jacobian, found.covariance, jacobian).max()))


def _derivatives(found: _Solution, function: Callable[[Device], Array]) -> Array:
    """(m, p) of a function of the projector with m values, by every parameter."""
    x, size = _packed(found.device, found.names), (found.device.width, found.device.height)
    columns = []
    for place, step in enumerate(1e-3 * np.sqrt(np.diag(found.covariance)) + 1e-12):
        ends = [x + sign * step * np.eye(len(x))[place] for sign in (1, -1)]
        up, down = (function(_unpacked(end, found.names, size)) for end in ends)
        columns.append((up - down) / (2 * step))
    return np.stack(columns, -1)
