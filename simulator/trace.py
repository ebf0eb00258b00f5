"""What each pixel of a camera sees: points of the panel, where the projector's light comes from, and how bright.

Each pixel gathers samples spread like its point-spread function, so that pixels astride an edge mix what lies on both
sides as a lens does: few samples where the surface is smooth, many near borders of any kind.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from metrology.arrays import Float32
from metrology.rig import Device
from simulator.cast import MAX_BORDERS, cast, lit
from simulator.compiled import entry, kernel
from simulator.lens import pack_device, pixel, ray
from simulator.overlay import D_SHARP, near_dent
from simulator.relief import (
    BACKGROUND,
    F_X_MIN,
    F_Y_MIN,
    R_CONE,
    R_IS_HOLE,
    R_OUTER,
    R_RADIUS,
    R_SLOT_WIDTH,
    S_CHAMFER,
    WIDTH,
    Floats,
    Relief,
    beside_border,
    cell_of,
    circle,
    coat_at,
    lateral,
    table,
)  # fmt: skip
from simulator.shading import OFF, Light, reflectance_at, shade

_BAND = 32  # rows per piece of work


class ReflectanceMap(NamedTuple):
    """Reflectance painted on the panel's x-y plane: (rows, columns) values, origin x, y and texel size in mm."""

    values: Float32
    origin: Floats
    texel_mm: float


@dataclass(frozen=True)
class Hits:
    """What a camera's pixels see, independent of the image that is projected.

    Pixel i (row-major) owns the samples first[i] … first[i+1]−1, all of equal weight.
    """

    height: int
    width: int
    first: NDArray[np.int64]
    """(height·width + 1,) int64."""
    column: Floats
    row: Floats
    """column, row: (n,) float64: projector coordinates of the sample, centres at integers."""
    direct: Float32
    """(n,) float32: grey levels at exposure 1 under full projector light; 0 in shadow."""
    ambient: Float32
    """(n,) float32: grey levels at exposure 1 of the ambient light."""


@kernel
def _near_edge(relief, x, y, tolerance):  # type: ignore[no-untyped-def]
    """Whether a border lies within `tolerance` mm of (x, y)."""
    if beside_border(relief, x, y):
        for k in range(2):
            if abs(x - relief.frame[F_X_MIN + k]) < tolerance or abs(y - relief.frame[F_Y_MIN + k]) < tolerance:
                return True
    for k in range(relief.dents.shape[0]):
        if relief.dents[k, D_SHARP] > 0.0 and near_dent(relief.dents, k, x, y):
            return True
    if relief.coat.shape[0] > 0:
        low, high = coat_at(relief, x - tolerance, y - tolerance), coat_at(relief, x + tolerance, y + tolerance)
        left, right = coat_at(relief, x - tolerance, y + tolerance), coat_at(relief, x + tolerance, y - tolerance)
        if max(low, high, left, right) - min(low, high, left, right) > 1e-3:
            return True
    row, column = cell_of(relief, x, y)
    if row < 0:
        return False
    for k in range(relief.cells.shape[2] - 1):
        r = relief.cells[row, column, k]
        if r < 0:
            break
        rivet = relief.rivets[r]
        if abs(math.sqrt(circle(rivet, False, x, y)) - rivet[R_OUTER]) < tolerance:
            return True
        if rivet[R_CONE] > 0.0 and circle(rivet, False, x, y) < rivet[R_OUTER] ** 2:
            return True
        if rivet[R_IS_HOLE] == 0.0:
            rho = math.sqrt(circle(rivet, True, x, y))
            if abs(rho - rivet[R_RADIUS]) < tolerance:
                return True
            if rivet[R_SLOT_WIDTH] > 0.0 and rho < rivet[R_RADIUS]:
                return True
    if relief.cells[row, column, -1] > 0:
        for s in range(relief.seams.shape[0]):
            t, xi = lateral(relief, s, x, y)
            edge = 0.5 * table(relief, s, WIDTH, xi)[0]
            if abs(abs(t) - edge) < tolerance or abs(abs(t) - edge - relief.seams[s, S_CHAMFER]) < tolerance:
                return True
    return False


@entry
def _look(relief, camera, centre, source, tolerance, borders, d, p, top, codes, distances, near):  # type: ignore[no-untyped-def]
    """One ray per pixel: which piece it meets how far away, lit or not, and whether a border is near."""
    for i in range(codes.shape[0]):
        for j in range(codes.shape[1]):
            ray(camera, float(j), float(top + i), d)
            hit = cast(relief, centre, d, -centre[2] / d[2] if j == 0 else distances[i, j - 1], borders)
            lam, kind, index, sides, wall_x, wall_y = hit
            for k in range(3):
                p[k] = centre[k] + lam * d[k]
            wall = wall_x != 0.0 or wall_y != 0.0
            # On a wall the pixel and its neighbours need all their rays.
            near[i, j] = wall or _near_edge(relief, p[0], p[1], tolerance)
            distances[i, j] = lam
            p[0], p[1] = p[0] + OFF * wall_x, p[1] + OFF * wall_y
            p[2] += 0.0 if wall else OFF
            bright = 1 if lit(relief, p, source, borders) else 0
            codes[i, j] = ((sides * 512 + index) * 16 + kind) * 2 + bright


@entry
def _gather(  # type: ignore[no-untyped-def]
    relief, light, values, origin, texel, camera, centre, projector, source, few, many, borders, d, p, n,
    busy, codes, distances, top, first, column, row, direct, ambient,
):  # fmt: skip
    """All samples of some rows. Within a smooth pixel the surface is its tangent plane (to 0.05 µm)."""
    width = busy.shape[1]
    bright, dim = 0.0, 0.0
    for i in range(busy.shape[0]):
        for j in range(width):
            at = first[i * width + j] - first[0]
            spread = many if busy[i, j] else few
            reach = 0.0
            if not busy[i, j]:
                ray(camera, float(j), float(top + i), d)
                for m in range(3):
                    p[m] = centre[m] + distances[i, j] * d[m]
                code = codes[i, j] >> 1
                hit = distances[i, j], code & 15, (code >> 4) & 511, code >> 13, 0.0, 0.0
                bright, dim = shade(relief, light, hit, d, source, p, n, borders)
                for m in range(3):
                    reach += n[m] * (p[m] - centre[m])
            for k in range(spread.shape[0]):
                ray(camera, j + spread[k, 0], top + i + spread[k, 1], d)
                if busy[i, j]:
                    hit = cast(relief, centre, d, distances[i, j], borders)
                    for m in range(3):
                        p[m] = centre[m] + hit[0] * d[m]
                    bright, dim = shade(relief, light, hit, d, source, p, n, borders)
                    kind = hit[1]
                else:
                    lam = reach / (n[0] * d[0] + n[1] * d[1] + n[2] * d[2])
                    for m in range(3):
                        p[m] = centre[m] + lam * d[m]
                    kind = (codes[i, j] >> 1) & 15
                column[at + k], row[at + k] = pixel(projector, p)
                reflectance = 1.0 if kind == BACKGROUND else reflectance_at(values, origin, texel, p[0], p[1])
                direct[at + k], ambient[at + k] = reflectance * bright, reflectance * dim


def spread(samples: int, sigma_px: float) -> Floats:
    """(samples, 2) offsets in pixels that stand for a Gaussian of `sigma_px` along each axis.

    A rank-1 lattice (Korobov, golden section) carried over by the normal distribution: its projection onto any axis is
    evenly spread, so edges in any direction fall on fine and even coverage levels.
    """
    k = np.arange(samples)
    uniform = np.stack([(k + 0.5) / samples, (k * (np.sqrt(5.0) - 1.0) / 2.0 + 0.5) % 1.0], axis=1)
    offsets = ndtri(uniform)
    offsets -= offsets.mean(axis=0)
    covariance = offsets.T @ offsets / samples
    return np.asarray(offsets @ np.linalg.inv(np.linalg.cholesky(covariance)).T * sigma_px)


def four(sigma_px: float) -> Floats:
    """(4, 2) offsets with the mean and second moments of the same Gaussian: exact for quadratic brightness."""
    return sigma_px * np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])


def trace(
    relief: Relief, reflectance: ReflectanceMap, light: Light, camera: Device, projector: Device,
    blur_px: float, samples: int, progress: Callable[[float], None],
) -> Hits:  # fmt: skip
    """Everything a camera sees of the panel.

    Parameters
    ----------
    camera, projector : Device
        Posed in the panel's frame (`simulator.lens.moved`).
    blur_px : float
        Standard deviation of the camera's point-spread function, pixel area included.
    samples : int
        Rays per pixel near borders.
    progress : called with the share done, 0 … 1.
    """
    height, width = camera.height, camera.width
    packed, beam = pack_device(camera), pack_device(projector)
    centre, source = camera.centre, projector.centre
    pixel_mm = abs(centre[2]) / camera.K[0, 0]
    codes, near = np.empty((height, width), np.int64), np.empty((height, width), np.bool_)
    distances = np.empty((height, width))

    def look(rows: slice) -> None:
        _look(relief, packed, centre, source, 0.75 * pixel_mm, *_memory(2), rows.start, codes[rows],
              distances[rows], near[rows])  # fmt: skip

    share_bands(look, height, lambda done: progress(0.2 * done))
    busy = widened(near | _changes(codes), 3.2 * blur_px + 0.7)
    few, many = four(blur_px), spread(samples, blur_px)
    first = np.concatenate([[0], np.cumsum(np.where(busy.ravel(), len(many), len(few)))]).astype(np.int64)
    total = int(first[-1])
    hits = Hits(height, width, first, np.empty(total), np.empty(total), np.empty(total, np.float32),
                np.empty(total, np.float32))  # fmt: skip

    def gather(rows: slice) -> None:
        begin, end = rows.start * width, rows.stop * width
        own = first[begin : end + 1]
        part = slice(int(own[0]), int(own[-1]))
        _gather(relief, light, reflectance.values, reflectance.origin, reflectance.texel_mm, packed, centre, beam,
                source, few, many, *_memory(3), busy[rows], codes[rows], distances[rows], rows.start, own,
                hits.column[part], hits.row[part], hits.direct[part], hits.ambient[part])  # fmt: skip

    share_bands(gather, height, lambda done: progress(0.2 + 0.8 * done))
    return hits


def _memory(vectors: int) -> tuple[Floats, ...]:
    """Working memory of one thread: borders, and some vectors."""
    return np.empty((MAX_BORDERS, 3)), *(np.empty(3) for _ in range(vectors))


def _changes(codes: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Pixels whose right, lower or diagonal neighbour sees another piece, and that neighbour."""
    change = np.zeros(codes.shape, bool)
    for here, there in (
        ((slice(None), slice(0, -1)), (slice(None), slice(1, None))),
        ((slice(0, -1), slice(None)), (slice(1, None), slice(None))),
    ):
        differ = codes[here] != codes[there]
        change[here] |= differ
        change[there] |= differ
    return change


def widened(mask: NDArray[np.bool_], radius_px: float) -> NDArray[np.bool_]:
    """The mask grown by a disc."""
    n = math.ceil(radius_px)
    y, x = np.mgrid[-n : n + 1, -n : n + 1]
    disc = (x * x + y * y <= radius_px * radius_px).astype(np.uint8)
    return cv2.dilate(mask.astype(np.uint8), disc).astype(bool)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def share_bands(work: Callable[[slice], None], height: int, progress: Callable[[float], None]) -> None:
    """Do all rows in bands on several threads; the first band alone, since it compiles the kernel."""
    bands = [slice(top, min(top + _BAND, height)) for top in range(0, height, _BAND)]
    work(bands[0])
    with ThreadPoolExecutor(_cores()) as pool:
        for done, _ in enumerate(pool.map(work, bands[1:]), 2):
            progress(done / len(bands))
