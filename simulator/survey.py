"""Looking up the packed panel from Python: heights, normals, sides and lines of sight."""

from __future__ import annotations

import numpy as np

from metrology.arrays import Ints
from simulator.cast import MAX_BORDERS, lit
from simulator.compiled import entry
from simulator.relief import Floats, Relief, plate_height, sides_of


@entry
def _sides(relief, x, y, out):  # type: ignore[no-untyped-def]
    for i in range(x.size):
        out[i] = sides_of(relief, x[i], y[i])


@entry
def _plates(relief, x, y, sides, out):  # type: ignore[no-untyped-def]
    for i in range(x.size):
        out[i] = plate_height(relief, x[i], y[i], sides[i], -1)


@entry
def _sight(relief, points, eye, borders, out):  # type: ignore[no-untyped-def]
    for i in range(points.shape[0]):
        out[i] = lit(relief, points[i], eye, borders)


def sides_at(relief: Relief, x: Floats, y: Floats) -> Ints:
    """(n,) for each place the bits of the seams to whose left it lies."""
    out = np.empty(len(x), np.int64)
    _sides(relief, np.asarray(x, float), np.asarray(y, float), out)
    return out


def plate_heights(relief: Relief, x: Floats, y: Floats, sides: Ints) -> Floats:
    """(n,) heights of the plates that `sides` name, continued beyond their edges."""
    out = np.empty(len(x))
    _plates(relief, np.asarray(x, float), np.asarray(y, float), np.asarray(sides, np.int64), out)
    return out


def plate_normals(relief: Relief, x: Floats, y: Floats, sides: Ints, h: float = 2e-3) -> Floats:
    """(n, 3) unit normals of the plates."""
    gx = (plate_heights(relief, x + h, y, sides) - plate_heights(relief, x - h, y, sides)) / (2 * h)
    gy = (plate_heights(relief, x, y + h, sides) - plate_heights(relief, x, y - h, sides)) / (2 * h)
    normals = np.stack([-gx, -gy, np.ones_like(gx)], axis=1)
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def survey(relief: Relief, x: float, y: float) -> tuple[Floats, Floats]:
    """Point and unit normal of the plate at one place."""
    xs, ys = np.array([x]), np.array([y])
    sides = sides_at(relief, xs, ys)
    point = np.array([x, y, plate_heights(relief, xs, ys, sides)[0]])
    return point, plate_normals(relief, xs, ys, sides)[0]


def seen(relief: Relief, points: Floats, eye: Floats) -> np.ndarray:
    """(n,) whether nothing stands between the points (just off the surface) and the eye."""
    out = np.empty(len(points), np.bool_)
    _sight(relief, np.ascontiguousarray(points, float), np.asarray(eye, float), np.empty((MAX_BORDERS, 3)), out)
    return out
