"""Under which conditions a series was simulated, in words."""

from __future__ import annotations

import math

from flows.study.series import Series
from simulator.spec import SimulationSpec


def conditions(series: Series) -> str:
    """Scans, panel, rig and noise of a series."""
    s = series.simulation
    return (
        f"Simulated: {_count(s.repeats, 'scan')} from {_placements(len(s.placements))}, inspected with "
        f"{' and with '.join(f'the {rig} rig' for rig in series.rigs)}. {_skin(s)}, "
        f"{_count(len(s.panel.rivets), 'rivet')}, {_count(len(s.panel.seams), 'seam')}. {equipment(s)}"
    )


def equipment(simulation: SimulationSpec) -> str:
    """Cameras, projector and fringes."""
    design, camera, sensor = simulation.rig.design, simulation.camera, simulation.camera.sensor
    return (
        f"Cameras of {design.camera_width} × {design.camera_height} px and {sensor.bits} bit, shot noise of "
        f"{sensor.gain:g} grey levels per electron, read-out noise of {sensor.read_noise:g}, blur of "
        f"{camera.blur_px:g} px; projector gamma {simulation.projector.gamma:g}; fringe counts "
        f"{'/'.join(str(count) for count in simulation.fringe.counts)} in {simulation.fringe.steps} steps."
    )


def _placements(number: int) -> str:
    return "one placement" if number == 1 else f"each of {number} placements"


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"


def _skin(simulation: SimulationSpec) -> str:
    radii = (simulation.panel.skin.radius_1_mm, simulation.panel.skin.radius_2_mm)
    if all(math.isinf(radius) for radius in radii):
        return "Flat plate"
    return f"Skin of radii {radii[0]:.0f} and {radii[1]:.0f} mm"
