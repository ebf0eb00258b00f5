"""Every single value of a study, for its CSV."""

from __future__ import annotations

from collections.abc import Sequence

from flows.study.document import Column, Table
from flows.study.values import Value


def values_table(name: str, values: Sequence[Value]) -> Table:
    """One row per feature, quantity and scan."""
    columns = ("series", "station", "scan", "feature", "quantity", "true_mm", "measured_mm", "u95_mm")
    rows = [
        (v.series, v.station, v.scan + 1, v.feature, v.quantity, v.true_mm, v.measured_mm, v.u95_mm) for v in values
    ]
    return Table(name, "", tuple(Column(column) for column in columns), rows, shown=False)
