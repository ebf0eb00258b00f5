"""Panels drawn at random, for validation over many: rivets of all kinds, seams in all directions, clutter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from simulator.clutter import Cable, Patch, Scratch
from simulator.panel import Hole, Panel, Rivet, Seam, Skin, Slot, Surface
from simulator.random_clutter import Clutter, with_clutter
from simulator.spec import Placement

Range = tuple[float, float]


@dataclass(frozen=True)
class Variety:
    """Within which bounds panels are drawn; pairs are (least, most)."""

    size_mm: tuple[float, float] = (290.0, 200.0)
    """(width, height)."""
    radius_mm: Range = (900.0, math.inf)
    """Of curvature, drawn uniformly in 1/R, either sign with `concave`; inf is flat."""
    concave: bool = False
    rivets: tuple[int, int] = (10, 24)
    diameters_mm: tuple[float, ...] = (4.0, 4.8, 5.5, 6.4, 8.0, 9.5, 12.0)
    height_mm: Range = (-0.2, 0.25)
    tilt_deg: Range = (0.0, 0.7)
    crown_mm: Range = (0.0, 0.0)
    distance_diameters: float = 1.5
    """Least distance of two rivets' centres, in mean diameters."""
    ring_levels: Range = (6.0, 50.0)
    """Contrast of the rings in the image, grey levels (log-uniform), for a skin at `skin_level`."""
    skin_level: float = 100.0
    ring_width_mm: Range = (0.10, 0.30)
    partial_rings: float = 0.15
    slots: float = 0.1
    bright_rings: float = 0.0
    """partial_rings, slots, bright_rings: shares of rivets with a partly filled ring, a screw slot, a ring brighter
    than the skin."""
    scratches: tuple[int, int] = (0, 40)
    stickers: int = 2
    holes: int = 0
    smudges: int = 3
    cables: int = 0
    """stickers, holes, smudges, cables: int, at most so many."""
    reflectance: Range = (0.35, 0.6)
    specular: Range = (0.0, 0.5)


def ring_reflectance(levels: float, width_mm: float, skin_level: float, blur_px: float, pixel_mm: float) -> float:
    """Reflectance of a ring, relative to the skin's, that makes it `levels` grey levels darker at its middle.

    A bar of width w blurred by a Gaussian keeps erf(w / (2√2 σ)) of its contrast.
    """
    kept = float(erf(width_mm / (2 * math.sqrt(2) * blur_px * pixel_mm)))
    return max(0.0, 1.0 - levels / (skin_level * kept))


def random_skin(rng: np.random.Generator, variety: Variety) -> Skin:
    """A doubly curved skin."""
    least, most = (1 / variety.radius_mm[1], 1 / variety.radius_mm[0])
    curvatures = rng.uniform(least, most, 2) * (rng.choice([-1, 1], 2) if variety.concave else 1)
    radii = [1 / c if abs(c) > 1e-7 else math.inf for c in curvatures]
    return Skin(radii[0], radii[1], rng.uniform(0, 180))


def random_surface(rng: np.random.Generator, variety: Variety) -> Surface:
    """Brushing, blotches and clutter without relief."""
    width, height = variety.size_mm
    patches = [_patch(rng, variety, "smudge", -0.25, 0.15) for _ in range(rng.integers(0, variety.smudges + 1))]
    for _ in range(rng.integers(0, variety.stickers + 1)):
        patches.append(_patch(rng, variety, str(rng.choice(["rectangle", "disc"])), -0.5, 0.5))
    lines: tuple[Scratch, ...] = ()
    if variety.stickers and rng.uniform() < 0.5:
        # A painted line right across.
        y, lean = rng.uniform(-0.4, 0.4) * height, rng.uniform(-0.2, 0.2) * height
        lines = (Scratch((-width, y - lean), (width, y + lean), rng.uniform(0.5, 4.0), rng.uniform(-0.5, 0.3)),)
    return Surface(
        reflectance=rng.uniform(*variety.reflectance), specular=rng.uniform(*variety.specular),
        roughness=rng.uniform(0.3, 0.5), brushing=rng.uniform(0.005, 0.03), brushing_deg=rng.uniform(0, 180),
        streak_mm=rng.uniform(0.5, 4), blotches=rng.uniform(0.02, 0.12), blotch_mm=rng.uniform(15, 60),
        scratches=lines, patches=tuple(patches), random_scratches=int(rng.integers(*variety.scratches, endpoint=True)),
    )  # fmt: skip


def _patch(rng: np.random.Generator, variety: Variety, shape: str, least: float, most: float) -> Patch:
    width, height = variety.size_mm
    size = (rng.uniform(5, 40), rng.uniform(5, 25))
    if shape == "disc":
        size = (size[1], size[1])
    x, y = rng.uniform(-0.45, 0.45, 2) * (width, height)
    kinds = {"smudge": "smudge", "rectangle": "rectangle"}
    contrast = rng.uniform(least, most)
    return Patch(kinds.get(shape, "disc"), x, y, size, rng.uniform(0, 180), contrast)  # type: ignore[arg-type]


def random_panel(
    rng: np.random.Generator, variety: Variety | None = None, seams: tuple[Seam, ...] = (),
    blur_px: float = 0.75, pixel_mm: float = 0.2, clutter: Clutter | None = None,
) -> Panel:  # fmt: skip
    """A panel with rivets and clutter around the given seams.

    Parameters
    ----------
    blur_px, pixel_mm : float
        Camera blur and size of a pixel on the panel, to which the rings' contrast refers.
    clutter : Clutter, optional
        What a hall adds, drawn last: without it the panel is the same.
    """
    variety = variety or Variety()
    width, height = variety.size_mm
    places = Places(variety, seams)
    rivets = []
    for k in range(int(rng.integers(*variety.rivets, endpoint=True))):
        diameter = float(rng.choice(variety.diameters_mm))
        at = places.find(rng, diameter, variety.distance_diameters)
        if at is not None:
            rivets.append(_rivet(rng, variety, f"R{k + 1:02d}", at, diameter, blur_px, pixel_mm))
    holes = []
    for _ in range(int(rng.integers(0, variety.holes + 1))):
        diameter = rng.uniform(3, 9)
        at = places.find(rng, diameter, 2.0)
        if at is not None:
            holes.append(Hole(at[0], at[1], diameter, rng.uniform(0.5, 3), rng.uniform(0.05, 0.4)))
    cables = []
    for _ in range(int(rng.integers(0, variety.cables + 1))):
        angle = rng.uniform(0, math.pi)
        dx, dy, x, y = 150 * math.cos(angle), 150 * math.sin(angle), *rng.uniform(-0.3, 0.3, 2) * (width, height)
        cables.append(Cable(((x - dx, y - dy), (x + dx, y + dy)), rng.uniform(0.8, 2.5), rng.uniform(0.1, 0.5)))
    panel = Panel(
        width, height, random_skin(rng, variety), tuple(rivets), seams, tuple(holes), tuple(cables),
        random_surface(rng, variety),
    )  # fmt: skip
    return with_clutter(rng, panel, clutter, places.find) if clutter else panel


def _rivet(
    rng: np.random.Generator, variety: Variety, name: str, at: tuple[float, float], diameter: float,
    blur_px: float, pixel_mm: float,
) -> Rivet:  # fmt: skip
    ring = rng.uniform(*variety.ring_width_mm)
    levels = math.exp(rng.uniform(*np.log(variety.ring_levels)))
    reflectance = ring_reflectance(levels, ring, variety.skin_level, blur_px, pixel_mm)
    if rng.uniform() < variety.bright_rings:
        reflectance = 2.0 - reflectance
    arcs = None
    if rng.uniform() < variety.partial_rings:
        start, open_deg = rng.uniform(0, 360), rng.uniform(200, 320)
        arcs = ((start, start + open_deg),)
    slot = None
    if rng.uniform() < variety.slots and diameter > 4.5:
        slot = Slot(0.7 * diameter, rng.uniform(0.6, 1.2), rng.uniform(0.3, 0.8), rng.uniform(0, 180),
                    bool(rng.uniform() < 0.5))  # fmt: skip
    return Rivet(
        name, at[0], at[1], diameter, rng.uniform(*variety.height_mm), rng.uniform(*variety.tilt_deg),
        rng.uniform(0, 360), rng.uniform(*variety.crown_mm), ring,
        # A shallow ring takes its darkness from its reflectance alone.
        0.03, reflectance, rng.uniform(0.94, 1.06), arcs, slot,
    )  # fmt: skip


class Places:
    """Free places on a panel: clear of its border, of seams, and of what is there already."""

    def __init__(self, variety: Variety, seams: tuple[Seam, ...]) -> None:
        self._size = variety.size_mm
        self._seams = seams
        self._taken: list[tuple[float, float, float]] = []

    def take(self, x: float, y: float, diameter: float) -> None:
        """Something round stands there."""
        self._taken.append((x, y, diameter))

    def find(self, rng: np.random.Generator, diameter: float, distance: float) -> tuple[float, float] | None:
        """A place for something round; None where none was found in a hundred tries."""
        for _ in range(100):
            # All of the outer ring of the measurement, twice the radius, lies on the panel.
            x, y = (float(v) for v in rng.uniform(-0.5, 0.5, 2) * (np.array(self._size) - 2.2 * diameter))
            clear = all(math.hypot(x - a, y - b) > 0.5 * distance * (diameter + d) for a, b, d in self._taken) and all(
                _distance(seam, x, y) > 0.8 * diameter + max(seam.width_mm) + 1.5 for seam in self._seams
            )
            if clear:
                self.take(x, y, diameter)
                return x, y
        return None


def _distance(seam: Seam, x: float, y: float) -> float:
    """Distance from the straight pieces between a seam's points."""
    points = np.array(seam.points_mm, float)
    a, b = points[:-1], points[1:]
    along = b - a
    share = np.clip(np.sum(([x, y] - a) * along, axis=1) / np.sum(along**2, axis=1), 0, 1)
    return float(np.min(np.hypot(*(a + share[:, None] * along - [x, y]).T)))


def random_placement(rng: np.random.Generator, tilt_deg: float = 10.0, offset_mm: float = 10.0) -> Placement:
    """The panel a little turned and moved from where the rig looks."""
    turn, offset = rng.uniform(-tilt_deg, tilt_deg, 3), rng.uniform(-offset_mm, offset_mm, 3)
    return Placement((float(offset[0]), float(offset[1]), float(offset[2])),
                     (float(turn[0]), float(turn[1]), 0.3 * float(turn[2])))  # fmt: skip
