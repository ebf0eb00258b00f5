"""Table 1 and Fig. 13: the standard part's rivets, ten scans, with the true and with a calibrated rig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from flows.study import paper
from flows.study.conditions import conditions
from flows.study.coverage import coverage_section
from flows.study.document import Bar, Cell, Column, Section, Table
from flows.study.scene_times import times_section
from flows.study.series import RigKind, Series
from flows.study.spec import RepeatedScans
from flows.study.values import Value, grid, rivet_values
from flows.study.values_table import values_table
from simulator.spec import SimulationSpec
from storage.archive import Store

_RIGS: tuple[RigKind, ...] = ("true", "calibrated")
_MEAN_ERROR_MM, _MAX_ERROR_MM, _SD_MM = 0.002, 0.006, 0.001
_SAME_TRUTH_MM = 5e-4  # the paper states heights to a micrometre
_MARKS = {
    "true": {"size": 5, "color": "#0072b2", "opacity": 0.7},
    "calibrated": {"size": 5, "color": "#d55e00", "opacity": 0.7},
}
_BESIDE = {"true": -0.12, "calibrated": 0.12}  # where the two rigs' points stand beside a rivet's mark


@dataclass(frozen=True)
class Row:
    """A rivet's figures as Table 1 has them, mm."""

    feature: str
    true: float
    measured: float
    mean_error: float
    sd: float
    max_error: float


def accuracy_rows(values: Sequence[Value]) -> list[Row]:
    """Mean, mean error, standard deviation and largest error of each rivet over the scans."""
    features, true, measured = grid(values, "height")
    error = measured - true[:, None]
    return [
        Row(name, t, float(np.nanmean(m)), float(np.nanmean(e)), float(np.nanstd(m, ddof=1)), float(np.nanmax(abs(e))))
        for name, t, m, e in zip(features, true, measured, error, strict=True)
        if np.isfinite(m).sum() > 1
    ]


class StandardPart:
    """The block `standard_part`."""

    def __init__(self, asked: RepeatedScans, simulation: SimulationSpec) -> None:
        self.series: tuple[Series, ...] = (Series("TABLE-1", replace(simulation, repeats=asked.scans), _RIGS),)

    def sections(self, store: Store) -> list[Section]:
        """Table 1, its plot, the coverage of U95 and the time of a scene."""
        series = self.series[0]
        values = {rig: rivet_values(store, series, rig) for rig in _RIGS}
        rows = {rig: accuracy_rows(values[rig]) for rig in _RIGS}
        every = [value for rig in _RIGS for value in values[rig]]
        return [
            Section(
                "Table 1: heights of the standard part's rivets",
                (
                    conditions(series),
                    "Mean error: mean of the scans less the truth; sd: over the scans; maximum error: the largest "
                    "difference of one scan from the truth. The bottom row averages the rivets' absolute mean errors, "
                    "standard deviations and maximum errors.",
                ),
                (_table(rows), values_table("table-1-values", every)),
                (_heights(values["calibrated"]), _errors(values)),
                _bars(rows["calibrated"]),
            ),
            coverage_section(every, "Table 1"),
            times_section(store, series),
        ]


def _averages(rows: Sequence[Row]) -> tuple[float, float, float]:
    figures = np.array([(abs(row.mean_error), row.sd, row.max_error) for row in rows]).reshape(-1, 3)
    mean_error, sd, max_error = (float(v) for v in figures.mean(axis=0)) if len(rows) else (np.nan,) * 3
    return mean_error, sd, max_error


def _table(rows: dict[RigKind, list[Row]]) -> Table:
    """The paper's columns for the true rig, the calibrated rig, and the paper itself, side by side."""
    columns = (
        Column("rivet"),
        Column("truth", 3),
        *_columns("true rig", 4),
        *_columns("calibrated rig", 4),
        *_columns("paper", 3),
    )
    by_name = {rig: {row.feature: row for row in rows[rig]} for rig in _RIGS}
    names = list(dict.fromkeys(row.feature for rig in _RIGS for row in rows[rig]))
    body: list[list[Cell]] = []
    for number, name in enumerate(names):
        found = [by_name[rig].get(name) for rig in _RIGS]
        true = next(row.true for row in found if row)
        ours = [figure for row in found for figure in _figures(row)]
        body.append([name, true, *ours, *_figures(_published(number, true))])
    last: list[Cell] = ["average", None]
    for rig in _RIGS:
        last += [None, *_averages(rows[rig])]
    body.append([*last, None, paper.TABLE_1_MEAN_ERROR, paper.TABLE_1_SD, paper.TABLE_1_MAX_ERROR])
    return Table("table-1", "Heights, mm", columns, body)


def _columns(group: str, digits: int) -> list[Column]:
    return [
        Column("measured", digits, group=group),
        Column("mean error", digits, True, group),
        Column("sd", 4, group=group),
        Column("max error", digits, group=group),
    ]


def _figures(row: Row | paper.Accuracy | None) -> list[Cell]:
    return [row.measured, row.mean_error, row.sd, row.max_error] if row else [None] * 4


def _published(number: int, true: float) -> paper.Accuracy | None:
    """The paper's row of a rivet, if it is the paper's rivet."""
    if number < len(paper.TABLE_1) and abs(paper.TABLE_1[number].true - true) < _SAME_TRUTH_MM:
        return paper.TABLE_1[number]
    return None


def _bars(rows: Sequence[Row]) -> tuple[Bar, ...]:
    mean_error, sd, _ = _averages(rows)
    largest = max((row.max_error for row in rows), default=np.nan)
    return (
        Bar("Table 1, calibrated rig: mean |mean error|", mean_error, _MEAN_ERROR_MM, "mm", paper.TABLE_1_MEAN_ERROR),
        Bar(
            "Table 1, calibrated rig: largest error",
            largest,
            _MAX_ERROR_MM,
            "mm",
            max(p.max_error for p in paper.TABLE_1),
        ),
        Bar("Table 1, calibrated rig: mean sd", sd, _SD_MM, "mm", paper.TABLE_1_SD),
    )


def _heights(values: Sequence[Value]) -> go.Figure:
    """The paper's Fig. 13."""
    features, true, measured = grid(values, "height")
    figure = go.Figure(
        [
            go.Scatter(x=features, y=column, mode="markers", name=f"scan {k + 1}", marker={"size": 5})
            for k, column in enumerate(measured.T)
        ]
    )
    figure.add_trace(
        go.Scatter(
            x=features,
            y=true,
            mode="markers",
            name="truth",
            marker={"symbol": "line-ew", "size": 18, "line": {"width": 2, "color": "#1c2733"}},
        )
    )
    return figure.update_layout(
        title="Every scan's height of each rivet, calibrated rig (as Fig. 13 of the paper)", yaxis_title="height, mm",
        height=380,
    )  # fmt: skip


def _errors(values: dict[RigKind, list[Value]]) -> go.Figure:
    """The same as differences from the truth, with the paper's mean errors."""
    figure = go.Figure()
    for rig, asked in values.items():
        features, true, measured = grid(asked, "height")
        error: NDArray[np.float64] = 1000 * (measured - true[:, None])
        x = np.repeat(np.arange(len(features)) + _BESIDE[rig], measured.shape[1])
        figure.add_trace(go.Scatter(x=x, y=error.ravel(), mode="markers", name=f"{rig} rig", marker=_MARKS[rig]))
    theirs = [(k, p) for k, t in enumerate(true) if (p := _published(k, float(t)))]
    figure.add_trace(
        go.Scatter(
            x=[k for k, _ in theirs],
            y=[1000 * p.mean_error for _, p in theirs],
            mode="markers",
            name="paper, mean of ten",
            marker={"symbol": "x", "size": 8, "color": "#6b7280"},
        )
    )
    figure.update_xaxes(tickvals=list(range(len(features))), ticktext=features)
    return figure.update_layout(title="Errors of every scan", yaxis_title="measured less true, µm", height=380)
