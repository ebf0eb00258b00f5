"""From a specification to rendered scenes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from metrology.arrays import Float32
from metrology.fringe import FringeCode
from metrology.moments import moment_of
from metrology.rig import Rig
from simulator.balls import trace_balls
from simulator.lens import moved
from simulator.pack import pack
from simulator.paint import paint
from simulator.projection import project_stripes, receive_stripes
from simulator.relief import Relief
from simulator.rig import aim_frame, virtual_rig, warmed
from simulator.shading import Light
from simulator.spec import Placement, SimulationSpec
from simulator.trace import Hits, ReflectanceMap, trace
from simulator.truth import Pose, Truth, truth
from simulator.vibration import moved_texture, sway_of

Frames = NDArray[np.uint8] | NDArray[np.uint16]
Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class SimulatedScene:
    """One rendered scan."""

    name: str
    """Unique within the specification; a folder name."""
    aircraft_serial: str
    panel: str
    station: str
    captured_at: str
    operator: str | None
    """aircraft_serial, panel, station, captured_at, operator: keys of scene.json."""
    rig: Rig
    """The calibration the scan is to be inspected with."""
    fringe: FringeCode
    exposures: tuple[float, ...]
    left: Frames
    right: Frames
    """left, right: (exposures, frames, h, w) uint8 or uint16."""
    pose: Pose
    truth: dict[str, Any]
    """As truth.json has it."""


@dataclass(frozen=True)
class Stage:
    """A panel set up before a rig: everything that does not depend on the projected image or the noise."""

    rig: Rig
    """As it really stands."""
    pose: Pose
    relief: Relief
    left: Hits
    right: Hits
    truth: Truth


def place(rig: Rig, placement: Placement) -> Pose:
    """Where the panel stands: facing the rig at its aim point, then turned and moved in its own frame."""
    R, t = aim_frame(rig)
    turn = Rotation.from_euler("xyz", placement.rotation_deg, degrees=True).as_matrix()
    return Pose(R @ turn, t + R @ np.array(placement.offset_mm))


def set_up(spec: SimulationSpec, rig: Rig, placement: Placement, progress: Progress | None = None) -> Stage:
    """Trace both cameras' views of the panel."""
    pose = place(rig, placement)
    relief = pack(spec.panel)
    reflectance = paint(spec.panel, np.random.default_rng([spec.seed, 1]))
    views = []
    for k, side in enumerate(("left", "right")):

        def report(done: float, k: int = k, side: str = side) -> None:
            if progress:
                progress(0.5 * (k + done), f"{side} camera: tracing")

        views.append(_view(spec, rig, side, pose, relief, reflectance, report))
    return Stage(rig, pose, relief, views[0], views[1], truth(spec.panel, relief, rig, pose))


def _view(
    spec: SimulationSpec, rig: Rig, side: str, pose: Pose, relief: Relief, reflectance: ReflectanceMap,
    progress: Callable[[float], None],
) -> Hits:  # fmt: skip
    lamp = rig.with_projector()
    light = Light(
        spec.light.brightness, float(np.linalg.norm(lamp.centre - aim_frame(rig)[1])), spec.light.ambient,
        spec.panel.surface.specular, spec.panel.surface.roughness, spec.panel.background_reflectance,
        spec.light.wall_reflectance,
    )  # fmt: skip
    camera, projector = moved(getattr(rig, side), pose.R, pose.t), moved(lamp, pose.R, pose.t)
    if spec.spheres:
        surface = spec.panel.surface.reflectance
        return trace_balls(spec.spheres, surface, spec.behind_mm, light, camera, projector, spec.camera.blur_px)
    return trace(relief, reflectance, light, camera, projector, spec.camera.blur_px, spec.camera.samples, progress)


def fringe_light(spec: SimulationSpec, stage: Stage, rng: np.random.Generator) -> dict[str, Float32]:
    """Light on both cameras in all fringe frames, (frames, h, w) grey levels at exposure 1, with the disturbances."""
    projector = stage.rig.with_projector()
    stripes = project_stripes(spec.fringe, projector.width, projector.height, spec.projector)
    shifts = rng.normal(0, 1, spec.fringe.frames) * spec.disturbances.vibration_px
    drift = np.linspace(-0.5, 0.5, spec.fringe.frames) * spec.disturbances.ambient_drift
    disturbances = spec.disturbances
    if disturbances.flicker:
        lamp = 1 + disturbances.flicker * rng.standard_normal(spec.fringe.frames)
        stripes = replace(stripes, light=stripes.light * lamp[:, None].astype(np.float32))
    moves = (
        disturbances.vibration_mm * rng.standard_normal((spec.fringe.frames, 3)) if disturbances.vibration_mm else None
    )
    light = {}
    for side in ("left", "right"):
        hits: Hits = getattr(stage, side)
        if moves is None:
            light[side] = receive_stripes(hits, stripes, shifts, 1 + drift)
        else:
            sway = sway_of(stage.rig, side, stage.pose, spec.fringe.axis)
            still = receive_stripes(hits, stripes, shifts + moves @ sway.pattern, 1 + drift)
            light[side] = moved_texture(still, hits, moves @ sway.image)
    return light


def expose(spec: SimulationSpec, light: Float32, rng: np.random.Generator) -> Frames:
    """(exposures, frames, h, w) what the sensor makes of (frames, h, w) light."""
    camera = spec.camera
    frames: Frames = np.stack(
        [np.stack([camera.sensor.capture(frame, exposure, rng) for frame in light]) for exposure in camera.exposures]
    )
    return frames


def _truth(spec: SimulationSpec, stage: Stage) -> dict[str, Any]:
    """The panel's truth; of spheres their centres in the rig frame and diameters."""
    if not spec.spheres:
        return stage.truth.as_dict()
    places = {ball.id: (stage.pose.R @ ball.centre + stage.pose.t).tolist() for ball in spec.spheres}
    spheres = [{"id": b.id, "xyz_mm": places[b.id], "diameter_mm": b.diameter_mm} for b in spec.spheres]
    return {"spheres": spheres}


def make_rig(spec: SimulationSpec) -> Rig:
    """The rig of a specification, as calibrated."""
    return virtual_rig(np.random.default_rng(spec.rig.seed), spec.rig.design, spec.rig.id, spec.rig.calibrated_at)


def simulate(
    spec: SimulationSpec, progress: Progress | None = None, rig: Rig | None = None
) -> Iterator[SimulatedScene]:
    """Render a specification's scenes one after the other: every placement, every repeat.

    Parameters
    ----------
    progress : callable, optional
        Called with the share done (0 … 1) and what is being done.
    rig : Rig, optional
        The rig in place of the one the specification describes.
    """
    rig = rig or make_rig(spec)
    scenes = len(spec.placements) * spec.repeats
    captured = moment_of(spec.scene.captured_at)
    done = 0
    for k, placement in enumerate(spec.placements):

        def report(share: float, what: str, done: int = done) -> None:
            if progress:
                progress((done + 0.9 * share) / scenes, what)

        stage = set_up(spec, warmed(rig, spec.disturbances.warming_k), placement, report)
        light: dict[str, Float32] | None = None
        for repeat in range(spec.repeats):
            rng = np.random.default_rng([spec.seed, 2, k, repeat])
            # Only a shaking projector makes a difference between repeats before the sensor.
            if light is None or spec.disturbances.shaken:
                light = fringe_light(spec, stage, rng)
            frames = {side: expose(spec, light[side], rng) for side in ("left", "right")}
            station = placement.station or spec.scene.station
            at = captured + timedelta(minutes=spec.scene.interval_min * done)
            done += 1
            if progress:
                progress(done / scenes, "frames")
            yield SimulatedScene(
                name=f"{station}-{at:%Y%m%dT%H%M%SZ}", aircraft_serial=spec.scene.aircraft_serial,
                panel=spec.scene.panel, station=station, captured_at=f"{at:%Y-%m-%dT%H:%M:%SZ}",
                operator=spec.scene.operator, rig=rig, fringe=spec.fringe, exposures=spec.camera.exposures,
                left=frames["left"], right=frames["right"], pose=stage.pose, truth=_truth(spec, stage),
            )  # fmt: skip
