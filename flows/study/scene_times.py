"""How long the steps of an inspection take."""

from __future__ import annotations

import os
import platform

import numpy as np
import plotly.graph_objects as go

from flows.study import paper
from flows.study.document import Cell, Column, Section, Table
from flows.study.series import Series
from metrology.steps import TIMED
from storage.archive import Store


def times_section(store: Store, series: Series) -> Section:
    """Median wall time of each step over a series' scans."""
    columns = ", ".join(f"seconds_{step}" for step in (*TIMED, "total"))
    found = store.query(f"SELECT {columns} FROM scenes WHERE aircraft_serial = ?", [series.name]).to_pydict()
    medians = {step: _median(found[f"seconds_{step}"]) for step in (*TIMED, "total")}
    rows: list[list[Cell]] = [[step.replace("_", " "), seconds] for step, seconds in medians.items()]
    figure = go.Figure(
        go.Bar(x=[medians[step] for step in TIMED], y=[str(row[0]) for row in rows[:-1]], orientation="h")
    )
    figure.update_layout(xaxis_title="s", height=340, title="Median wall time of the steps")
    figure.update_yaxes(autorange="reversed")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    text = (
        f"Median wall time of {len(found['seconds_total'])} scenes of {series.name} on {cores} cores "
        f"({platform.machine()}, {platform.system()}), reading the frames included; other work on the machine counts. "
        f"The paper states about {paper.SCENE_SECONDS:.0f} s for measuring and analysing a scene.",
    )
    table = Table(f"times-{series.name.lower()}", "Seconds per scene", (Column("step"), Column("s", 2)), rows)
    return Section(f"Time of a scene: {series.name}", text, (table,), (figure,))


def _median(values: list[float | None]) -> float:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else np.nan
