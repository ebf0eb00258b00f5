"""Values at evenly spaced places along a seam."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrology.results import SeamStation

_END = 0.1  # of what was measured of a seam left out at either end


def along(
    stations: Sequence[SeamStation], number: int, column: str, u95_column: str
) -> list[tuple[float, float, float]]:
    """(position in mm, value, U95) of the measured station nearest to each of evenly spaced places.

    Parameters
    ----------
    stations : sequence of SeamStation
        Of one seam.
    column, u95_column : str
        Of the value and of its expanded uncertainty.
    """
    known = [row for row in stations if getattr(row, column) is not None and getattr(row, u95_column) is not None]
    if not known:
        return []
    s = np.array([row.s_mm for row in known])
    margin = _END * np.ptp(s)
    places = np.linspace(s.min() + margin, s.max() - margin, number)
    nearest = dict.fromkeys(int(np.abs(s - place).argmin()) for place in places)
    return [(float(s[k]), getattr(known[k], column), getattr(known[k], u95_column)) for k in nearest]
