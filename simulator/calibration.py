"""A simulated calibration capture: a board in several poses under white, dark and projected dots or fringes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from metrology.arrays import Float32
from metrology.errors import SpecError
from metrology.fringe import FringeCode
from metrology.rig import Device, Rig
from simulator.board import PrintedBoard, view_board
from simulator.projection import Beamer, Stripes, project_image, project_stripes, receive_image, receive_stripes
from simulator.relief import Floats
from simulator.rig import aim_frame
from simulator.scene import make_rig
from simulator.sensor import Sensor
from simulator.spec import CalibrationSpec, SimulationSpec
from simulator.truth import Pose

Picture = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True)
class DotGrid:
    """Projected dots, bright on black, at `origin_px + ((2c + r mod 2) s, r s)`; `markers` (row, col) are larger."""

    cols: int = 13
    rows: int = 16
    spacing_px: float = 48.0
    origin_px: tuple[float, float] = (40.0, 40.0)
    diameter_px: float = 24.0
    marker_diameter_px: float = 36.0
    markers: tuple[tuple[int, int], ...] = ((7, 6), (7, 7), (9, 6))

    def image(self, width: int, height: int) -> Floats:
        """(height, width) values in [0, 1], pixels on a rim by the share they cover."""
        picture = np.zeros((height, width))
        for r in range(self.rows):
            for c in range(self.cols):
                x = self.origin_px[0] + (2 * c + r % 2) * self.spacing_px
                y = self.origin_px[1] + r * self.spacing_px
                radius = (self.marker_diameter_px if (r, c) in self.markers else self.diameter_px) / 2
                _disc(picture, x, y, radius)
        return picture

    def as_dict(self) -> dict[str, Any]:
        """As calibration.json has it."""
        return {
            "type": "asymmetric_circles", "cols": self.cols, "rows": self.rows, "spacing_px": self.spacing_px,
            "origin_px": list(self.origin_px), "diameter_px": self.diameter_px,
            "marker_diameter_px": self.marker_diameter_px, "markers": [list(m) for m in self.markers],
        }  # fmt: skip


def _disc(picture: Floats, x: float, y: float, radius: float, fine: int = 8) -> None:
    """Add a disc, covered shares from fine × fine places per pixel."""
    u0, v0 = math.floor(x - radius - 1), math.floor(y - radius - 1)
    n = math.ceil(2 * radius + 4)
    at = (np.arange(n * fine) + 0.5) / fine - 0.5
    inside = np.hypot(at[None, :] + u0 - x, at[:, None] + v0 - y) < radius
    cover = inside.reshape(n, fine, n, fine).mean(axis=(1, 3))
    top, left = max(v0, 0), max(u0, 0)
    part = picture[top : v0 + n, left : u0 + n]
    part += cover[top - v0 : top - v0 + part.shape[0], left - u0 : left - u0 + part.shape[1]]


@dataclass(frozen=True)
class CaptureSettings:
    """How a calibration capture is made.

    Attributes
    ----------
    brightness, ambient, blur_px, samples
        As in `simulator.spec`.
    """

    poses: int = 9
    """Number of board poses."""
    tilt_deg: float = 28.0
    """Largest tilt of the board."""
    depth_mm: float = 45.0
    """How far the poses reach before and behind the rig's aim point."""
    turns_deg: tuple[float, ...] = (0.0,)
    """How the board is turned in its own plane: pose k by the (k mod n)-th, beside a few degrees."""
    fringe: FringeCode | None = None
    """Fringes along the projector's columns and rows instead of dots: its steps and counts for axis x; `rows_counts`
    for axis y."""
    rows_counts: tuple[int, ...] = (44, 40, 37)
    brightness: float = 210.0
    ambient: float = 22.0
    blur_px: float = 0.75
    samples: int = 48
    sensor: Sensor = field(default_factory=Sensor)
    projector: Beamer = field(default_factory=Beamer)


@dataclass(frozen=True)
class BoardPose:
    """One pose of the board: frames by camera and name, and where the board truly was (board frame to rig frame).

    `frames[side]` has "white", "dark" and "dots" (h, w), or in place of dots "fringes_x" and "fringes_y"
    (frames, h, w).
    """

    frames: dict[str, dict[str, Picture]]
    pose: Pose


@dataclass(frozen=True)
class CalibrationCapture:
    """What calibration.json says of a capture, the rig that made it, and its poses."""

    board: PrintedBoard
    dots: DotGrid | None
    fringe: tuple[FringeCode, FringeCode] | None
    rig: Rig
    poses: tuple[BoardPose, ...]


def board_poses(rig: Rig, board: PrintedBoard, settings: CaptureSettings, rng: np.random.Generator) -> list[Pose]:
    """Varied poses in which both cameras and the projector have the whole board in their fields."""
    R, aim = aim_frame(rig)
    # From the panel's axes (x right, y up, z out) to the board's (x right, y down, z in).
    facing = R @ np.diag([1.0, -1.0, -1.0])
    x0, x1, y0, y1 = board.corners_mm
    corners = np.array([[x0, y0, 0], [x1, y0, 0], [x0, y1, 0], [x1, y1, 0]]) - board.middle_mm
    poses: list[Pose] = []
    for _ in range(1000 * settings.poses):
        azimuth, tilt = rng.uniform(0, 2 * math.pi), math.radians(settings.tilt_deg) * math.sqrt(rng.uniform())
        lean = Rotation.from_rotvec(tilt * np.array([math.cos(azimuth), math.sin(azimuth), 0]))
        turn = math.radians(settings.turns_deg[len(poses) % len(settings.turns_deg)])
        roll = Rotation.from_rotvec([0, 0, turn + rng.normal(0, math.radians(8)) + math.pi * rng.integers(0, 2)])
        turned = facing @ (lean * roll).as_matrix()
        offset = facing @ np.array([*rng.uniform(-55, 55, 2), rng.uniform(-1, 1) * settings.depth_mm])
        pose = Pose(turned, aim + offset - turned @ board.middle_mm)
        points = pose.to_rig(corners + board.middle_mm)
        if all(d.inside(d.project(points)).all() for d in (rig.left, rig.with_right())) and _enough_light(rig, points):
            poses.append(pose)
            if len(poses) == settings.poses:
                return poses
    raise SpecError(
        f"board: found a paper of {x1 - x0:.0f} × {y1 - y0:.0f} mm, expected one that both cameras have in view"
    )


def _enough_light(rig: Rig, corners: Floats) -> bool:
    """Whether the projector's field covers the board but for a margin."""
    projector = rig.with_projector()
    uv = projector.project(corners)
    return bool((uv > -80).all() and (uv < np.array([projector.width, projector.height]) + 80).all())


def render_calibration(
    rig: Rig, rng: np.random.Generator, board: PrintedBoard | None = None, dots: DotGrid | None = None,
    settings: CaptureSettings | None = None, progress: Callable[[float, str], None] | None = None,
) -> CalibrationCapture:  # fmt: skip
    """A whole capture.

    Parameters
    ----------
    rig : Rig
        As it really is.
    rng : numpy.random.Generator
        Poses and noise.
    """
    board, settings = board or PrintedBoard(), settings or CaptureSettings()
    fringe = None
    if settings.fringe is not None:
        fringe = (settings.fringe, FringeCode("y", settings.fringe.steps, settings.rows_counts))
    else:
        dots = dots or DotGrid()
    # Blurring the projected images takes longer than looking at them: once for all poses.
    shown = _shown(rig.with_projector(), dots if fringe is None else None, fringe, settings.projector)
    poses = []
    for k, pose in enumerate(board_poses(rig, board, settings, rng)):
        poses.append(_shoot(rig, board, shown, settings, pose, rng))
        if progress:
            progress((k + 1) / settings.poses, f"board pose {k + 1} of {settings.poses}")
    return CalibrationCapture(board, dots if fringe is None else None, fringe, rig, tuple(poses))


def simulate_calibration(
    spec: SimulationSpec, rig: Rig | None = None, progress: Callable[[float, str], None] | None = None
) -> CalibrationCapture:
    """The capture that a specification's `calibration` asks for (its defaults if it has none).

    Parameters
    ----------
    rig : Rig, optional
        As it really is; the specification's own if None.
    progress : callable, optional
        Called with the share done (0 … 1) and what is being done.
    """
    asked = spec.calibration or CalibrationSpec()
    settings = CaptureSettings(
        poses=asked.poses, tilt_deg=asked.tilt_deg, depth_mm=asked.depth_mm, brightness=asked.brightness,
        fringe=FringeCode("x", spec.fringe.steps, spec.fringe.counts) if asked.show == "fringes" else None,
        ambient=spec.light.ambient, blur_px=spec.camera.blur_px, sensor=spec.camera.sensor, projector=spec.projector,
    )  # fmt: skip
    rng = np.random.default_rng([spec.seed, 3])
    return render_calibration(rig or make_rig(spec), rng, asked.board, settings=settings, progress=progress)


def _shown(
    projector: Device, dots: DotGrid | None, fringe: tuple[FringeCode, FringeCode] | None, beamer: Beamer
) -> dict[str, Float32 | Stripes]:
    """The light of each projected image by the name of its frames."""
    shape = (projector.height, projector.width)
    shown: dict[str, Float32 | Stripes] = {
        "white": project_image(np.ones(shape), beamer),
        "dark": project_image(np.zeros(shape), beamer),
    }
    if dots is not None:
        shown["dots"] = project_image(dots.image(projector.width, projector.height), beamer)
    for code in fringe or ():
        shown[f"fringes_{code.axis}"] = project_stripes(code, projector.width, projector.height, beamer)
    return shown


def _shoot(
    rig: Rig, board: PrintedBoard, shown: dict[str, Float32 | Stripes], settings: CaptureSettings, pose: Pose,
    rng: np.random.Generator,
) -> BoardPose:  # fmt: skip
    distance = float(np.linalg.norm(rig.with_projector().centre - aim_frame(rig)[1]))
    frames: dict[str, dict[str, Picture]] = {}
    for side in ("left", "right"):
        camera: Device = getattr(rig, side)
        hits = view_board(board, pose.R, pose.t, camera, rig.with_projector(), settings.brightness, distance,
                          settings.ambient, settings.blur_px, settings.samples)  # fmt: skip
        frames[side] = {
            name: _capture(receive_stripes(hits, light) if isinstance(light, Stripes) else receive_image(hits, light),
                           settings, rng)
            for name, light in shown.items()
        }  # fmt: skip
    return BoardPose(frames, pose)


def _capture(light: Float32, settings: CaptureSettings, rng: np.random.Generator) -> Picture:
    if light.ndim == 2:
        return settings.sensor.capture(light, 1.0, rng)
    return cast(Picture, np.stack([settings.sensor.capture(frame, 1.0, rng) for frame in light]))
