"""The rig: one or two cameras and mostly a projector, pinhole devices with distortion in the left camera's frame.

Frame: the left camera's, millimetres, x right, y down, z forward; `x_dev = R x_left + t`. Pixels are raw (distorted)
with centres at integers, as in OpenCV.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrology.arrays import Array
from metrology.errors import RigError

# Radial and tangential terms, the rational denominator, and a thin prism's; OpenCV's tilt terms are refused.
MAX_DISTORTION_TERMS = 12
_TERMS = (0, 4, 5, 8, 12)
# Keys of a rig's `extra`: whose projector was taken over, and how one was fitted to scans.
PROJECTOR_OF, PROJECTOR_FIT = "projector_of", "projector_fit"
_LARGEST = 1e12  # beyond any pixel or millimetre, and far from overflowing
_ROTATION_TOLERANCE = 1.1e-5
_FEW, _AT_ONCE = 300, 8192  # points: OpenCV is quicker for few; of many as many as stay near the processor
_UNDISTORT_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)


@dataclass(frozen=True)
class Device:
    """A camera, or a projector seen as a camera that emits."""

    width: int
    height: int
    """width, height: size in pixels."""
    K: Array
    """(3, 3): intrinsic matrix in pixels."""
    distortion: Array
    """(n,): k1, k2, p1, p2, k3 … in OpenCV's order, n in {0, 4, 5, 8, 12}."""
    R: Array
    t: Array
    """R, t: (3, 3) and (3,): pose: a point x of the rig frame is at R x + t in the device's own frame, t in mm."""

    def __post_init__(self) -> None:
        for name, shape in (("K", (3, 3)), ("R", (3, 3)), ("t", (3,))):
            value = np.ascontiguousarray(getattr(self, name), float)
            if value.shape != shape:
                raise RigError(f"{name}: found shape {value.shape}, expected {shape}")
            object.__setattr__(self, name, value)
        object.__setattr__(self, "distortion", np.ascontiguousarray(self.distortion, float).ravel())
        if self.distortion.size not in _TERMS:
            raise RigError(f"distortion: found {self.distortion.size} terms, expected 0, 4, 5, 8 or 12")
        if not all(np.isfinite(getattr(self, n)).all() for n in ("K", "distortion", "R", "t")):
            raise RigError("found a value that is not finite, expected numbers throughout K, distortion, R and t")
        if (largest := max(np.abs(getattr(self, n)).max(initial=0) for n in ("K", "distortion", "R", "t"))) > _LARGEST:
            raise RigError(f"found the value {largest:g}, expected pixels and millimetres")
        if self.width <= 0 or self.height <= 0:
            raise RigError(f"size: found {self.width}×{self.height}, expected positive numbers of pixels")
        if self.K[0, 0] <= 0 or self.K[1, 1] <= 0:
            raise RigError(f"K: found focal lengths {self.K[0, 0]:g}, {self.K[1, 1]:g}, expected positive ones")
        self._check_rotation()

    def _check_rotation(self) -> None:
        """Orthonormal rows, and a right hand remains one."""
        with np.errstate(over="ignore", invalid="ignore"):
            off = float(np.abs(self.R @ self.R.T - np.eye(3)).max())
            determinant = float(np.linalg.det(self.R))
        if not off <= _ROTATION_TOLERANCE:
            what = f"rows that are off orthonormal by {off:.2g}"
        elif determinant < 0:
            what = "a mirror: an axis has the other sign"
        else:
            return
        raise RigError(
            f"R: found a matrix that is not a rotation ({what}), expected orthonormal rows and determinant +1"
        )

    @cached_property
    def centre(self) -> Array:
        """(3,) centre of projection in the rig frame, mm."""
        return -self.R.T @ self.t

    @cached_property
    def lens(self) -> Array:
        """(12,) distortion padded with zeros: k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4."""
        padded = np.zeros(MAX_DISTORTION_TERMS)
        padded[: self.distortion.size] = self.distortion
        return padded

    @cached_property
    def _turn(self) -> Array:
        """(3, 1) R as OpenCV wants it: a vector along its axis."""
        return np.asarray(cv2.Rodrigues(self.R)[0], float)

    @cached_property
    def _rotation(self) -> Array:
        """(3, 3) the rotation nearest to R, which may be off by the rounding of the file that it came from."""
        return np.asarray(cv2.Rodrigues(self._turn)[0], float)

    def project(self, points: ArrayLike) -> Array:
        """Raw pixels of points: R x + t into the device's frame (for the projector paper eq 14), then through the lens.

        Parameters
        ----------
        points : (..., 3) array
            Rig frame, mm.

        Returns
        -------
        (..., 2) ndarray
            u, v in pixels.
        """
        points = np.asarray(points, float)
        flat = points.reshape(-1, 3)
        if len(flat) < _FEW:
            return self._project_few(flat).reshape(*points.shape[:-1], 2)
        pixels = np.empty((len(flat), 2))
        for first in range(0, len(flat), _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            pixels[some] = self._project_many(flat[some])
        return pixels.reshape(*points.shape[:-1], 2)

    def _project_few(self, points: Array) -> Array:
        """OpenCV's own, which works out derivatives with each pixel: many points take it thirty times as long."""
        if not len(points):
            return np.empty((0, 2))
        pixels, _ = cv2.projectPoints(points.reshape(-1, 1, 3), self._turn, self.t, self.K, self.lens)
        return np.asarray(pixels, float).reshape(-1, 2)

    def _project_many(self, points: Array) -> Array:
        """The same model, all points at a time."""
        with np.errstate(all="ignore"):  # a point that is nowhere near the image may have no number
            x, y, z = self._rotation @ points.T + self.t[:, None]
            z = np.where(z == 0, 1.0, z)  # as OpenCV has it
            return self.through_lens(x / z, y / z)

    def through_lens(self, x: Array, y: Array) -> Array:
        """(..., 2) raw pixels of undistorted image coordinates x/z, y/z in the device's own frame."""
        k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = self.lens.tolist()
        xx, yy, xy = x * x, y * y, 2 * x * y
        r2 = xx + yy
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        if k4 or k5 or k6:
            radial /= 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
        xd = x * radial + p1 * xy + p2 * (r2 + 2 * xx)
        yd = y * radial + p1 * (r2 + 2 * yy) + p2 * xy
        if s1 or s2 or s3 or s4:
            xd, yd = xd + r2 * (s1 + r2 * s2), yd + r2 * (s3 + r2 * s4)
        u, v = self.K[0, 0] * xd + self.K[0, 2], self.K[1, 1] * yd + self.K[1, 2]
        return np.stack([u, v], axis=-1)

    def normalized(self, pixels: ArrayLike) -> Array:
        """Undistorted image coordinates x/z, y/z in the device's own frame, (..., 2), of raw pixels (..., 2)."""
        pixels = np.asarray(pixels, float)
        if pixels.size == 0:
            return np.empty(pixels.shape)
        flat = np.ascontiguousarray(pixels.reshape(-1, 1, 2))
        undistorted = cv2.undistortPoints(flat, self.K, self.lens, criteria=_UNDISTORT_CRITERIA)
        return np.asarray(undistorted, float).reshape(pixels.shape)

    def rays(self, pixels: ArrayLike) -> Array:
        """Unit viewing directions, (..., 3) in the rig frame, of raw pixels (..., 2)."""
        xy = self.normalized(pixels)
        rays = np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1) @ self.R
        return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))

    def inside(self, pixels: ArrayLike) -> NDArray[np.bool_]:
        """Whether raw pixels (..., 2) lie on the image."""
        u, v = np.moveaxis(np.asarray(pixels, float), -1, 0)
        return (u >= -0.5) & (u < self.width - 0.5) & (v >= -0.5) & (v < self.height - 0.5)


@dataclass(frozen=True)
class Rig:
    """Two cameras and a projector with the id of the calibration they came from.

    The projector is None where it is not calibrated: two cameras measure without it. The right camera is None where
    there is but one: it measures with the projector, or another scanner's cloud lies on its pixels. `extra` holds what
    else a rig file said (residuals, covariance …), untouched.
    """

    id: str
    calibrated_at: str
    left: Device
    right: Device | None = None
    projector: Device | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not (np.allclose(self.left.R, np.eye(3), atol=1e-9) and np.allclose(self.left.t, 0, atol=1e-9)):
            raise RigError(
                "left camera: found a pose of its own, expected identity (the rig frame is the left camera's)"
            )
        if self.right is not None and np.linalg.norm(self.right.centre) < 1e-6:
            raise RigError("right camera: found no baseline to the left one, expected different centres")

    def with_right(self) -> Device:
        """The right camera; RigError where there is none."""
        if self.right is None:
            raise RigError(f"rig {self.id!r}: found one camera, expected two")
        return self.right

    def with_projector(self) -> Device:
        """The projector; RigError where none is calibrated."""
        if self.projector is None:
            raise RigError(f"rig {self.id!r}: found no calibrated projector, expected one calibrated with the cameras")
        return self.projector

    @property
    def screen(self) -> Device | None:
        """The projector where both its columns and its rows are calibrated: marks can be drawn for it."""
        fit = self.extra.get(PROJECTOR_FIT)
        return None if isinstance(fit, Mapping) and fit.get("assumed") else self.projector

    @property
    def cameras(self) -> dict[str, Device]:
        """The cameras that there are, of left and right, in this order."""
        return {name: device for name, device in self.devices.items() if name != "projector"}

    @property
    def devices(self) -> dict[str, Device]:
        """The devices that there are, of left, right and projector, in this order."""
        devices = {"left": self.left, "right": self.right, "projector": self.projector}
        return {name: device for name, device in devices.items() if device is not None}
