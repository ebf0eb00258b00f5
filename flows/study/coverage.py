"""Whether the stated expanded uncertainties hold: shares of errors within U95."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from flows.study.document import Cell, Column, Section, Table
from flows.study.values import Quantity, Value


def coverage_section(values: Sequence[Value], where: str) -> Section:
    """Shares of |error| ≤ U95 by rig and quantity, and how error / σ is distributed."""
    stated = [value for value in values if value.measured_mm is not None and value.u95_mm]
    groups: dict[tuple[str, Quantity], list[Value]] = {}
    for value in stated:
        groups.setdefault((value.station.rsplit("-", 1)[-1], value.quantity), []).append(value)
    rows: list[list[Cell]] = []
    figure = go.Figure()
    for (rig, quantity), group in sorted(groups.items()):
        error = np.array([value.error_mm for value in group])
        u95 = np.array([value.u95_mm for value in group], float)
        rows.append(
            [f"{rig} rig", quantity, len(group), len({(v.series, v.feature) for v in group}), float(np.median(u95)),
             float(np.median(np.abs(error))), 100 * float(np.mean(np.abs(error) <= u95))]
        )  # fmt: skip
        share = np.sort(np.abs(error) / u95)
        figure.add_trace(
            go.Scatter(x=share, y=100 * np.arange(1, len(share) + 1) / len(share), name=f"{quantity}, {rig} rig")
        )
    columns = (
        Column("rig"), Column("quantity"), Column("values", 0), Column("features", 0), Column("median U95, mm", 4),
        Column("median |error|, mm", 4), Column("within U95, %", 1),
    )  # fmt: skip
    text = (
        "Share of the errors that lie within the stated expanded uncertainty; 95 % is what it promises. Scans of one "
        "placement share what does not change between them (calibration, grain of the skin), so the number of features "
        "says more than the number of values.",
    )
    figure.add_vline(x=1.0, line_dash="dot")
    figure.add_hline(y=95.0, line_dash="dot")
    figure.update_layout(
        title="Errors against their U95", xaxis_title="|error| / U95", yaxis_title="share, %", height=340
    )
    name = f"coverage-{where.lower().replace(' ', '-')}"
    return Section(
        f"Coverage of U95: {where}", text, (Table(name, "Coverage", columns, rows),), (figure,) if rows else ()
    )
