"""Gage R&R on simulated panels: rivets and seam positions are the parts, placements of the rig the operators."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from flows.study.conditions import conditions
from flows.study.coverage import coverage_section
from flows.study.document import Bar, Cell, Column, Section, Table
from flows.study.series import RigKind, Series
from flows.study.spec import GageSpec
from flows.study.values import Quantity, Value, grid, position_values, rivet_values, station_values
from flows.study.values_table import values_table
from metrology.gage import GageStudy, gage_study
from simulator.spec import SimulationSpec
from storage.archive import Store

_RIG: RigKind = "calibrated"
_GRR_PERCENT = 10.0
_QUANTITIES: tuple[Quantity, ...] = ("height", "step", "width")


@dataclass(frozen=True)
class Crossed:
    """A quantity's values and their analysis.

    Attributes
    ----------
    quantity : Quantity
    parts : list of str
    values : (parts, operators, trials) ndarray
        Complete.
    left_out : list of str
        Parts that some trial did not measure.
    study : GageStudy or None
        None with fewer than two complete parts.
    """

    quantity: Quantity
    parts: list[str]
    values: NDArray[np.float64]
    left_out: list[str]
    study: GageStudy | None


def crossed(values: Sequence[Value], quantity: Quantity, trials: int) -> Crossed:
    """Arrange values as a crossed study and analyse them."""
    features, _, measured = grid(values, quantity)
    table = measured.reshape(len(features), -1, trials)
    whole = np.atleast_1d(np.isfinite(table).all(axis=(1, 2)))
    parts = [name for name, complete in zip(features, whole.tolist(), strict=True) if complete]
    left_out = [name for name in features if name not in parts]
    table = table[whole]
    return Crossed(quantity, parts, table, left_out, gage_study(table) if len(parts) > 1 else None)


class Gage:
    """The block `gage`."""

    def __init__(self, asked: GageSpec, simulation: SimulationSpec, tolerance_mm: float) -> None:
        self._asked, self._tolerance = asked, tolerance_mm
        self.series: tuple[Series, ...] = (Series("GAGE", replace(simulation, repeats=asked.trials), (_RIG,)),)

    def sections(self, store: Store) -> list[Section]:
        """Variance components, %GRR and ndc of heights, steps and widths."""
        series = self.series[0]
        values = [
            *rivet_values(store, series, _RIG), *position_values(store, series, _RIG, self._asked.positions)
        ]  # fmt: skip
        quantities = [quantity for quantity in _QUANTITIES if any(v.quantity == quantity for v in values)]
        tables = [crossed(values, quantity, self._asked.trials) for quantity in quantities]
        left_out = sorted({name for table in tables for name in table.left_out})
        text = [
            conditions(series),
            f"Crossed study by analysis of variance (AIAG, MSA, 4th edition): parts are the rivets and "
            f"{self._asked.positions} positions of the seam, operators the {len(series.simulation.placements)} "
            f"placements of the rig, {self._asked.trials} trials each. %GRR of tolerance is 6 σ(GRR) over a tolerance "
            f"of {self._tolerance:g} mm; the parts' variation, on which %GRR of variation and ndc rest, is that of "
            "this simulated panel.",
        ]
        if left_out:
            text.append(f"Left out because a scan did not measure them: {', '.join(left_out)}.")
        return [
            Section(
                "Gage R&R", tuple(text),
                (self._results(tables), _analysis(tables), values_table("gage-values", values)),
                tuple(_operators(table) for table in tables if table.study), tuple(self._bars(tables)),
            ),
            coverage_section([*values, *station_values(store, series, _RIG)], "gage study"),
        ]  # fmt: skip

    def _results(self, tables: Sequence[Crossed]) -> Table:
        columns = (
            Column("quantity"), Column("parts", 0), Column("repeatability σ, µm", 2),
            Column("reproducibility σ, µm", 2), Column("GRR σ, µm", 2), Column("parts σ, µm", 2),
            Column("%GRR of tolerance", 2), Column("%GRR of variation", 2), Column("ndc", 0),
        )  # fmt: skip
        rows: list[list[Cell]] = []
        for table in tables:
            if (s := table.study) is not None:
                sigmas = [1000 * sigma for sigma in (s.repeatability, s.reproducibility, s.grr, s.parts)]
                # The tolerance is that of heights and steps.
                of_tolerance = None if table.quantity == "width" else s.percent_of_tolerance(self._tolerance)
                shares = [of_tolerance, s.percent_of_variation, s.distinct_categories]
                rows.append([table.quantity, len(table.parts), *sigmas, *shares])
        return Table("gage", "Variation", columns, rows)

    def _bars(self, tables: Sequence[Crossed]) -> list[Bar]:
        """Heights and steps; the tolerance is not that of widths."""
        return [
            Bar(f"%GRR of tolerance, {t.quantity}", t.study.percent_of_tolerance(self._tolerance), _GRR_PERCENT, "%")
            for t in tables
            if t.study and t.quantity != "width"
        ]


def _analysis(tables: Sequence[Crossed]) -> Table:
    columns = (
        Column("quantity"), Column("source"), Column("df", 0), Column("sum of squares, µm²", 2),
        Column("mean square, µm²", 2), Column("F", 2), Column("p", 4),
    )  # fmt: skip
    rows: list[list[Cell]] = []
    for table in tables:
        if table.study is None:
            continue
        for effect in table.study.effects:
            name = effect.name
            if table.study.pooled and name.startswith("parts ×"):
                name += " (not significant, pooled)"
            squares = [1e6 * effect.sum_of_squares, 1e6 * effect.mean_square]
            rows.append([table.quantity, name, effect.freedom, *squares, effect.f, effect.p_value])
    return Table("gage-anova", "Analysis of variance", columns, rows)


def _operators(table: Crossed) -> go.Figure:
    """Every value less its part's mean, by operator."""
    off = 1000 * (table.values - table.values.mean(axis=(1, 2), keepdims=True))
    trials = table.values.shape[2]
    figure = go.Figure(
        [
            go.Scatter(
                x=np.repeat(table.parts, trials),
                y=off[:, k].ravel(),
                mode="markers",
                name=f"placement {k + 1}",
                marker={"size": 5, "opacity": 0.7},
            )
            for k in range(off.shape[1])
        ]
    )
    return figure.update_layout(
        title=f"{table.quantity}: every value less its part's mean", yaxis_title="µm", height=320
    )
