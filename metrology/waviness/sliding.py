"""A straight-edge slid along the lines of a map of heights."""

from __future__ import annotations

import numpy as np

from metrology.jit import kernel


@kernel
def sliding_gap(heights, window, most_missing):  # type: ignore[no-untyped-def]
    """Greatest gap under a straight-edge that lies on the known points of a stretch of a row.

    Parameters
    ----------
    heights : (rows, columns) float64
        mm; NaN where nothing is known.
    window : int
        Points under the straight-edge.
    most_missing : float
        Share of them that may be unknown.

    Returns
    -------
    gap : float
        mm; NaN where no stretch is long enough.
    row, column : int
        Where it is.
    """
    best, at_row, at_column = np.nan, -1, -1
    hull = np.empty(window, np.int64)
    for i in range(heights.shape[0]):
        for start in range(heights.shape[1] - window + 1):
            if np.isnan(heights[i, start]) or np.isnan(heights[i, start + window - 1]):
                continue
            count, known = 0, 0
            for k in range(start, start + window):
                if np.isnan(heights[i, k]):
                    continue
                known += 1
                while count > 1:
                    a, b = hull[count - 2], hull[count - 1]
                    if (heights[i, b] - heights[i, a]) * (k - a) > (heights[i, k] - heights[i, a]) * (b - a):
                        break
                    count -= 1
                hull[count] = k
                count += 1
            if known < (1.0 - most_missing) * window:
                continue
            for n in range(count - 1):
                a, b = hull[n], hull[n + 1]
                for k in range(a + 1, b):
                    edge = heights[i, a] + (heights[i, b] - heights[i, a]) * (k - a) / (b - a)
                    gap = edge - heights[i, k]
                    if gap > best or (np.isnan(best) and gap == gap):
                        best, at_row, at_column = gap, i, k
            if np.isnan(best):
                best, at_row, at_column = 0.0, i, start
    return best, at_row, at_column
