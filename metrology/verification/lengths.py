"""Lengths in one scan of anything whose sizes are published: between points, spheres, faces, or features of a board."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.calibration.board import Board
from metrology.calibration.detect_board import BoardView
from metrology.cloud import Reconstruction
from metrology.errors import SceneError
from metrology.robust import MAD
from metrology.verification.board_lengths import ends, fitted_pose
from metrology.verification.form import inflation
from metrology.verification.spheres import SphereFit, distance_u95, find_spheres, fit_sphere

_WINDOW_PX = 4  # to either side of a point
_LEAST_POINTS = 20
_SHARED = 9  # neighbours within a matching window share their noise
_ROUNDS = 5
_OUTLIER = 3.0
_MOST_SPHERES = 12
_ABOUT = 0.25  # of a sphere's stated diameter: parts of a wall or of a bend fit spheres of any other size
_SMOOTHED = 25.0  # px²/diameter: what windows of five pixels and a lens's blur take off a sphere that is seen up to 60°
_MISPLACED = 5.0  # robust standard deviations: a corner half out of focus or in a reflection


@dataclass(frozen=True)
class Length:
    """What was measured, with U95 of its points' noise; what the rig's scale does to it is not in that."""

    name: str
    value: float
    u95: float
    unit: str = "mm"
    nominal: float | None = None
    """Where the thing itself states it, as a board does."""


def point_lengths(cloud: Reconstruction, pixels: Sequence[tuple[float, float]]) -> list[Length]:
    """Distances between the surface points that the left camera sees at pixels (u, v), from each to the next."""
    places = [_surface_point(cloud, pixel) for pixel in pixels]
    found = []
    for number, ((a, sigma_a), (b, sigma_b)) in enumerate(pairwise(places), start=1):
        length = float(np.linalg.norm(b - a))
        along = (b - a) / max(length, 1e-12)
        u95 = 2 * float(np.hypot(sigma_a * abs(along @ _ray(a)), sigma_b * abs(along @ _ray(b))))
        found.append(Length(f"point {number} to point {number + 1}", length, u95))
    return found


def sphere_lengths(cloud: Reconstruction, diameter_mm: float) -> list[Length]:
    """Diameters of the spheres of about one diameter, from left to right, and the distances of their centres.

    Windows smooth what bends, so that spheres of few pixels come out too small: that is in the diameters' U95. Centres
    stay where they are.
    """
    points = cloud.points.astype(float)
    near = find_spheres(points, diameter_mm / 2, _MOST_SPHERES)
    fits = [fit_sphere(points, cloud.sigma_z.astype(float), centre, diameter_mm / 2) for centre in near]
    spheres = sorted((fit for fit in fits if fit and _is_about(fit, diameter_mm)), key=lambda fit: float(fit.centre[0]))
    if not spheres:
        raise SceneError(f"found no sphere of {diameter_mm:g} mm, expected one or more of a thousand points each")
    found = [
        Length(f"diameter of sphere {number}", one.diameter_mm, _diameter_u95(cloud, one), nominal=diameter_mm)
        for number, one in enumerate(spheres, start=1)
    ]
    for number, (one, other) in enumerate(pairwise(spheres), start=1):
        found.append(Length(f"centre {number} to centre {number + 1}", *distance_u95(one, other)))
    return found


def _is_about(fit: SphereFit, diameter_mm: float) -> bool:
    return abs(fit.diameter_mm / diameter_mm - 1) < _ABOUT and fit.diameter_u95_mm < _ABOUT * diameter_mm


def _diameter_u95(cloud: Reconstruction, fit: SphereFit) -> float:
    pixel = float(fit.centre[2]) / cloud.rig.left.K[0, 0]
    return float(np.hypot(fit.diameter_u95_mm, _SMOOTHED * pixel**2 / fit.diameter_mm))


def face_lengths(cloud: Reconstruction, boxes: Sequence[tuple[int, int, int, int]]) -> list[Length]:
    """Steps and angles between faces, from each to the next; a face is seen in a box (u, v, width, height) of the left
    image, and its step is how far its middle lies from the plane of the face before, + towards the camera.
    """
    faces = [_face(cloud, box) for box in boxes]
    found = []
    for number, (one, other) in enumerate(pairwise(faces), start=1):
        step = float((other.middle - one.middle) @ one.normal)
        names = f"face {number} to face {number + 1}"
        found.append(Length(f"step, {names}", step, 2 * float(np.hypot(one.sigma_at(other.middle), other.sigma))))
        angle = float(np.degrees(np.arccos(np.clip(one.normal @ other.normal, -1, 1))))
        found.append(Length(f"angle, {names}", angle, 2 * float(np.hypot(one.tilt, other.tilt)), "°"))
    return found


def board_in_scan(cloud: Reconstruction, board: Board, seen: BoardView) -> list[Length]:
    """Longest lines on a board, its scale against what it states (%), and how flat its points are.

    A feature is where its pixel's ray meets the plane through the board's points; of discs the middles of their images
    count, whose eccentricity is less than what a scan tells. Features far off the others are left out.
    """
    known, pixels = board.points[seen.index], seen.pixels
    inside = np.zeros(cloud.valid.shape, np.uint8)
    outline = cv2.convexHull(seen.pixels.astype(np.float32))
    cv2.fillConvexPoly(inside, np.rint(outline).astype(np.int32), 1)
    plane = _plane_of(cloud, inside > 0, "the board")
    rays = cloud.rig.left.rays(pixels)
    points = rays * ((plane.normal @ plane.middle) / (rays @ plane.normal))[:, None]
    scale, sigma, residual = _scale(known, points)
    good = residual <= _MISPLACED * MAD * float(np.median(residual)) + 1e-9
    if not good.all():
        known, points = known[good], points[good]
        scale, sigma, _ = _scale(known, points)
    centred = known - known.mean(0)
    found = []
    for name, (i, j) in ends(known).items():
        measured, nominal = (float(np.linalg.norm(of[j] - of[i])) for of in (points, known))
        found.append(Length(f"longest {name}", measured, 2 * np.sqrt(2) * sigma, nominal=nominal))
    found.append(Length("scale", 100 * (scale - 1), 200 * sigma / float(np.sqrt((centred**2).sum())), "%"))
    found.append(Length("points about their plane", plane.scatter, 0.0))
    return found


def _scale(known: Array, points: Array) -> tuple[float, float, Array]:
    """Scale of points against known ones, the standard deviation of a coordinate, and (n,) distances left, mm."""
    R, t = fitted_pose(known, points)
    off, centred = (points - t) @ R, known - known.mean(0)
    off = off - off.mean(0)
    scale = float(off.ravel() @ centred.ravel() / (centred**2).sum())
    residual = (off - scale * centred)[:, :2]
    sigma = float(np.sqrt((residual**2).sum() / max(2 * len(known) - 4, 1)))
    return scale, sigma, np.asarray(np.linalg.norm(residual, axis=1))


@dataclass(frozen=True)
class _Plane:
    """A plane through the points of a part of the picture."""

    middle: Array
    normal: Array
    """middle, normal: (3,), mm; the normal points towards the camera."""
    scatter: float
    covariance: Array
    """(3, 3): of its distance at the middle, mm², and of its slopes along `axes`."""
    axes: Array
    """(2, 3): two directions in it."""

    @property
    def sigma(self) -> float:
        """Standard deviation of its distance at the middle, mm."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def tilt(self) -> float:
        """Standard deviation of its direction, degrees."""
        return float(np.degrees(np.sqrt(np.trace(self.covariance[1:, 1:]))))

    def sigma_at(self, point: Array) -> float:
        """Standard deviation of its distance at another place, mm."""
        g = np.array([1.0, *(self.axes @ (point - self.middle))])
        return float(np.sqrt(g @ self.covariance @ g))


def _ray(point: Array) -> Array:
    return np.asarray(point / np.linalg.norm(point))


def _surface_point(cloud: Reconstruction, pixel: tuple[float, float]) -> tuple[Array, float]:
    """Where a pixel's ray meets the plane through the points about it, and the standard deviation along the ray."""
    u, v = (round(part) for part in pixel)
    around = np.zeros(cloud.valid.shape, bool)
    _check_inside(cloud, u, v, 1, 1, f"pixel {pixel[0]:g},{pixel[1]:g}")
    around[max(v - _WINDOW_PX, 0) : v + _WINDOW_PX + 1, max(u - _WINDOW_PX, 0) : u + _WINDOW_PX + 1] = True
    plane = _plane_of(cloud, around, f"pixel {pixel[0]:g},{pixel[1]:g}", shared=_SHARED)
    ray = cloud.rig.left.rays(np.array([pixel], float))[0]
    return ray * ((plane.normal @ plane.middle) / (ray @ plane.normal)), plane.sigma / abs(
        float(_ray(ray) @ plane.normal)
    )


def _face(cloud: Reconstruction, box: tuple[int, int, int, int]) -> _Plane:
    u, v, width, height = box
    inside = np.zeros(cloud.valid.shape, bool)
    name = f"the box {u},{v},{width},{height}"
    _check_inside(cloud, u, v, width, height, name)
    inside[v : v + height, u : u + width] = True
    return _plane_of(cloud, inside, name)


def _check_inside(cloud: Reconstruction, u: int, v: int, width: int, height: int, name: str) -> None:
    rows, columns = cloud.valid.shape
    if min(u, v) < 0 or min(width, height) < 1 or u + width > columns or v + height > rows:
        raise SceneError(f"found {name}, expected a place in the left image of {columns}×{rows} pixels")


def _plane_of(cloud: Reconstruction, inside: NDArray[np.bool_], name: str, shared: float | None = None) -> _Plane:
    """The least-squares plane through a part's points, those far off left out.

    `shared` is by how much common noise raises the variance of a mean, where the points are too few to tell.
    """
    used = inside & cloud.valid
    for last in (*[False] * (_ROUNDS - 1), True):
        points = cloud.points[used].astype(float)
        if len(points) < _LEAST_POINTS:
            raise SceneError(
                f"found {len(points)} points at {name}, expected {_LEAST_POINTS} or more: nothing to measure"
            )
        middle = points.mean(0)
        *axes, normal = np.linalg.svd(points - middle, full_matrices=False)[2]
        off = (points - middle) @ normal
        scatter = MAD * float(np.median(np.abs(off)))
        keep = np.abs(off) <= _OUTLIER * scatter + 1e-9
        if last or keep.all():
            break
        used[used] = keep
    normal = normal if normal @ middle < 0 else -normal
    if shared is None:
        image = np.full(used.shape, np.nan)
        image[used] = off
        shared = inflation(image)
    rows = np.column_stack([np.ones(len(points)), (points - middle) @ np.array(axes).T])
    covariance = shared * float(off.var()) * np.linalg.inv(rows.T @ rows)
    return _Plane(middle, normal, scatter, covariance, np.array(axes))
