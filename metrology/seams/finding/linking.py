"""Line points linked into chains, from strong ones along the line's direction (Steger 1998, §3.3)."""

from __future__ import annotations

import numpy as np

from metrology.arrays import Array
from metrology.jit import kernel
from metrology.ridges import RidgeMap


def link(ridges: RidgeMap, high: float, min_points: int) -> list[Array]:
    """Chains of line points.

    Parameters
    ----------
    ridges : RidgeMap
        Points above the low threshold, of either polarity: a chain keeps to one.
    high : float
        Least strength of a chain's first point.

    Returns
    -------
    list of (n, 3) ndarray
        u, v, strength of each point, in order along the line; strength is negative for bright lines.
    """
    magnitude = np.abs(ridges.strength).ravel()
    seeds = np.flatnonzero(magnitude > high)
    seeds = seeds[np.argsort(-magnitude[seeds], kind="stable")]
    points, ends = _link(
        ridges.strength, ridges.u, ridges.v, ridges.normal_u, ridges.normal_v, seeds.astype(np.int64), min_points
    )
    starts = np.concatenate([[0], ends])[:-1].astype(int)
    return [points[start:end].copy() for start, end in zip(starts, ends, strict=True)]


@kernel
def _link(strength, u, v, nu, nv, seeds, min_points):  # type: ignore[no-untyped-def]
    """Follow the line from each unused seed both ways; chains one after the other, and where each ends."""
    height, width = strength.shape
    used = np.zeros((height, width), np.bool_)
    points = np.empty((np.count_nonzero(strength), 3))
    ends = np.empty(seeds.size, np.int64)
    trail_rows = np.empty(points.shape[0], np.int64)
    trail_columns = np.empty(points.shape[0], np.int64)
    total, chains = 0, 0
    for seed in seeds:
        row0, column0 = seed // width, seed % width
        if used[row0, column0]:
            continue
        used[row0, column0] = True
        backwards = 0
        count = 0
        for way in range(2):
            row, column = row0, column0
            tu, tv = -nv[row, column], nu[row, column]
            if way == 1:
                tu, tv = -tu, -tv
                backwards = count
            while True:
                best, next_row, next_column = 1e9, -1, -1
                for r in range(max(0, row - 2), min(height, row + 3)):
                    for c in range(max(0, column - 2), min(width, column + 3)):
                        if used[r, c] or strength[r, c] * strength[row, column] <= 0.0:
                            continue
                        du, dv = u[r, c] - u[row, column], v[r, c] - v[row, column]
                        distance = np.sqrt(du * du + dv * dv) + 1e-9
                        ahead = (du * tu + dv * tv) / distance
                        parallel = abs(nu[r, c] * nu[row, column] + nv[r, c] * nv[row, column])
                        if ahead < 0.7 or parallel < 0.85:
                            continue
                        # Near, straight ahead, and of the same direction.
                        price = distance + 1.5 * np.arccos(min(parallel, 1.0)) + (1.0 - ahead)
                        if price < best:
                            best, next_row, next_column = price, r, c
                if next_row < 0:
                    break
                # What lies beside the path belongs to the same line.
                for r in range(max(0, row - 1), min(height, row + 2)):
                    for c in range(max(0, column - 1), min(width, column + 2)):
                        used[r, c] = True
                au, av = -nv[next_row, next_column], nu[next_row, next_column]
                if au * tu + av * tv < 0.0:
                    au, av = -au, -av
                row, column, tu, tv = next_row, next_column, au, av
                used[row, column] = True
                trail_rows[count], trail_columns[count] = row, column
                count += 1
                if count >= trail_rows.size:
                    break
            if count >= trail_rows.size:
                break
        if count + 1 < min_points:
            continue
        # The second way backwards, the seed, then the first way.
        for k in range(count - 1, backwards - 1, -1):
            r, c = trail_rows[k], trail_columns[k]
            points[total, 0], points[total, 1], points[total, 2] = u[r, c], v[r, c], strength[r, c]
            total += 1
        points[total, 0], points[total, 1] = u[row0, column0], v[row0, column0]
        points[total, 2] = strength[row0, column0]
        total += 1
        for k in range(backwards):
            r, c = trail_rows[k], trail_columns[k]
            points[total, 0], points[total, 1], points[total, 2] = u[r, c], v[r, c], strength[r, c]
            total += 1
        ends[chains] = total
        chains += 1
    return points[:total], ends[:chains]
