"""Seams drawn at random, alone or in pairs that cross."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from simulator.panel import Seam
from simulator.random_panel import Range


@dataclass(frozen=True)
class SeamVariety:
    """Within which bounds seams are drawn; pairs are (least, most).

    Attributes
    ----------
    direction_deg : float or None
        Of the course from +x; None: any.
    width_mm, step_mm, chamfer_mm, depth_mm : Range
    change : float
        How much width and step vary along a seam, relative to their bounds' span.
    bow_mm : float
        Largest rise of a curved course.
    filled : float
        Share of seams filled with sealant.
    floor_reflectance : Range
    """

    direction_deg: float | None = None
    width_mm: Range = (0.3, 5.0)
    step_mm: Range = (-1.0, 1.0)
    chamfer_mm: Range = (0.0, 0.6)
    depth_mm: Range = (1.5, 4.0)
    change: float = 0.08
    bow_mm: float = 2.0
    filled: float = 0.2
    floor_reflectance: Range = (0.15, 0.5)


def random_seam(
    rng: np.random.Generator, variety: SeamVariety | None = None, name: str = "J01",
    size_mm: tuple[float, float] = (290.0, 200.0), through: tuple[float, float] = (0.0, 0.0),
) -> Seam:  # fmt: skip
    """A seam across a whole panel through about a place."""
    variety = variety or SeamVariety()
    degrees = rng.uniform(0, 180) if variety.direction_deg is None else variety.direction_deg
    along = np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])
    left = np.array([-along[1], along[0]])
    # Far enough both ways to leave the panel.
    reach = 0.55 * math.hypot(*size_mm)
    bow = rng.uniform(-variety.bow_mm, variety.bow_mm)
    points = [np.array(through) + s * reach * along + bow * (0.5 - s * s) * left for s in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    filled = bool(rng.uniform() < variety.filled)
    width, step = (_varied(rng, bounds, variety.change) for bounds in (variety.width_mm, variety.step_mm))
    chamfer = 0.0 if filled else rng.uniform(*variety.chamfer_mm)
    return Seam(
        name, tuple((float(p[0]), float(p[1])) for p in points), tuple(float(max(w, 0.1)) for w in width),
        tuple(float(s) for s in step), chamfer_mm=chamfer, filled=filled,
        depth_mm=rng.uniform(0.0, 0.05) if filled else rng.uniform(*variety.depth_mm),
        floor_reflectance=rng.uniform(1.3, 1.8) if filled and rng.uniform() < 0.3
        else rng.uniform(*variety.floor_reflectance),
    )  # fmt: skip


def _varied(rng: np.random.Generator, bounds: Range, change: float) -> np.ndarray:
    """Five values about a mean that stay within the bounds."""
    span = change * (bounds[1] - bounds[0])
    values = rng.uniform(*bounds) + span * rng.uniform(-0.5, 0.5, 5)
    return np.asarray(np.clip(values, *bounds))


def crossing_seams(
    rng: np.random.Generator, joint: str = "cross", variety: SeamVariety | None = None
) -> tuple[Seam, ...]:
    """Two seams that cross ("cross"), or of which the second ends at the first ("T")."""
    turn = rng.uniform(-15, 15)
    first = random_seam(rng, _directed(variety, 90 + turn), "J01")
    second = random_seam(rng, _directed(variety, turn + rng.uniform(-15, 15)), "J02")
    if joint == "cross":
        return first, second
    points = second.points_mm[2:]
    return first, _with_points(second, points, first.id)


def _directed(variety: SeamVariety | None, degrees: float) -> SeamVariety:
    base = variety or SeamVariety()
    return SeamVariety(**{**base.__dict__, "direction_deg": degrees, "bow_mm": min(base.bow_mm, 0.5)})


def _with_points(seam: Seam, points: tuple[tuple[float, float], ...], starts_at: str) -> Seam:
    return Seam(**{**seam.__dict__, "points_mm": points, "starts_at": starts_at})
