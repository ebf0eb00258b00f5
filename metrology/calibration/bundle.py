"""Joint adjustment of cameras, projector and poses: everything that was seen, explained at once.

A board feature is a point of its pose's plane that a device projects. A projected dot is where the projector's ray of a
known pixel meets that plane, and a camera sees it there: the projector's pixel is exact and the noise is the camera's.
The board itself is taken as exact; it carries the scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from metrology.arrays import Array
from metrology.calibration.lens import INTRINSICS, left_jacobian, project, skew
from metrology.calibration.levenberg import minimise
from metrology.calibration.observations import DeviceName, Sighting
from metrology.errors import CalibrationError, RigError
from metrology.rig import Device

_POSE_TERMS = ("rx", "ry", "rz", "tx", "ty", "tz")
_ROBUST_AT = 3.0  # standard deviations at which the loss turns from square to linear
_UNDETERMINED = 1e-13  # smallest over largest eigenvalue of the scaled normal matrix: nothing but rounding


@dataclass(frozen=True)
class State:
    """Devices (in the rig frame) and poses of the board: a point p of the board is at R p + t in the rig frame."""

    devices: dict[DeviceName, Device]
    """"left" always, at the origin."""
    rotations: dict[int, Array]
    translations: dict[int, Array]
    """rotations, translations: dict of int to (3, 3) and (3,): by the pose's number in the capture."""


@dataclass(frozen=True)
class Adjusted:
    """The adjusted state."""

    state: State
    names: tuple[str, ...]
    """Of the device parameters, such as "left.fx" or "projector.tz"; lengths in mm, angles (a rotation vector) in rad.
    """
    covariance: Array
    """(p, p): of those, poses and noise level accounted for."""
    residuals: list[Array]
    """list of (n, 2): predicted minus measured pixels, one per sighting."""
    chi2: float
    """Sum of squared residuals over their variances."""
    freedom: int
    """Residuals minus parameters."""


class _Problem:
    """Lays the parameters out in one vector: the lens terms that are free, device poses, board poses."""

    def __init__(self, start: State, sightings: Sequence[Sighting], free: dict[DeviceName, Sequence[str]]) -> None:
        self.start, self.sightings = start, sightings
        self.poses = sorted({sighting.pose for sighting in sightings})
        self.lens_terms = {name: [INTRINSICS.index(term) for term in free[name]] for name in start.devices}
        self.names: list[str] = []
        self.lens_at: dict[DeviceName, int] = {}
        self.pose_at: dict[DeviceName | int, int] = {}
        for name in start.devices:
            self.lens_at[name] = len(self.names)
            self.names += [f"{name}.{INTRINSICS[k]}" for k in self.lens_terms[name]]
            if name != "left":
                self.pose_at[name] = len(self.names)
                self.names += [f"{name}.{term}" for term in _POSE_TERMS]
        self.device_parameters = len(self.names)
        for pose in self.poses:
            self.pose_at[pose] = len(self.names)
            self.names += [f"pose{pose}.{term}" for term in _POSE_TERMS]

    def pack(self) -> Array:
        x = np.zeros(len(self.names))
        for name, device in self.start.devices.items():
            terms = self.lens_terms[name]
            x[self.lens_at[name] : self.lens_at[name] + len(terms)] = lens_vector(device)[terms]
            if name != "left":
                x[self._pose(name)] = np.r_[cv2.Rodrigues(device.R)[0][:, 0], device.t]
        for pose in self.poses:
            rotation = cv2.Rodrigues(self.start.rotations[pose])[0][:, 0]
            x[self._pose(pose)] = np.r_[rotation, self.start.translations[pose]]
        return x

    def unpack(self, x: Array) -> State:
        devices = {}
        for name, device in self.start.devices.items():
            lens = self._lens(x, name)
            K = np.array([[lens[0], 0, lens[2]], [0, lens[1], lens[3]], [0, 0, 1.0]])
            rotation, t = self._motion(x, name)
            devices[name] = replace(device, K=K, distortion=lens[4:], R=rotation, t=t)
        motions = {pose: self._motion(x, pose) for pose in self.poses}
        return State(devices, {p: m[0] for p, m in motions.items()}, {p: m[1] for p, m in motions.items()})

    def _pose(self, key: DeviceName | int) -> slice:
        return slice(self.pose_at[key], self.pose_at[key] + 6)

    def _lens(self, x: Array, name: DeviceName) -> Array:
        lens = np.where(np.arange(len(INTRINSICS)) < 4, lens_vector(self.start.devices[name]), 0.0)
        terms = self.lens_terms[name]
        lens[terms] = x[self.lens_at[name] : self.lens_at[name] + len(terms)]
        return lens

    def _motion(self, x: Array, key: DeviceName | int) -> tuple[Array, Array]:
        if key == "left":
            return np.eye(3), np.zeros(3)
        motion = x[self._pose(key)]
        return np.asarray(cv2.Rodrigues(motion[:3])[0]), motion[3:]

    def residuals(self, x: Array) -> Array:
        try:
            state = self.unpack(x)
        except RigError:  # a step too far, such as to a negative focal length
            return np.full(2 * sum(len(s) for s in self.sightings), np.inf)
        whitened = [(predict(state, s) - s.pixels) / s.sigma_px for s in self.sightings]
        return np.concatenate([r.ravel() for r in whitened])

    def jacobian(self, x: Array) -> Array:
        rows = []
        projector = self.unpack(x).devices.get("projector")
        for sighting in self.sightings:
            block = np.zeros((len(sighting), 2, len(self.names)))
            if sighting.kind == "board":
                self._board_rows(x, sighting, block)
            elif projector is not None:
                self._dot_rows(x, projector, sighting, block)
            rows.append(block.reshape(-1, len(self.names)) / sighting.sigma_px)
        return np.concatenate(rows)

    def _board_rows(self, x: Array, sighting: Sighting, block: Array) -> None:
        rotation, t = self._motion(x, sighting.pose)
        turned = sighting.known @ rotation[:, :2].T
        by_point = self._device_rows(x, sighting.device, turned + t, block)
        left = left_jacobian(x[self._pose(sighting.pose)][:3])
        block[..., self._pose(sighting.pose)] += np.concatenate([-by_point @ skew(turned) @ left, by_point], -1)

    def _dot_rows(self, x: Array, projector: Device, sighting: Sighting, block: Array) -> None:
        """The point X on the plane follows from F = (projector(X) − p, n·(X − t)) = 0, so dX = −F_X⁻¹ dF."""
        rotation, t = self._motion(x, sighting.pose)
        points = on_plane(projector, sighting.known, rotation, t)
        emitted = np.zeros((len(sighting), 2, len(self.names)))
        projector_by_point = self._device_rows(x, "projector", points, emitted)
        normal = rotation[:, 2]
        constraint = np.zeros((len(sighting), 3, len(self.names)))
        constraint[:, :2] = emitted
        left = left_jacobian(x[self._pose(sighting.pose)][:3])
        constraint[:, 2, self._pose(sighting.pose)] = np.concatenate(
            [-(points - t) @ skew(normal) @ left, np.broadcast_to(-normal, points.shape)], -1
        )
        by_x = np.concatenate([projector_by_point, np.broadcast_to(normal, (len(points), 1, 3))], 1)
        lens = np.arange(len(self.lens_terms["projector"])) + self.lens_at["projector"]
        columns = np.concatenate([lens, *(np.arange(6) + self.pose_at[key] for key in ("projector", sighting.pose))])
        moved = -np.linalg.solve(by_x, constraint[..., columns])
        by_point = self._device_rows(x, sighting.device, points, block)
        block[..., columns] += by_point @ moved

    def _device_rows(self, x: Array, name: DeviceName, points: Array, block: Array) -> Array:
        """Fill in the device's own columns; (n, 2, 3) derivative by the point in the rig frame."""
        rotation, t = self._motion(x, name)
        turned = points @ rotation.T
        projected = project(turned + t, self._lens(x, name))
        terms = self.lens_terms[name]
        at = self.lens_at[name]
        block[..., at : at + len(terms)] += projected.by_lens[..., terms]
        if name != "left":
            left = left_jacobian(x[self._pose(name)][:3])
            block[..., self._pose(name)] += np.concatenate(
                [-projected.by_point @ skew(turned) @ left, projected.by_point], -1
            )
        return np.asarray(projected.by_point @ rotation)


def lens_vector(device: Device) -> Array:
    """(9,) INTRINSICS of a device without rational terms."""
    return np.r_[device.K[0, 0], device.K[1, 1], device.K[0, 2], device.K[1, 2], device.lens[:5]]


def on_plane(projector: Device, pixels: Array, rotation: Array, translation: Array) -> Array:
    """(n, 3) points, rig frame, where a device's rays of pixels (n, 2) meet the plane of a board's pose."""
    rays = projector.rays(pixels)
    normal = rotation[:, 2]
    reach = (normal @ (translation - projector.centre)) / (rays @ normal)
    return np.asarray(projector.centre + reach[:, None] * rays)


def predict(state: State, sighting: Sighting, known: Array | None = None) -> Array:
    """(n, 2) pixels at which a device should see a sighting's features, or other points `known` of the same kind."""
    known = sighting.known if known is None else known
    rotation, translation = state.rotations[sighting.pose], state.translations[sighting.pose]
    if sighting.kind == "board":
        points = known @ rotation[:, :2].T + translation
    else:
        points = on_plane(state.devices["projector"], known, rotation, translation)
    return state.devices[sighting.device].project(points)


def adjust(
    start: State,
    sightings: Sequence[Sighting],
    free: dict[DeviceName, Sequence[str]],
    robust: bool = True,
) -> Adjusted:
    """Least squares over all devices and poses.

    Parameters
    ----------
    start : State
        Near the solution.
    free : dict of str to sequence of str
        The lens terms (INTRINSICS) to estimate for each device; focal lengths and principal point not named stay, other
        terms not named are zero.
    robust : bool
        Huber's loss from three standard deviations on; without, plain squares.
    """
    problem = _Problem(start, sightings, free)
    count = 2 * sum(len(s) for s in sightings)
    if count <= len(problem.names):
        raise CalibrationError(f"found {count} measured coordinates, expected more than {len(problem.names)} unknowns")
    x = minimise(problem.residuals, problem.jacobian, problem.pack(), _ROBUST_AT if robust else None)
    state = problem.unpack(x)
    residuals = problem.residuals(x)
    chi2, freedom = float(residuals @ residuals), count - len(problem.names)
    jacobian = problem.jacobian(x)
    size = np.linalg.norm(jacobian, axis=0)
    if not (size > 0).all():
        raise CalibrationError(f"{problem.names[int(np.argmin(size))]}: found nothing that depends on it")
    values, vectors = np.linalg.eigh((jacobian / size).T @ (jacobian / size))
    if values[0] < _UNDETERMINED * values[-1]:
        raise CalibrationError("the poses leave a parameter undetermined, expected boards tilted in different ways")
    covariance = (vectors / values) @ vectors.T / np.outer(size, size) * (chi2 / freedom)
    n = problem.device_parameters
    split = np.split(residuals.reshape(-1, 2), np.cumsum([len(s) for s in sightings])[:-1])
    unscaled = [part * s.sigma_px for part, s in zip(split, sightings, strict=True)]
    return Adjusted(state, tuple(problem.names[:n]), covariance[:n, :n], unscaled, chi2, freedom)
