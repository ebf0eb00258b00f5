"""Tables and figures of crossed gage studies, of simulated and of captured scans alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from flows.study.document import Cell, Column, Table
from metrology.gage import GageStudy, gage_study

_SCALE = 1000.0
"""Tables give lengths in µm."""


@dataclass(frozen=True)
class Crossed:
    """A quantity's values and their analysis."""

    quantity: str
    unit: str
    parts: list[str]
    values: NDArray[np.float64]
    """(parts, operators, trials): complete."""
    left_out: list[str]
    """Parts that some trial did not measure."""
    study: GageStudy | None
    """None with fewer than two complete parts."""

    @property
    def named(self) -> str:
        """The quantity, with its unit where µm are thousandths of something else than mm."""
        return self.quantity if self.unit == "mm" else f"{self.quantity} (0.001 {self.unit})"


def analysed(quantity: str, unit: str, names: Sequence[str], table: NDArray[np.float64]) -> Crossed:
    """Analyse the parts that every trial measured.

    Parameters
    ----------
    names : sequence of str
        Of the parts.
    table : (parts, operators, trials) ndarray
        NaN where a trial did not measure a part.
    """
    whole = np.atleast_1d(np.isfinite(table).all(axis=(1, 2)))
    parts = [name for name, complete in zip(names, whole.tolist(), strict=True) if complete]
    left_out = [name for name, complete in zip(names, whole.tolist(), strict=True) if not complete]
    study = gage_study(table[whole]) if len(parts) > 1 else None
    return Crossed(quantity, unit, parts, table[whole], left_out, study)


def variation_table(tables: Sequence[Crossed], tolerances: Mapping[str, float]) -> Table:
    """Standard deviations, %GRR and ndc of each quantity."""
    columns = (
        Column("quantity"), Column("parts", 0), Column("repeatability σ, µm", 2),
        Column("reproducibility σ, µm", 2), Column("GRR σ, µm", 2), Column("parts σ, µm", 2),
        Column("%GRR of tolerance", 2), Column("%GRR of variation", 2), Column("ndc", 0),
    )  # fmt: skip
    rows: list[list[Cell]] = []
    for table in tables:
        if (s := table.study) is not None:
            sigmas = [_SCALE * sigma for sigma in (s.repeatability, s.reproducibility, s.grr, s.parts)]
            tolerance = tolerances.get(table.quantity)
            of_tolerance = None if tolerance is None else s.percent_of_tolerance(tolerance)
            rows.append([table.named, len(table.parts), *sigmas, of_tolerance, s.percent_of_variation,
                         s.distinct_categories])  # fmt: skip
    return Table("gage", "Variation", columns, rows)


def analysis_table(tables: Sequence[Crossed]) -> Table:
    """The analysis of variance, line by line."""
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
            squares = [_SCALE**2 * square for square in (effect.sum_of_squares, effect.mean_square)]
            rows.append([table.named, name, effect.freedom, *squares, effect.f, effect.p_value])
    return Table("gage-anova", "Analysis of variance", columns, rows)


def operators_figure(table: Crossed, names: Sequence[str] = ()) -> go.Figure:
    """Every value less its part's mean, by operator."""
    off = _SCALE * (table.values - table.values.mean(axis=(1, 2), keepdims=True))
    trials = table.values.shape[2]
    figure = go.Figure(
        [
            go.Scatter(
                x=np.repeat(table.parts, trials),
                y=off[:, k].ravel(),
                mode="markers",
                name=names[k] if names else f"placement {k + 1}",
                marker={"size": 5, "opacity": 0.7},
            )
            for k in range(off.shape[1])
        ]
    )
    title = f"{table.quantity}: every value less its part's mean"
    return figure.update_layout(title=title, yaxis_title=f"0.001 {table.unit}", height=320)
