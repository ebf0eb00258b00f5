"""How many rivets are found, and how much that is none, against the contrast of their rings; U95 on those panels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import plotly.graph_objects as go

from flows.study.clutter import kinds_table
from flows.study.conditions import equipment
from flows.study.coverage import coverage_section
from flows.study.document import Cell, Column, Section, Table
from flows.study.series import RigKind, Series
from flows.study.spec import DetectionSpec
from flows.study.values import found_rivets, rivet_values
from simulator.random_clutter import Clutter
from simulator.random_panel import Variety, random_panel, random_placement
from simulator.spec import SimulationSpec
from simulator.truth import TrueRivet
from storage.archive import Store

_CLUTTER = (
    "Every panel carries letters, painted rings, stickers, grease pencil, chips and drops, open holes, "
    "temporary fasteners, recessed heads, dents and scratches. "
)
_RIG: RigKind = "calibrated"
_SKIN_LEVEL = 100.0  # grey level of the skin to which the rings' contrast refers


@dataclass(frozen=True)
class Counts:
    """Rivets in view, of them found, all that was found, and what of it is a rivet."""

    true: int
    found: int
    reported: int
    right: int

    def __add__(self, other: Counts) -> Counts:
        return Counts(
            self.true + other.true, self.found + other.found, self.reported + other.reported, self.right + other.right
        )

    @property
    def recall(self) -> float:
        """Share of the rivets that were found."""
        return self.found / self.true if self.true else np.nan

    @property
    def precision(self) -> float:
        """Share of what was found that is a rivet."""
        return self.right / self.reported if self.reported else np.nan


def count(trues: Sequence[TrueRivet], rows: Sequence[dict[str, Any]]) -> Counts:
    """Match in the left image: a row belongs to a rivet whose centre lies in the inner half of the row's ellipse.

    What a scan lists as unconfirmed is not reported as a rivet.
    """
    visible = np.array([true.visible for true in trues], bool)
    rows = [row for row in rows if row.get("decision") != "unconfirmed"]
    if not (trues and rows):
        return Counts(int(visible.sum()), 0, len(rows), 0)
    at = np.array([(row["u_px"], row["v_px"]) for row in rows])
    radius = np.array([row["minor_px"] for row in rows]) / 4
    near = np.linalg.norm(np.array([true.uv_px for true in trues])[:, None] - at, axis=2) < radius
    return Counts(int(visible.sum()), int(near.any(axis=1)[visible].sum()), len(rows), int(near.any(axis=0).sum()))


class Detection:
    """The block `detection`."""

    def __init__(self, asked: DetectionSpec, simulation: SimulationSpec) -> None:
        self._levels = asked.ring_levels
        self._clutter = asked.clutter
        self.series = tuple(
            Series(f"CONTRAST-{level:g}-{number + 1}", _simulation(asked, simulation, level, number), (_RIG,))
            for level in asked.ring_levels
            for number in range(asked.panels)
        )

    def sections(self, store: Store) -> list[Section]:
        """Recall and precision by contrast, and the coverage of U95 over all these panels."""
        panels = len(self.series) // len(self._levels)
        counts = []
        for k in range(len(self._levels)):
            total = Counts(0, 0, 0, 0)
            for series in self.series[k * panels : (k + 1) * panels]:
                for trues, found in found_rivets(store, series, _RIG):
                    total += count(trues, found)
            counts.append(total)
        recall, precision = [100 * c.recall for c in counts], [100 * c.precision for c in counts]
        rows: list[list[Cell]] = [
            [level, c.true, c.found, c.reported, r, p]
            for level, c, r, p in zip(self._levels, counts, recall, precision, strict=True)
        ]
        columns = (
            Column("ring contrast, grey levels", 0), Column("rivets in view", 0), Column("found", 0),
            Column("reported", 0), Column("recall, %", 1), Column("precision, %", 1),
        )  # fmt: skip
        figure = go.Figure(
            [
                go.Scatter(x=self._levels, y=recall, name="recall", mode="lines+markers"),
                go.Scatter(x=self._levels, y=precision, name="precision", mode="lines+markers"),
            ]
        )
        figure.update_layout(xaxis_title="contrast of the rings, grey levels", yaxis_title="%", height=340)
        figure.update_xaxes(type="log", tickvals=self._levels, ticktext=[f"{level:g}" for level in self._levels])
        values = [value for series in self.series for value in rivet_values(store, series, _RIG)]
        text = (
            f"Simulated: {panels} random panels of each contrast, one scan of each, inspected with the calibrated rig: "
            "heads of 4 to 12 mm with partly filled rings, slots, scratches, stickers and smudges, on skins of 0.9 m "
            f"radius and more, tilted up to 10°. {equipment(self.series[0].simulation)}",
            f"{_CLUTTER if self._clutter else ''}"
            "Contrast: how much darker a ring's middle is in the image than a skin of "
            f"{_SKIN_LEVEL:.0f} grey levels. A ring of the first contrast is hardly above the skin's own grain.",
        )
        tables = (Table("detection", "Rivets", columns, rows), kinds_table(store, self.series, _RIG))
        return [
            Section("Detection against contrast", text, tables, (figure,)),
            coverage_section(values, "random panels"),
        ]


def _simulation(asked: DetectionSpec, simulation: SimulationSpec, level: float, number: int) -> SimulationSpec:
    """A random panel; the same one for every contrast but for its rings."""
    rng = np.random.default_rng([asked.seed, number])
    placement = random_placement(rng)
    variety = Variety(ring_levels=(level, level), skin_level=_SKIN_LEVEL, reflectance=(0.6, 0.6))
    clutter = Clutter() if asked.clutter else None
    panel = random_panel(rng, variety, blur_px=simulation.camera.blur_px, clutter=clutter)
    scene = replace(simulation.scene, panel=f"RANDOM-{number + 1}")
    return replace(simulation, panel=panel, placements=(placement,), scene=scene, repeats=1, seed=asked.seed + number)
