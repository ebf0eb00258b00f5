"""A seam's stations in a few numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from metrology.errors import UsageError
from metrology.results import SeamStation

Quantity = Literal["step_mm", "width_mm"]


@dataclass(frozen=True)
class SeamSummary:
    """Statistics of one quantity along one seam, mm; `measured` of `stations` have a value."""

    seam_id: str
    quantity: Quantity
    stations: int
    measured: int
    minimum: float
    maximum: float
    mean: float
    p05: float
    median: float
    p95: float


def summarize(stations: Sequence[SeamStation], quantity: Quantity) -> list[SeamSummary]:
    """One summary per seam, in order of its id; NaN where no station was measured."""
    if quantity not in ("step_mm", "width_mm"):
        raise UsageError(f"quantity: found {quantity!r}, expected step_mm or width_mm")
    summaries = []
    for seam_id in sorted({station.seam_id for station in stations}):
        own = [getattr(station, quantity) for station in stations if station.seam_id == seam_id]
        values = np.array([value for value in own if value is not None], float)
        if len(values):
            p05, median, p95 = (float(v) for v in np.percentile(values, [5, 50, 95]))
            numbers = (float(values.min()), float(values.max()), float(values.mean()), p05, median, p95)
        else:
            numbers = (np.nan,) * 6
        summaries.append(SeamSummary(seam_id, quantity, len(own), len(values), *numbers))
    return summaries
