"""What is to be simulated: a TOML file, validated, as frozen dataclasses."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Literal

from metrology.errors import SpecError
from metrology.fringe import FringeCode
from metrology.moments import moment_of
from simulator.balls import Ball
from simulator.board import PrintedBoard
from simulator.panel import Panel
from simulator.projection import Beamer
from simulator.rig import RigDesign
from simulator.sensor import Sensor
from simulator.tables import build

FORMAT = "flushline-simulation/1"


@dataclass(frozen=True)
class SceneKeys:
    """What scene.json says of the scans. `captured_at` is the first scan's; each later one is `interval_min` on."""

    aircraft_serial: str
    panel: str
    station: str
    captured_at: str
    operator: str | None = None
    interval_min: float = 5.0

    def __post_init__(self) -> None:
        for name in ("aircraft_serial", "panel", "station"):
            if not getattr(self, name):
                raise SpecError(f"{name}: found nothing, expected text")
        _check_moment("captured_at", self.captured_at)
        if self.interval_min <= 0:
            raise SpecError(f"interval_min: found {self.interval_min}, expected a positive number of minutes")


@dataclass(frozen=True)
class RigSpec:
    """The rig: its id, and a design from which the seed makes one built rig."""

    id: str = "rig-virtual"
    calibrated_at: str = "2026-11-01T08:00:00Z"
    seed: int = 1
    design: RigDesign = field(default_factory=RigDesign)

    def __post_init__(self) -> None:
        _check_moment("calibrated_at", self.calibrated_at)


@dataclass(frozen=True)
class Placement:
    """One placement of the panel before the rig."""

    offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """(x, y, z): in the panel's frame, from the point both cameras look at."""
    rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """(x, y, z): about the panel's own axes, applied in the order z, y, x of the turned frame."""
    station: str | None = None
    """The scene's own station if None."""

    def __post_init__(self) -> None:
        if max(abs(a) for a in self.rotation_deg[:2]) > 45:
            raise SpecError(f"rotation_deg: found {self.rotation_deg}, expected at most 45° about x and y")


@dataclass(frozen=True)
class Camera:
    """Both cameras' exposures, blur (standard deviation in px, pixel area included), rays near edges, and sensor."""

    exposures: tuple[float, ...] = (1.0,)
    blur_px: float = 0.75
    samples: int = 64
    sensor: Sensor = field(default_factory=Sensor)

    def __post_init__(self) -> None:
        if not self.exposures or min(self.exposures) <= 0:
            raise SpecError(f"exposures: found {list(self.exposures)}, expected positive numbers")
        if not 0.2 <= self.blur_px <= 5:
            raise SpecError(f"blur_px: found {self.blur_px}, expected 0.2 to 5")
        if not 4 <= self.samples <= 4096:
            raise SpecError(f"samples: found {self.samples}, expected 4 to 4096")


@dataclass(frozen=True)
class Lighting:
    """Light on the panel."""

    brightness: float = 300.0
    """Grey levels of a white matt surface that faces the projector at the rig's aim point, at exposure 1."""
    ambient: float = 25.0
    """Grey levels of a white matt surface in the ambient light alone."""
    wall_reflectance: float = 0.5
    """Of the walls of gaps, relative to the skin's."""

    def __post_init__(self) -> None:
        for name in ("brightness", "ambient", "wall_reflectance"):
            if getattr(self, name) < 0:
                raise SpecError(f"{name}: found {getattr(self, name)}, expected 0 or more")


@dataclass(frozen=True)
class Disturbances:
    """What goes wrong during a scan; all off by default."""

    vibration_px: float = 0.0
    """Standard deviation of the pattern's position from frame to frame, projector pixels."""
    ambient_drift: float = 0.0
    """Relative change of the ambient light from the first frame to the last."""
    warming_k: float = 0.0
    """By how much the rig's frame is warmer than when it was calibrated."""
    vibration_mm: float = 0.0
    """Standard deviation, along each axis, of the panel's place against the rig from frame to frame."""
    flicker: float = 0.0
    """Relative standard deviation of the projector's brightness from frame to frame."""

    def __post_init__(self) -> None:
        for name, most in (("vibration_px", 10.0), ("vibration_mm", 0.2), ("flicker", 0.3)):
            if not 0 <= getattr(self, name) <= most:
                raise SpecError(f"{name}: found {getattr(self, name)}, expected 0 to {most:g}")
        if abs(self.ambient_drift) > 1:
            raise SpecError(f"ambient_drift: found {self.ambient_drift}, expected −1 to 1")

    @property
    def shaken(self) -> bool:
        """Whether the light itself differs from scan to scan."""
        return bool(self.vibration_px or self.vibration_mm or self.flicker)


@dataclass(frozen=True)
class CalibrationSpec:
    """The capture with which the rig is to be calibrated, by the same cameras and projector as the scans."""

    show: Literal["dots", "fringes"] = "dots"
    """What the projector shows on the board beside white and black: a dot grid, or fringes in both axes."""
    poses: int = 9
    tilt_deg: float = 28.0
    """Largest tilt of the board."""
    depth_mm: float = 45.0
    """How far the poses reach before and behind the rig's aim point."""
    brightness: float = 210.0
    """Grey levels of white matt paper that faces the projector at the aim point."""
    board: PrintedBoard = field(default_factory=PrintedBoard)

    def __post_init__(self) -> None:
        if self.show not in ("dots", "fringes"):
            raise SpecError(f"show: found {self.show!r}, expected dots or fringes")
        if self.poses < 1:
            raise SpecError(f"poses: found {self.poses}, expected at least 1")
        if not 0 <= self.tilt_deg <= 45:
            raise SpecError(f"tilt_deg: found {self.tilt_deg}, expected 0 to 45")
        if self.brightness <= 0:
            raise SpecError(f"brightness: found {self.brightness}, expected a positive number of grey levels")


@dataclass(frozen=True)
class SimulationSpec:
    """Everything that determines a series of scans.

    `seed` governs texture and noise, `rig.seed` the rig; `repeats` is the number of scans of each placement.
    `calibration` asks for a calibration capture beside them. `spheres` stand before the rig in place of the panel, in
    its frame, `behind_mm` before a dark plate; their reflectance is that of the panel's surface.
    """

    format: Literal["flushline-simulation/1"]
    scene: SceneKeys
    panel: Panel = field(default_factory=Panel)
    rig: RigSpec = field(default_factory=RigSpec)
    placements: tuple[Placement, ...] = (Placement(),)
    fringe: FringeCode = field(default_factory=lambda: FringeCode("x", 4, (70, 64, 59)))
    camera: Camera = field(default_factory=Camera)
    projector: Beamer = field(default_factory=Beamer)
    light: Lighting = field(default_factory=Lighting)
    disturbances: Disturbances = field(default_factory=Disturbances)
    calibration: CalibrationSpec | None = None
    seed: int = 1
    repeats: int = 1
    spheres: tuple[Ball, ...] = ()
    behind_mm: float = 40.0

    def __post_init__(self) -> None:
        if self.repeats < 1:
            raise SpecError(f"repeats: found {self.repeats}, expected at least 1")
        if self.seed < 0 or self.rig.seed < 0:
            raise SpecError(f"seed: found {min(self.seed, self.rig.seed)}, expected 0 or more")
        if not self.placements:
            raise SpecError("placements: found none, expected at least one")


def _check_moment(name: str, text: str) -> None:
    try:
        moment_of(text)
    except ValueError as problem:
        raise SpecError(f"{name}: found {text!r}, expected {problem}") from None


def read_spec(path: Path) -> SimulationSpec:
    """A specification from a TOML file."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SpecError(f"{path}: found {error}, expected a readable TOML file") from error
    return parse_spec(text, str(path))


def shipped_spec(name: str) -> SimulationSpec:
    """One of the specifications that come with the simulator: demo, gage, skin or standard_part."""
    file = resources.files("simulator") / "specs" / f"{name}.toml"
    if not file.is_file():
        raise SpecError(f"simulation specification: found {name!r}, expected demo, gage, skin or standard_part")
    return parse_spec(file.read_text(encoding="utf-8"), f"{name}.toml")


def parse_spec(text: str, source: str) -> SimulationSpec:
    """A specification from TOML text; `source` names it in messages."""
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise SpecError(f"{source}: found {error}, expected TOML") from error
    try:
        return build(SimulationSpec, table, "")
    except SpecError as error:
        raise SpecError(f"{source}: {error}") from error
