"""What a hall adds to a random panel: letters and marks, chips and drops, holes and clecos, recesses, defects."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from simulator.clutter import Cleco, Patch, Speck
from simulator.defects import Dent, Gouge
from simulator.marks import Stencil, Stroke, letters_reach
from simulator.panel import Hole, Panel, Rivet, Slot

Find = Callable[[np.random.Generator, float, float], tuple[float, float] | None]
Range = tuple[float, float]
T = TypeVar("T")

_WORDS = (
    "LIFT HERE",
    "NO STEP",
    "STA 872",
    "RH-F11",
    "CUT HERE",
    "FUEL 08",
    "DO NOT DRILL",
    "P/N 4012-7",
    "INSP OK 36",
)


@dataclass(frozen=True)
class Clutter:
    """How much of each is drawn, (fewest, most)."""

    characters: int = 20
    """Stencilled letters and digits, at least so many in all."""
    rings: tuple[int, int] = (1, 3)
    stickers: tuple[int, int] = (1, 2)
    strokes: tuple[int, int] = (1, 4)
    specks: tuple[int, int] = (5, 20)
    gouges: tuple[int, int] = (0, 3)
    dents: tuple[int, int] = (0, 3)
    bumps: tuple[int, int] = (0, 1)
    creases: tuple[int, int] = (0, 1)
    holes: tuple[int, int] = (1, 2)
    clecos: tuple[int, int] = (0, 2)
    countersunk: float = 0.5
    recessed: float = 0.4
    """countersunk, recessed: shares of the holes and of the heads above 4.5 mm."""
    dent_depth_mm: Range = (0.05, 0.6)
    dent_axes_mm: Range = (10.0, 36.0)


def with_clutter(rng: np.random.Generator, panel: Panel, clutter: Clutter, find: Find) -> Panel:
    """The panel with clutter drawn onto it.

    Parameters
    ----------
    find : callable
        A free place for something round: generator, diameter, distance to others in mean diameters.
    """

    def number(bounds: tuple[int, int]) -> int:
        return int(rng.integers(*bounds, endpoint=True))

    holes = _placed(number(clutter.holes), lambda: _hole(rng, clutter, find))
    clecos = _placed(number(clutter.clecos), lambda: _cleco(rng, find))
    dents = [
        *_placed(number(clutter.dents), lambda: _dent(rng, clutter, find, 1.0, str(rng.choice(["smooth", "sharp"])))),
        *_placed(number(clutter.bumps), lambda: _dent(rng, clutter, find, -1.0, "smooth")),
        *_placed(number(clutter.creases), lambda: _dent(rng, clutter, find, 1.0, "crease")),
    ]
    rings = _placed(number(clutter.rings), lambda: _round_mark(rng, find, "ring"))
    stickers = _placed(number(clutter.stickers), lambda: _round_mark(rng, find, "disc"))
    surface = replace(
        panel.surface,
        patches=(*panel.surface.patches, *rings, *stickers),
        stencils=_stencils(rng, panel, clutter.characters),
        strokes=tuple(_stroke(rng, panel) for _ in range(number(clutter.strokes))),
    )
    return replace(
        panel,
        rivets=tuple(_recessed(rng, rivet, clutter.recessed) for rivet in panel.rivets),
        holes=(*panel.holes, *holes),
        clecos=tuple(clecos),
        dents=tuple(replace(dent, id=f"D{k:02d}") for k, dent in enumerate(dents, 1)),
        gouges=tuple(_gouge(rng, panel, f"G{k + 1:02d}") for k in range(number(clutter.gouges))),
        specks=tuple(_speck(rng, panel) for _ in range(number(clutter.specks))),
        surface=surface,
    )


def _placed(number: int, draw: Callable[[], T | None]) -> list[T]:
    return [item for item in (draw() for _ in range(number)) if item is not None]


def _hole(rng: np.random.Generator, clutter: Clutter, find: Find) -> Hole | None:
    bore = float(rng.uniform(3.0, 9.5))
    outer = bore * float(rng.uniform(1.4, 1.8)) if rng.uniform() < clutter.countersunk else 0.0
    at = find(rng, max(bore, outer), 2.0)
    if at is None:
        return None
    # Nothing behind the sheet, or another sheet.
    ground = 0.0 if rng.uniform() < 0.5 else float(rng.uniform(0.1, 0.6))
    return Hole(*at, bore, float(rng.uniform(3.0, 5.0)), ground, countersink_mm=outer)


def _cleco(rng: np.random.Generator, find: Find) -> Cleco | None:
    at = find(rng, 16.0, 2.5)
    return None if at is None else Cleco(*at, float(rng.uniform(6, 9)), float(rng.uniform(8, 18)))


def _dent(rng: np.random.Generator, clutter: Clutter, find: Find, sign: float, shape: str) -> Dent | None:
    length = float(rng.uniform(*clutter.dent_axes_mm))
    width = length * float(rng.uniform(0.35, 0.6) if shape == "crease" else rng.uniform(0.6, 1.0))
    at = find(rng, 1.6 * length, 1.0)
    depth = min(float(np.exp(rng.uniform(*np.log(clutter.dent_depth_mm)))), 0.25 * width)
    return None if at is None else Dent("D", *at, sign * depth, (length, width), float(rng.uniform(0, 180)), shape)  # type: ignore[arg-type]


def _round_mark(rng: np.random.Generator, find: Find, shape: str) -> Patch | None:
    size = float(rng.uniform(5, 16))
    at = find(rng, size, 1.2)
    if at is None:
        return None
    contrast = float(rng.choice([-1, 1]) * rng.uniform(0.3, 0.7))
    thickness = 0.02 if shape == "ring" else float(rng.uniform(0.05, 0.1))
    return Patch(shape, *at, (size, size), 0.0, contrast, float(rng.uniform(0.3, 1.2)), thickness)  # type: ignore[arg-type]


def _stencils(rng: np.random.Generator, panel: Panel, characters: int) -> tuple[Stencil, ...]:
    """Lines of letters clear of the rivets where there is room, with at least so many characters in all."""
    found: list[Stencil] = []
    while sum(len(s.text.replace(" ", "")) for s in found) < characters:
        text, cap = str(rng.choice(_WORDS)), float(rng.uniform(3.5, 10.0))
        contrast = float(rng.uniform(-0.85, -0.4) if rng.uniform() < 0.8 else rng.uniform(0.4, 0.9))
        for _ in range(60):
            x, y = (float(v) for v in rng.uniform(-0.5, 0.5, 2) * (0.8 * panel.width_mm, 0.9 * panel.height_mm))
            stencil = Stencil(text, x, y, cap, float(rng.choice([0.0, 90.0, 180.0]) + rng.normal(0, 2)), contrast,
                              float(rng.uniform(0.01, 0.05)), bool(rng.uniform() < 0.6))  # fmt: skip
            if all(_apart(stencil, rivet) for rivet in panel.rivets):
                break
        found.append(stencil)
    return tuple(found)


def _apart(stencil: Stencil, rivet: Rivet) -> bool:
    """Whether a line of letters leaves a rivet and a diameter around it alone."""
    angle = math.radians(stencil.angle_deg)
    dx, dy = rivet.x_mm - stencil.x_mm, rivet.y_mm - stencil.y_mm
    u, v = abs(math.cos(angle) * dx + math.sin(angle) * dy), abs(-math.sin(angle) * dx + math.cos(angle) * dy)
    return bool(u > letters_reach(stencil) + rivet.diameter_mm or v > 0.5 * stencil.cap_mm + rivet.diameter_mm)


def _stroke(rng: np.random.Generator, panel: Panel) -> Stroke:
    """A tick, a loop or a wavy line by hand."""
    x, y = rng.uniform(-0.4, 0.4, 2) * (panel.width_mm, panel.height_mm)
    size, turn, angle = rng.uniform(6, 20), rng.uniform(0, 6.5), rng.uniform(0, 2 * math.pi)
    t = np.linspace(0, 1, 24)
    points = np.stack(
        [x + size * np.cos(angle + turn * t) * (1 - 0.2 * t), y + size * np.sin(angle + turn * t)], axis=1
    )
    line = tuple((float(p), float(q)) for p, q in points + rng.normal(0, 0.15, points.shape))
    return Stroke(line, float(rng.uniform(0.8, 2.5)), float(rng.uniform(-0.6, -0.2)), float(rng.uniform(0.2, 0.6)))


def _gouge(rng: np.random.Generator, panel: Panel, name: str) -> Gouge:
    x, y = rng.uniform(-0.4, 0.4, 2) * (panel.width_mm, panel.height_mm)
    length, angle, width = rng.uniform(5, 40), rng.uniform(0, math.pi), float(rng.uniform(0.1, 0.8))
    dx, dy = 0.5 * length * math.cos(angle), 0.5 * length * math.sin(angle)
    depth = float(rng.uniform(0.05, 0.3)) * width
    ends = (float(x - dx), float(y - dy)), (float(x + dx), float(y + dy))
    return Gouge(name, *ends, width, depth, 0.3 * depth, float(rng.uniform(-0.3, 0.5)))


def _speck(rng: np.random.Generator, panel: Panel) -> Speck:
    """A drill chip, or now and then a drop."""
    x, y = (float(v) for v in rng.uniform(-0.48, 0.48, 2) * (panel.width_mm, panel.height_mm))
    if rng.uniform() < 0.2:
        size = float(rng.uniform(1.5, 6.0))
        return Speck(x, y, size, 0.02, crown_mm=0.1 * size, reflectance=float(rng.uniform(0.4, 1.2)))
    size, tilt = float(rng.uniform(0.3, 2.5)), float(rng.uniform(0, 12))
    rise = 0.5 * size * math.sin(math.radians(tilt)) + float(rng.uniform(0.02, 0.2))
    return Speck(x, y, size, rise, tilt, float(rng.uniform(0, 360)), 0.0, float(rng.uniform(0.4, 1.9)))


def _recessed(rng: np.random.Generator, rivet: Rivet, share: float) -> Rivet:
    if rivet.slot is not None or rivet.diameter_mm < 4.5 or rng.uniform() > share:
        return rivet
    shape, d = str(rng.choice(["cross", "torq-set", "hex"])), rivet.diameter_mm
    size, width = (0.45 * d, 0.45 * d) if shape == "hex" else (0.6 * d, 0.12 * d)
    return replace(rivet, slot=Slot(size, width, float(rng.uniform(0.3, 1.2)), float(rng.uniform(0, 180)), shape=shape))  # type: ignore[arg-type]
