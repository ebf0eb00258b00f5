"""What lies on a simulated panel or is painted on it, beside its fasteners and seams. Panel frame; mm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from simulator.require import Point
from simulator.require import require as _require


@dataclass(frozen=True)
class Cleco:
    """A temporary fastener: a round body that stands far out of the skin, with its plunger on top."""

    x_mm: float
    y_mm: float
    diameter_mm: float = 8.0
    height_mm: float = 14.0
    plunger_mm: float = 4.0
    plunger_height_mm: float = 5.0
    reflectance: float = 0.6
    id: str = ""

    def __post_init__(self) -> None:
        _require(2 <= self.diameter_mm <= 20, "cleco diameter_mm", self.diameter_mm, "2 to 20 mm")
        _require(1 <= self.height_mm <= 22, "cleco height_mm", self.height_mm, "1 to 22 mm")
        _require(0 < self.plunger_mm < self.diameter_mm, "cleco plunger_mm", self.plunger_mm, "less than its diameter")
        _require(0 <= self.plunger_height_mm <= 10, "cleco plunger_height_mm", self.plunger_height_mm, "0 to 10 mm")


@dataclass(frozen=True)
class Speck:
    """A drill chip (flat, inclined) or a drop (`crown_mm`) that lies on the skin, without a ring."""

    x_mm: float
    y_mm: float
    diameter_mm: float
    height_mm: float = 0.1
    tilt_deg: float = 0.0
    tilt_azimuth_deg: float = 0.0
    crown_mm: float = 0.0
    reflectance: float = 1.5

    def __post_init__(self) -> None:
        _require(0.1 <= self.diameter_mm <= 15, "speck diameter_mm", self.diameter_mm, "0.1 to 15 mm")
        _require(0 < self.height_mm <= 3, "speck height_mm", self.height_mm, "above 0, up to 3 mm")
        _require(0 <= self.tilt_deg <= 30, "speck tilt_deg", self.tilt_deg, "0 to 30 degrees")
        _require(0 <= self.crown_mm <= self.diameter_mm / 4, "speck crown_mm", self.crown_mm, "0 to d/4")
        _require(0 <= self.reflectance <= 3, "speck reflectance", self.reflectance, "0 to 3")


@dataclass(frozen=True)
class Cable:
    """A cable lying on the skin: something long and dark that is no seam."""

    points_mm: tuple[Point, ...]
    diameter_mm: float = 2.0
    reflectance: float = 0.2

    def __post_init__(self) -> None:
        _require(len(self.points_mm) >= 2, "cable points_mm", self.points_mm, "at least two points")
        _require(0.2 <= self.diameter_mm <= 6, "cable diameter_mm", self.diameter_mm, "0.2 to 6 mm")


@dataclass(frozen=True)
class Bead:
    """A bead of sealant over whatever lies under its course: a seam, the edge of a lap (a fillet), a row of rivets.

    Its surface leads from the plates on one side to those on the other and bulges by `height_mm` between them.
    """

    points_mm: tuple[Point, ...]
    width_mm: float = 6.0
    height_mm: float = 0.5
    reflectance: float = 0.7

    def __post_init__(self) -> None:
        _require(len(self.points_mm) >= 2, "bead points_mm", self.points_mm, "at least two points")
        _require(1 <= self.width_mm <= 40, "bead width_mm", self.width_mm, "1 to 40 mm")
        _require(0 <= self.height_mm <= self.width_mm / 4, "bead height_mm", self.height_mm, "0 to a quarter width")


@dataclass(frozen=True)
class Scratch:
    """A scratch or a painted line: straight, without relief; `contrast` −1 … 1 darkens or brightens."""

    start_mm: Point
    end_mm: Point
    width_mm: float
    contrast: float


@dataclass(frozen=True)
class Patch:
    """A sticker (rectangle), a disc, a painted ring or a smudge (soft); `contrast` −1 … 1.

    `line_mm` is the width of a ring's line, `thickness_mm` how far the patch stands above the skin.
    """

    shape: Literal["rectangle", "disc", "smudge", "ring"]
    x_mm: float
    y_mm: float
    size_mm: Point
    angle_deg: float = 0.0
    contrast: float = -0.4
    line_mm: float = 1.0
    thickness_mm: float = 0.0

    def __post_init__(self) -> None:
        shapes = ("rectangle", "disc", "smudge", "ring")
        _require(self.shape in shapes, "patch shape", self.shape, "rectangle, disc, smudge or ring")
        _require(min(self.size_mm) > 0, "patch size_mm", self.size_mm, "two positive lengths")
        _require(self.line_mm > 0, "patch line_mm", self.line_mm, "a positive length")
        _require(0 <= self.thickness_mm <= 0.15, "patch thickness_mm", self.thickness_mm, "0 to 0.15 mm")
