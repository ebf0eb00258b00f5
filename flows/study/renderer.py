"""Rendering scans one by one: what many scans share is traced and lit once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from flows.study.series import real_rig
from metrology.arrays import Float32
from simulator.scene import Frames, Stage, expose, fringe_light, set_up
from simulator.spec import SimulationSpec


class Renderer:
    """Renders scans; keeps the last traced view and the last light, which most scans share with the one before."""

    def __init__(self) -> None:
        self._stage: tuple[Any, Stage] | None = None
        self._light: tuple[Any, dict[str, Float32]] | None = None

    def frames(
        self, simulation: SimulationSpec, placement: int, repeat: int, on_step: Callable[[str], None]
    ) -> dict[str, Frames]:
        """Both cameras' frames of one scan, the same as `simulator.scene.simulate` renders."""
        rng = np.random.default_rng([simulation.seed, 2, placement, repeat])
        light = self._fringes(simulation, placement, rng, on_step)
        on_step("exposing")
        return {side: expose(simulation, light[side], rng) for side in ("left", "right")}

    def _fringes(
        self, simulation: SimulationSpec, placement: int, rng: np.random.Generator, on_step: Callable[[str], None]
    ) -> dict[str, Float32]:
        view = _view_key(simulation, placement)
        if self._stage is None or self._stage[0] != view:
            on_step("tracing")
            self._stage = self._light = None  # before the next ones are made: each takes hundreds of megabytes
            rig = real_rig(simulation)
            self._stage = (view, set_up(simulation, rig, simulation.placements[placement]))
        shown = (view, simulation.fringe, simulation.projector, simulation.disturbances)
        # Only a shaking projector makes a difference between repeats before the sensor.
        if self._light is None or self._light[0] != shown or simulation.disturbances.shaken:
            self._light = (shown, fringe_light(simulation, self._stage[1], rng))
        return self._light[1]


def _view_key(simulation: SimulationSpec, placement: int) -> tuple[object, ...]:
    """What the traced views depend on."""
    camera = simulation.camera
    return (
        simulation.panel, simulation.light, simulation.rig, simulation.seed, simulation.placements[placement],
        simulation.disturbances.warming_k, camera.blur_px, camera.samples,
    )  # fmt: skip
