"""Where the errors come from: each disturbance switched on alone, on a panel that is otherwise without fault."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import plotly.graph_objects as go

from flows.study.conditions import conditions
from flows.study.document import Cell, Column, Section, Table
from flows.study.series import RigKind, Series
from flows.study.spec import BudgetSpec
from flows.study.values import Quantity, Value, grid, rivet_values, station_values
from simulator.panel import Skin, Surface
from simulator.spec import Disturbances, SimulationSpec
from storage.archive import Store

_QUANTITIES: tuple[Quantity, ...] = ("height", "step", "width")


@dataclass(frozen=True)
class Condition:
    """One disturbance."""

    name: str
    meaning: str
    switch_on: Callable[[SimulationSpec], SimulationSpec]
    """Turns the faultless simulation into the disturbed one."""
    varies: bool = False
    """Whether scans differ from each other."""
    rig: RigKind = "true"


def faultless(simulation: SimulationSpec, asked: BudgetSpec) -> SimulationSpec:
    """The same panel flat and evenly grey, seen sharply and almost without noise, under a linear projector."""
    grey = Surface(simulation.panel.surface.reflectance, brushing=0.0, blotches=0.0)
    sensor = simulation.camera.sensor
    quiet = replace(sensor, gain=asked.quiet**2 * sensor.gain, read_noise=asked.quiet * sensor.read_noise, bits=16)
    return replace(
        simulation,
        panel=replace(simulation.panel, skin=Skin(), surface=grey),
        camera=replace(simulation.camera, blur_px=asked.sharp_blur_px, sensor=quiet),
        projector=replace(simulation.projector, gamma=1.0),
        disturbances=Disturbances(),
    )


def conditions_of(asked: BudgetSpec, simulation: SimulationSpec) -> tuple[Condition, ...]:
    """Nothing, each disturbance alone, and all of them."""

    def panel(s: SimulationSpec, **changes: object) -> SimulationSpec:
        return replace(s, panel=replace(s.panel, **changes))  # type: ignore[arg-type]

    def camera(s: SimulationSpec, **changes: object) -> SimulationSpec:
        return replace(s, camera=replace(s.camera, **changes))  # type: ignore[arg-type]

    def disturbed(s: SimulationSpec, **changes: float) -> SimulationSpec:
        return replace(s, disturbances=replace(s.disturbances, **changes))

    own = simulation
    single = (
        Condition("nothing", "none of the below: what matching and fitting leave", lambda s: s),
        Condition(
            "noise", f"shot and read-out noise, {own.camera.sensor.bits} bit",
            lambda s: camera(s, sensor=own.camera.sensor), varies=True,
        ),
        Condition("calibration", "the rig as a simulated calibration finds it", lambda s: s, rig="calibrated"),
        Condition("curvature", f"skin of {_radii(own)} mm radius", lambda s: panel(s, skin=own.panel.skin)),
        Condition(
            "edges", f"blur of {own.camera.blur_px:g} px instead of {asked.sharp_blur_px:g} mixes both sides of edges",
            lambda s: camera(s, blur_px=own.camera.blur_px),
        ),
        Condition("surface", "brushing, blotches, scratches, sheen", lambda s: panel(s, surface=own.panel.surface)),
        Condition(
            "gamma", f"projector gamma {asked.gamma:g}",
            lambda s: replace(s, projector=replace(s.projector, gamma=asked.gamma)),
        ),
        Condition(
            "vibration", f"the pattern {asked.vibration_px:g} projector px (sd) off in every frame",
            lambda s: disturbed(s, vibration_px=asked.vibration_px), varies=True,
        ),
        Condition(
            "ambient change", f"ambient light changes by {100 * asked.ambient_drift:.0f} % during the scan",
            lambda s: disturbed(s, ambient_drift=asked.ambient_drift),
        ),
        Condition(
            "temperature", f"rig {asked.warming_k:g} K warmer than when it was calibrated",
            lambda s: disturbed(s, warming_k=asked.warming_k),
        ),
    )  # fmt: skip

    def everything(s: SimulationSpec) -> SimulationSpec:
        for condition in single:
            s = condition.switch_on(s)
        return s

    return (*single, Condition("all", "all of them together", everything, varies=True, rig="calibrated"))


def _radii(simulation: SimulationSpec) -> str:
    skin = simulation.panel.skin
    return " and ".join(f"{radius:.0f}" for radius in (skin.radius_1_mm, skin.radius_2_mm) if math.isfinite(radius))


class Budget:
    """The block `budget`."""

    def __init__(self, asked: BudgetSpec, simulation: SimulationSpec) -> None:
        base = faultless(simulation, asked)
        self._quiet = asked.quiet
        self._conditions = conditions_of(asked, simulation)
        self.series = tuple(
            Series(
                f"BUDGET-{condition.name.replace(' ', '-').upper()}",
                replace(condition.switch_on(base), repeats=asked.scans if condition.varies else 1),
                (condition.rig,),
            )
            for condition in self._conditions
        )

    def sections(self, store: Store) -> list[Section]:
        """Errors of heights, steps and widths under each condition."""
        rows: list[list[Cell]] = []
        means: dict[Quantity, list[float]] = {quantity: [] for quantity in _QUANTITIES}
        for condition, series in zip(self._conditions, self.series, strict=True):
            values = [*rivet_values(store, series, condition.rig), *station_values(store, series, condition.rig)]
            row: list[Cell] = [condition.name, condition.meaning]
            for quantity in _QUANTITIES:
                mean, largest, sd = (1000 * figure for figure in error_figures(values, quantity))
                row += [mean, largest, sd] if quantity == "height" else [mean, largest]
                means[quantity].append(mean)
            rows.append(row)
        columns = [Column("switched on"), Column("meaning")]
        for quantity in _QUANTITIES:
            columns += [Column(name, 2, group=quantity) for name in ("mean |error|", "max |error|")]
            columns += [Column("sd", 2, group=quantity)] if quantity == "height" else []
        table = Table("budget", "Errors, µm", tuple(columns), rows)
        everything = self.series[-1]
        text = (
            f"{conditions(everything)} That is the last line. Above it each disturbance acts alone on the same panel "
            "made flat and evenly grey, seen sharply, under a linear projector, in 16 bit and with "
            f"{100 * self._quiet:.0f} % of the noise. Heights of all rivets, steps and widths at all stations of the "
            "seam, against the truth; sd between scans, where they differ.",
        )
        names = [condition.name for condition in self._conditions]
        figure = go.Figure([go.Bar(name=quantity, x=names, y=means[quantity]) for quantity in _QUANTITIES])
        figure.update_layout(title="Mean |error| with one disturbance", yaxis_title="µm", height=360, barmode="group")
        return [Section("Error budget", text, (table,), (figure,))]


def error_figures(values: Sequence[Value], quantity: Quantity) -> tuple[float, float, float]:
    """Mean and largest absolute error, and the standard deviation between scans, mm; NaN where there is none."""
    errors = np.array([value.error_mm for value in values if value.quantity == quantity])
    errors = np.abs(errors[np.isfinite(errors)])
    if not errors.size:
        return np.nan, np.nan, np.nan
    sd = np.nan
    if quantity == "height":
        _, _, measured = grid(values, quantity)
        whole = measured[np.isfinite(measured).all(axis=1)]
        if whole.shape[0] and whole.shape[1] > 1:
            sd = float(np.sqrt(np.mean(np.var(whole, axis=1, ddof=1))))
    return float(errors.mean()), float(errors.max()), sd
