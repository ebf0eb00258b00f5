"""Planes that a user declares on captured scenes (`flushline-planes/1`, TOML), and how flat they were measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from flows.study.document import Cell, Column, Section, Table
from metrology.cloud import PixelFlag
from metrology.errors import SpecError
from metrology.flatness import Flatness, flatness
from simulator.tables import build
from storage.archive import Store
from storage.documents import check_format, read_toml

FORMAT = "flushline-planes/1"
_MOST_POINTS = 50_000  # a fit to more shows nothing new


@dataclass(frozen=True)
class Plane:
    """A part of the left image that shows something flat."""

    id: str
    region_px: tuple[int, int, int, int]
    """(u0, v0, u1, v1): columns and rows, the last ones included."""
    station: str | None = None
    """Scenes of this station only."""

    def __post_init__(self) -> None:
        u0, v0, u1, v1 = self.region_px
        if not (0 <= u0 < u1 and 0 <= v0 < v1):
            raise SpecError(f"region_px: found {list(self.region_px)}, expected [u0, v0, u1, v1] with u0 < u1, v0 < v1")


@dataclass(frozen=True)
class Planes:
    """Declared planes."""

    format: Literal["flushline-planes/1"]
    planes: tuple[Plane, ...]


def read_planes(path: Path) -> tuple[Plane, ...]:
    """Declared planes from a TOML file."""
    table = read_toml(path, SpecError)
    check_format(table, FORMAT, path, SpecError)
    try:
        return build(Planes, table, "").planes
    except SpecError as problem:
        raise SpecError(f"{path}: {problem}") from None


def _figures(found: Flatness | None) -> list[Cell]:
    if found is None:
        return [None] * 4
    return [1000 * found.rms_mm, 1000 * found.range_mm, 1000 * found.bow_mm, found.noise_ratio]


def planes_section(store: Store, planes: Sequence[Plane]) -> Section:
    """Flatness of every declared plane in every scene that shows it."""
    scenes = store.query("SELECT scene_id, station FROM scenes ORDER BY captured_at").to_pylist()
    rows: list[list[Cell]] = []
    for scene in scenes:
        asked = [plane for plane in planes if plane.station in (None, scene["station"])]
        if asked:
            cloud = store.load_cloud(scene["scene_id"])
            usable = np.isfinite(cloud.points[..., 2]) & (cloud.flags & PixelFlag.EDGE == 0)
        for plane in asked:
            u0, v0, u1, v1 = plane.region_px
            part = np.s_[v0 : v1 + 1, u0 : u1 + 1]
            points, sigma = cloud.points[part][usable[part]], cloud.sigma_z[part][usable[part]]
            thin = max(1, len(points) // _MOST_POINTS)
            found = flatness(points[::thin], sigma[::thin], np.random.default_rng(0))
            rows.append([plane.id, scene["scene_id"], len(points), *_figures(found)])
    columns = (
        Column("plane"), Column("scene"), Column("points", 0), Column("rms, µm", 1), Column("99 % range, µm", 1),
        Column("bow, µm", 1), Column("scatter / stated σ", 2),
    )  # fmt: skip
    text = (
        "Points of a declared part of the left image, clear of edges, against the plane through them. Bow: largest "
        "less smallest departure of a quadric from the plane; it holds the part's own bow as well as the rig's. The "
        "last column compares the points' scatter about the quadric with the noise that the reconstruction states.",
    )
    return Section("Flatness of declared planes", text, (Table("planes", "Planes", columns, rows),))
