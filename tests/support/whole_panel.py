"""The simulated panel as a whole: its height at places, and where rays meet it."""

from __future__ import annotations

import numpy as np

from metrology.arrays import Ints
from simulator.cast import MAX_BORDERS, cast
from simulator.compiled import entry
from simulator.relief import Floats, Relief, cell_of, piece_at, piece_height


@entry
def _surface(relief, x, y, out, kinds):  # type: ignore[no-untyped-def]
    for i in range(x.size):
        row, column = cell_of(relief, x[i], y[i])
        kind, index, side = piece_at(relief, row, column, x[i], y[i])
        kinds[i] = kind
        out[i] = piece_height(relief, kind, index, side, x[i], y[i])


@entry
def _meet(relief, eye, directions, borders, d, distances, kinds):  # type: ignore[no-untyped-def]
    for i in range(directions.shape[0]):
        for k in range(3):
            d[k] = directions[i, k]
        hit = cast(relief, eye, d, -eye[2] / d[2], borders)
        distances[i] = hit[0]
        kinds[i] = -1 if hit[4] != 0.0 or hit[5] != 0.0 else hit[1]


def surface_heights(relief: Relief, x: Floats, y: Floats) -> tuple[Floats, Ints]:
    """(n,) heights of the whole panel and the kinds of its pieces."""
    out, kinds = np.empty(len(x)), np.empty(len(x), np.int64)
    _surface(relief, np.asarray(x, float), np.asarray(y, float), out, kinds)
    return out, kinds


def meet(relief: Relief, eye: Floats, directions: Floats) -> tuple[Floats, Ints]:
    """Where rays meet the panel.

    Parameters
    ----------
    eye : (3,) array
    directions : (n, 3) array

    Returns
    -------
    points : (n, 3) ndarray
    kinds : (n,) ndarray
        Kind of the piece (`simulator.relief`), −1 for a wall.
    """
    distances, kinds = np.empty(len(directions)), np.empty(len(directions), np.int64)
    rays, eye = np.ascontiguousarray(directions, float), np.asarray(eye, float)
    _meet(relief, eye, rays, np.empty((MAX_BORDERS, 3)), np.empty(3), distances, kinds)
    return eye + distances[:, None] * rays, kinds
