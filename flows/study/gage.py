"""Gage R&R on simulated panels: rivets and seam positions are the parts, placements of the rig the operators."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from flows.study.conditions import conditions
from flows.study.coverage import coverage_section
from flows.study.document import Bar, Section
from flows.study.gage_tables import Crossed, analysed, analysis_table, operators_figure, variation_table
from flows.study.series import RigKind, Series
from flows.study.spec import GageSpec
from flows.study.values import Quantity, Value, grid, position_values, rivet_values, station_values
from flows.study.values_table import values_table
from simulator.spec import SimulationSpec
from storage.archive import Store

_RIG: RigKind = "calibrated"
_GRR_PERCENT = 10.0
_QUANTITIES: tuple[Quantity, ...] = ("height", "step", "width")


def crossed(values: Sequence[Value], quantity: Quantity, trials: int) -> Crossed:
    """Arrange values as a crossed study and analyse them."""
    features, _, measured = grid(values, quantity)
    return analysed(quantity, "mm", features, measured.reshape(len(features), -1, trials))


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
                (variation_table(tables, self._tolerances), analysis_table(tables),
                 values_table("gage-values", values)),
                tuple(operators_figure(table) for table in tables if table.study), tuple(self._bars(tables)),
            ),
            coverage_section([*values, *station_values(store, series, _RIG)], "gage study"),
        ]  # fmt: skip

    @property
    def _tolerances(self) -> dict[str, float]:
        """The tolerance is that of heights and steps."""
        return {"height": self._tolerance, "step": self._tolerance}

    def _bars(self, tables: Sequence[Crossed]) -> list[Bar]:
        """Heights and steps; the tolerance is not that of widths."""
        return [
            Bar(f"%GRR of tolerance, {t.quantity}", t.study.percent_of_tolerance(self._tolerance), _GRR_PERCENT, "%")
            for t in tables
            if t.study and t.quantity != "width"
        ]
