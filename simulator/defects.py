"""Defects of the skin itself as a specification gives them: dents, bumps, creases and scratches, with relief."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from simulator.require import Point, require

POINTED = 1.0 / (1.0 - math.sqrt(0.5))  # where (1 − ρ/r)² ends if it is a half at ρ = 1
STEEPEST = 1.0  # slope of a defect: rays meet a steeper one more than once


@dataclass(frozen=True)
class Dent:
    """A dent (or a bump) in the skin."""

    id: str
    x_mm: float
    y_mm: float
    """x_mm, y_mm: where its deepest point lies."""
    depth_mm: float
    """Along the skin's normal there, below the skin as it would be without; negative for a bump."""
    axes_mm: Point
    """Full length and width of its outline at half depth, in the tangent plane."""
    angle_deg: float = 0.0
    """Direction of the length from +x."""
    shape: Literal["smooth", "sharp", "crease"] = "smooth"
    """A cos² bowl that ends at twice its half-depth outline; one with a pointed bottom (1 − ρ/3.41)²; a fold along the
    length with that profile across it and cos² along it."""
    bottom_radius_mm: float = 2.0
    """Least radius of curvature to which a pointed bottom or a fold is rounded."""

    def __post_init__(self) -> None:
        where = f"dent {self.id}"
        require(self.shape in ("smooth", "sharp", "crease"), f"{where} shape", self.shape, "smooth, sharp or crease")
        require(0 < abs(self.depth_mm) <= 5, f"{where} depth_mm", self.depth_mm, "up to 5 mm either way, not 0")
        length, width = self.axes_mm
        require(
            0.5 <= width <= length <= 150,
            f"{where} axes_mm",
            self.axes_mm,
            "length, width: 0.5 to 150 mm, no wider than long",
        )
        require(self.bottom_radius_mm > 0, f"{where} bottom_radius_mm", self.bottom_radius_mm, "a positive length")
        require(self.steepest <= STEEPEST, f"{where} depth_mm", self.depth_mm, f"slopes of at most {STEEPEST:g}")

    @property
    def half_axes_mm(self) -> Point:
        """Half its length and half its width at half depth."""
        return 0.5 * self.axes_mm[0], 0.5 * self.axes_mm[1]

    @property
    def blunt(self) -> float:
        """By how much the point is rounded: ρ is replaced by √(s² ρ² + ε²) − ε; this is ε, and s² = 1 + 2 ε.

        The bottom's curvature is 2 |depth| s² / (r ε b²), b half the width; set equal to 1 / `bottom_radius_mm`.
        """
        if self.shape == "smooth":
            return 0.0
        width = self.half_axes_mm[1]
        return 1.0 / max(POINTED * width**2 / (2 * abs(self.depth_mm) * self.bottom_radius_mm) - 2.0, 0.1)

    @property
    def least_radius_mm(self) -> float:
        """Least radius of curvature of its bottom, the skin's own curvature left out."""
        width = self.half_axes_mm[1]
        if self.shape == "smooth":
            return 8 * width**2 / (math.pi**2 * abs(self.depth_mm))
        return POINTED * width**2 * self.blunt / (2 * abs(self.depth_mm) * (1 + 2 * self.blunt))

    @property
    def steepest(self) -> float:
        """Its greatest slope (of a point that is not rounded)."""
        rise = math.pi / 4 if self.shape == "smooth" else 2 * math.sqrt(1 + 2 * self.blunt) / POINTED
        return abs(self.depth_mm) / self.half_axes_mm[1] * rise

    @property
    def foot(self) -> Point:
        """Where it ends along its length and across, in half axes."""
        pointed = math.sqrt(((POINTED + self.blunt) ** 2 - self.blunt**2) / (1 + 2 * self.blunt))
        return {"smooth": (2.0, 2.0), "sharp": (pointed, pointed), "crease": (2.0, pointed)}[self.shape]


@dataclass(frozen=True)
class Gouge:
    """A straight scratch that has cut into the skin; its material may stand up along both sides."""

    id: str
    start_mm: Point
    end_mm: Point
    """start_mm, end_mm: (x, y): where its bottom has come up to half its depth."""
    width_mm: float
    """At half depth."""
    depth_mm: float
    lip_mm: float = 0.0
    """How high the edges stand."""
    contrast: float = 0.0
    """Reflectance of its ground relative to the skin's, less 1."""

    def __post_init__(self) -> None:
        where = f"gouge {self.id}"
        require(0.05 <= self.width_mm <= 5, f"{where} width_mm", self.width_mm, "0.05 to 5 mm")
        require(self.length_mm > 2 * self.width_mm, f"{where} length", self.length_mm, "over twice its width")
        require(0 < self.depth_mm <= 1, f"{where} depth_mm", self.depth_mm, "above 0, up to 1 mm")
        slope = max(self.depth_mm * math.pi / 4, self.lip_mm * math.pi / 2) / (0.5 * self.width_mm)
        require(slope <= STEEPEST, f"{where} depth_mm", self.depth_mm, f"slopes of at most {STEEPEST:g}")
        require(0 <= self.lip_mm <= 0.5, f"{where} lip_mm", self.lip_mm, "0 to 0.5 mm")

    @property
    def length_mm(self) -> float:
        """At half depth."""
        return math.hypot(self.end_mm[0] - self.start_mm[0], self.end_mm[1] - self.start_mm[1])

    @property
    def middle_mm(self) -> Point:
        """Half way."""
        return 0.5 * (self.start_mm[0] + self.end_mm[0]), 0.5 * (self.start_mm[1] + self.end_mm[1])


@dataclass(frozen=True)
class Hail:
    """A field of round smooth dents drawn at random, clear of each other."""

    seed: int = 1
    number: int = 20
    depth_mm: Point = (0.05, 0.3)
    diameter_mm: Point = (8.0, 16.0)
    """depth_mm, diameter_mm: (least, most): diameter at half depth."""
    centre_mm: Point = (0.0, 0.0)
    size_mm: Point = (250.0, 160.0)
    """centre_mm, size_mm: (x, y): the rectangle in which their centres lie."""

    def __post_init__(self) -> None:
        require(0 <= self.number <= 200, "hail number", self.number, "0 to 200")
        for name in ("depth_mm", "diameter_mm"):
            least, most = getattr(self, name)
            require(0 < least <= most, f"hail {name}", (least, most), "least and most, positive")

    def dents(self) -> tuple[Dent, ...]:
        """The dents; fewer than `number` where there is no room for more."""
        rng = np.random.default_rng(self.seed)
        found: list[Dent] = []
        for _ in range(50 * self.number):
            if len(found) == self.number:
                break
            x, y = (float(v) for v in np.array(self.centre_mm) + rng.uniform(-0.5, 0.5, 2) * self.size_mm)
            d, depth = float(rng.uniform(*self.diameter_mm)), float(rng.uniform(*self.depth_mm))
            if all(math.hypot(x - o.x_mm, y - o.y_mm) > d + o.axes_mm[0] for o in found):
                found.append(Dent(f"HAIL{len(found) + 1:02d}", x, y, depth, (d, d)))
        return tuple(found)
