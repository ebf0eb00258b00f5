"""Tables 2 and 3: seven rivets and one seam of a skin, scanned again and again with nothing changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import plotly.graph_objects as go

from flows.study import paper
from flows.study.conditions import conditions
from flows.study.coverage import coverage_section
from flows.study.document import Bar, Cell, Column, Section, Table
from flows.study.scene_times import times_section
from flows.study.series import RigKind, Series
from flows.study.spec import RepeatedScans
from flows.study.values import Quantity, Value, grid, position_values, rivet_values, station_values
from flows.study.values_table import values_table
from simulator.spec import SimulationSpec
from storage.archive import Store

_RIG: RigKind = "calibrated"
_STEP_SD_MM, _WIDTH_SD_MM = 0.003, 0.008
_QUANTITIES: tuple[Quantity, ...] = ("step", "width")


@dataclass(frozen=True)
class Row:
    """A feature's figures as Tables 2 and 3 have them, and its truth, mm."""

    feature: str
    true: float
    mean: float
    sd: float
    deviation: float


def repeatability_rows(values: Sequence[Value], quantity: Quantity) -> list[Row]:
    """Mean, standard deviation and largest variation range of each feature over the scans."""
    features, true, measured = grid(values, quantity)
    return [
        Row(name, t, float(np.nanmean(m)), float(np.nanstd(m, ddof=1)), float(np.nanmax(m) - np.nanmin(m)))
        for name, t, m in zip(features, true, measured, strict=True)
        if np.isfinite(m).sum() > 1
    ]


class Skin:
    """The block `skin`."""

    def __init__(self, asked: RepeatedScans, simulation: SimulationSpec) -> None:
        self._positions = asked.positions
        self.series: tuple[Series, ...] = (Series("TABLES-2-3", replace(simulation, repeats=asked.scans), (_RIG,)),)

    def sections(self, store: Store) -> list[Section]:
        """Both tables, the coverage of U95 at every station, and the time of a scene."""
        series = self.series[0]
        rivets = rivet_values(store, series, _RIG)
        positions = position_values(store, series, _RIG, self._positions)
        heights = repeatability_rows(rivets, "height")
        sections = [
            Section(
                "Table 2: repeatability of rivet heights",
                (conditions(series), _MEANING),
                (_table_2(heights), values_table("table-2-values", rivets)),
                (_deviations(rivets, "height"),),
            )
        ]
        if positions:
            sections.append(self._table_3(series, positions))
        return [
            *sections,
            coverage_section(rivets + station_values(store, series, _RIG), "Tables 2 and 3"),
            times_section(store, series),
        ]

    def _table_3(self, series: Series, positions: list[Value]) -> Section:
        steps, widths = (repeatability_rows(positions, quantity) for quantity in _QUANTITIES)
        return Section(
            "Table 3: repeatability of a seam's step and width",
            (
                conditions(series),
                f"{self._positions} places evenly along the seam, each between the two nearest stations (linear). "
                f"{_MEANING}",
            ),
            (_table_3(steps, widths), values_table("table-3-values", positions)),
            tuple(_deviations(positions, quantity) for quantity in _QUANTITIES),
            (
                _bar("Table 3: largest sd of the step", steps, _STEP_SD_MM, max(s.sd for s, _ in paper.TABLE_3)),
                _bar("Table 3: largest sd of the width", widths, _WIDTH_SD_MM, max(w.sd for _, w in paper.TABLE_3)),
            ),
        )


_MEANING = (
    "Maximum deviation: the range of the values over the scans, as the paper has it. The paper's part was a real skin "
    "with other heights, steps and widths, so its averages are not to be compared, its scatter is; it knows no truth."
)


def _bar(name: str, rows: Sequence[Row], limit: float, theirs: float) -> Bar:
    return Bar(name, max((row.sd for row in rows), default=np.nan), limit, "mm", theirs)


def _columns(what: str) -> list[Column]:
    ours = [Column(name, 4, group=what) for name in ("truth", "average", "sd", "max deviation")]
    return ours + [Column(name, 3, group=f"{what}, paper") for name in ("sd", "max deviation")]


def _figures(row: Row | None) -> list[Cell]:
    return [row.true, row.mean, row.sd, row.deviation] if row else [None] * 4


def _mean_of(rows: Sequence[Row]) -> list[Cell]:
    return [None, None, _mean([row.sd for row in rows]), _mean([row.deviation for row in rows])]


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else np.nan


def _table_2(rows: Sequence[Row]) -> Table:
    columns = [Column("rivet"), *_columns("height")]
    theirs = [*paper.TABLE_2, *[None] * len(rows)]
    body = [
        [row.feature, *_figures(row), *((p.sd, p.deviation) if p else (None, None))]
        for row, p in zip(rows, theirs, strict=False)
    ]
    last = (_mean([p.sd for p in paper.TABLE_2]), _mean([p.deviation for p in paper.TABLE_2]))
    body.append(["average", *_mean_of(rows), *last])
    return Table("table-2", "Heights, mm", tuple(columns), body)


def _table_3(steps: Sequence[Row], widths: Sequence[Row]) -> Table:
    columns = [Column("position"), *_columns("step"), *_columns("width")]
    names = list(dict.fromkeys(row.feature for row in (*steps, *widths)))
    by_name = [{row.feature: row for row in rows} for rows in (steps, widths)]
    body: list[list[Cell]] = []
    for number, name in enumerate(names):
        theirs = paper.TABLE_3[number] if number < len(paper.TABLE_3) else (None, None)
        row: list[Cell] = [name]
        for found, p in zip(by_name, theirs, strict=True):
            row += [*_figures(found.get(name)), *((p.sd, p.deviation) if p else (None, None))]
        body.append(row)
    last: list[Cell] = ["average"]
    for rows, side in ((steps, 0), (widths, 1)):
        published = [row[side] for row in paper.TABLE_3]
        last += [*_mean_of(rows), _mean([p.sd for p in published]), _mean([p.deviation for p in published])]
    return Table("table-3", "Steps and widths, mm", tuple(columns), [*body, last])


def _deviations(values: Sequence[Value], quantity: Quantity) -> go.Figure:
    """Every scan's difference from the mean of its feature."""
    features, _, measured = grid([value for value in values if value.measured_mm is not None], quantity)
    off = 1000 * (measured - np.nanmean(measured, axis=1, keepdims=True))
    figure = go.Figure(
        go.Scatter(
            x=np.repeat(features, measured.shape[1]), y=off.ravel(), mode="markers", marker={"size": 5, "opacity": 0.6}
        )
    )
    return figure.update_layout(title=f"Every scan's {quantity} less the mean", yaxis_title="µm", height=320)
