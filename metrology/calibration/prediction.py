"""What a calibration's covariance means for the measurements: heights, positions, overlay, check of its health."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from metrology.arrays import Array
from metrology.calibration.bundle import Adjusted, lens_vector
from metrology.calibration.lens import INTRINSICS
from metrology.calibration.observations import DeviceName
from metrology.rig import Device
from metrology.texture_offset import epipolar_directions

Devices = Mapping[DeviceName, Device]

_GRID = (9, 7)  # columns and rows of places over the left image
_MARGIN = 0.06  # of the image left free around them
_HEAD_RADIUS_MM = 4.0
_HEAD_HEIGHT_MM = 0.5
_RING = (1.4, 2.0)  # radii of the skin around, over the head's
_STEPS = 1e-3  # of a parameter's standard deviation: small enough to be linear
_COVERAGE = 2.0  # standard deviations of a 95 % interval


@dataclass(frozen=True)
class FieldUncertainty:
    """Uncertainty (95 %) that the calibration alone gives a measurement, over the field at one distance."""

    distance_mm: float
    """z of the plane looked at, square to the left camera."""
    left_px: Array
    """(rows, cols, 2)."""
    height_u95_mm: Array
    """(rows, cols): of a head of 8 mm diameter standing 0.5 mm proud."""
    depth_u95_mm: Array
    """(rows, cols): of a point's z in the rig frame."""
    overlay_u95_mm: Array
    """(rows, cols): of where the projector puts a mark for a measured point, on the skin, along the worse direction of
    the two."""
    epipolar_sigma_px: float
    projector_sigma_px: float
    """epipolar_sigma_px, projector_sigma_px: root mean square over the field of what the rig's health check would see
    if nothing but calibration noise were wrong: distance from the epipolar line in the right image, and projector
    column."""


def field_uncertainty(adjusted: Adjusted) -> FieldUncertainty | None:
    """Propagate the covariance linearly; None without a right camera and a projector."""
    devices = adjusted.state.devices
    if "right" not in devices or "projector" not in devices:
        return None
    distance = float(np.median([t[2] for t in adjusted.state.translations.values()]))
    pixels = _places(devices["left"])
    flat = pixels.reshape(-1, 2)
    rays = devices["left"].rays(flat)
    points = rays * (distance / rays[:, 2])[:, None]
    spread = _Spread(adjusted)

    depth = spread.covariance(_depths(devices, points))
    height = spread.covariance(_heights(devices, points))
    epipolar = spread.covariance(_epipolar(devices, points))
    overlay = spread.covariance(_overlay(devices, points))
    mm_per_px = np.linalg.norm(points - devices["projector"].centre, axis=1) / devices["projector"].K[0, 0]
    worse = np.sqrt(np.linalg.eigvalsh(_blocks(overlay, 2))[:, -1]) * mm_per_px

    def u95(covariance: Array) -> Array:
        return _COVERAGE * np.sqrt(np.diag(covariance)).reshape(pixels.shape[:2])

    return FieldUncertainty(
        distance,
        pixels,
        u95(height),
        u95(depth),
        _COVERAGE * worse.reshape(pixels.shape[:2]),
        float(np.sqrt(np.mean(np.diag(epipolar)))),
        float(np.sqrt(np.mean(np.diag(overlay)[::2]))),
    )


def _places(left: Device) -> Array:
    u = np.linspace(_MARGIN, 1 - _MARGIN, _GRID[0]) * (left.width - 1)
    v = np.linspace(_MARGIN, 1 - _MARGIN, _GRID[1]) * (left.height - 1)
    return np.stack(np.meshgrid(u, v), -1)


class _Spread:
    """Numerical derivatives of functions of the devices along every parameter."""

    def __init__(self, adjusted: Adjusted) -> None:
        self.nominal = adjusted.state.devices
        self.root = np.linalg.cholesky(_positive(adjusted.covariance))
        # One column of the covariance's root at a time: its derivatives squared and summed are the covariance.
        self.moved = [
            (
                _moved(self.nominal, adjusted.names, +_STEPS * column),
                _moved(self.nominal, adjusted.names, -_STEPS * column),
            )
            for column in self.root.T
        ]

    def covariance(self, function: Callable[[Devices], Array]) -> Array:
        """(m, m) of a function with m values."""
        columns = [(function(up) - function(down)) / (2 * _STEPS) for up, down in self.moved]
        jacobian = np.stack(columns, -1).reshape(-1, len(columns))
        return jacobian @ jacobian.T


def _positive(covariance: Array) -> Array:
    """The matrix with rounding errors that make it indefinite removed."""
    size = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    lifted = (vectors * np.maximum(values, 1e-12)) @ vectors.T
    return np.asarray(lifted * np.outer(size, size))


def _moved(devices: Devices, names: tuple[str, ...], change: Array) -> dict[DeviceName, Device]:
    moved = {}
    for name, device in devices.items():
        lens = lens_vector(device)
        motion = np.r_[cv2.Rodrigues(device.R)[0][:, 0], device.t]
        for parameter, step in zip(names, change, strict=True):
            owner, term = parameter.split(".")
            if owner != name:
                continue
            if term in INTRINSICS:
                lens[INTRINSICS.index(term)] += step
            else:
                motion[("rx", "ry", "rz", "tx", "ty", "tz").index(term)] += step
        K = np.array([[lens[0], 0, lens[2]], [0, lens[1], lens[3]], [0, 0, 1.0]])
        R = np.asarray(cv2.Rodrigues(motion[:3])[0], float)
        moved[name] = replace(device, K=K, distortion=lens[4:], R=R, t=motion[3:])
    return moved


def _triangulator(devices: Devices, points: Array) -> Callable[[Devices], Array]:
    """Points (n, 3) that other devices make of the pixels at which these devices see `points`."""
    left_px, right_px = devices["left"].project(points), devices["right"].project(points)

    def triangulate(changed: Devices) -> Array:
        left, right = changed["left"].rays(left_px), changed["right"].rays(right_px)
        base = changed["right"].centre
        cosine = np.sum(left * right, axis=1)
        reach = (left @ base - cosine * (right @ base)) / (1 - cosine**2)
        return np.asarray(left * reach[:, None])

    return triangulate


def _depths(devices: Devices, points: Array) -> Callable[[Devices], Array]:
    triangulate = _triangulator(devices, points)
    return lambda changed: triangulate(changed)[:, 2]


def _overlay(devices: Devices, points: Array) -> Callable[[Devices], Array]:
    triangulate = _triangulator(devices, points)
    return lambda changed: changed["projector"].project(triangulate(changed))


def _heights(devices: Devices, points: Array) -> Callable[[Devices], Array]:
    """Head's mean distance to the plane through the ring of skin around it."""
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle]) * _HEAD_RADIUS_MM
    head = points[:, None] + 0.6 * circle + [0, 0, -_HEAD_HEIGHT_MM]
    ring = np.concatenate([points[:, None] + part * circle for part in _RING], 1)
    triangulate = _triangulator(devices, np.concatenate([head, ring], 1).reshape(-1, 3))
    head_points = head.shape[1]

    def heights(changed: Devices) -> Array:
        seen = triangulate(changed).reshape(len(points), -1, 3)
        head_seen, ring_seen = seen[:, :head_points].mean(1), seen[:, head_points:]
        middle = ring_seen.mean(1)
        _, _, axes = np.linalg.svd(ring_seen - middle[:, None], full_matrices=False)
        normal = axes[:, 2] * np.where(axes[:, 2, 2:] > 0, -1.0, 1.0)
        return np.sum((head_seen - middle) * normal, axis=1)

    return heights


def _epipolar(devices: Devices, points: Array) -> Callable[[Devices], Array]:
    left_px, right_px = devices["left"].project(points), devices["right"].project(points)
    depth = points[:, 2]
    direction = epipolar_directions(devices["left"], devices["right"], left_px, depth)
    across = np.stack([-direction[:, 1], direction[:, 0]], -1)

    def off(changed: Devices) -> Array:
        rays = changed["left"].rays(left_px)
        on_line = changed["right"].project(rays * (depth / rays[:, 2])[:, None])
        return np.sum((right_px - on_line) * across, axis=1)

    return off


def _blocks(covariance: Array, size: int) -> Array:
    """(n, size, size) diagonal blocks."""
    n = len(covariance) // size
    return covariance.reshape(n, size, n, size)[np.arange(n), :, np.arange(n)]
