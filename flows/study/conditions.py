"""Under which conditions a series was simulated, in a sentence."""

from __future__ import annotations

import math

from flows.study.series import Series
from simulator.spec import SimulationSpec


def conditions(series: Series) -> str:
    """Panel, rig, light and noise of a series."""
    s = series.simulation
    rigs = " and ".join(f"the {rig} rig" for rig in series.rigs)
    return (
        f"Simulated scans: {s.repeats} of each of {_count(len(s.placements), 'placement')}, inspected with {rigs}. "
        f"{_skin(s)}, {_count(len(s.panel.rivets), 'rivet')} and {_count(len(s.panel.seams), 'seam')}; "
        f"cameras {s.rig.design.camera_width} × {s.rig.design.camera_height} px, {s.camera.sensor.bits} bit, shot "
        f"noise of {s.camera.sensor.gain:g} grey levels per electron, read-out noise {s.camera.sensor.read_noise:g}, "
        f"blur {s.camera.blur_px:g} px; projector gamma {s.projector.gamma:g}; fringe counts "
        f"{'/'.join(str(n) for n in s.fringe.counts)} of {s.fringe.steps} steps."
    )


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"


def _skin(simulation: SimulationSpec) -> str:
    radii = (simulation.panel.skin.radius_1_mm, simulation.panel.skin.radius_2_mm)
    if all(math.isinf(radius) for radius in radii):
        return "Flat plate"
    return f"Skin of radii {radii[0]:.0f} and {radii[1]:.0f} mm"
