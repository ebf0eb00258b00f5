"""A curved panel with heads and a seam, seen from stations: scans as the assembly takes them, with known placements."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from scipy.spatial.transform import Rotation

from metrology.arrays import Array
from metrology.assembly.scan import STRIDE, PanelScan, Skin
from metrology.kinds import RIVET, SEAM_STATION
from metrology.panel import NominalRivet, NominalSeam, PanelLayout, Placement
from metrology.registration.view import in_view
from metrology.results import Rivet, SceneKey, SeamStation
from metrology.rig import Device, Rig
from tests.support.rows import rivet_at, station_at

SIZE = (1216, 920)
DISTANCE = 700.0
FACING = np.diag([1.0, -1.0, -1.0])
HEAD_NOISE, VALUE_NOISE, POINT_NOISE = 0.008, 0.002, 0.006


def _device(width: int, height: int, f: float, yaw: float, centre: tuple[float, float, float]) -> Device:
    K = np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1.0]])
    R = Rotation.from_rotvec([0, yaw, 0]).as_matrix()
    return Device(width, height, K, np.zeros(5), R, -R @ np.array(centre))


RIG = Rig(
    "r", "2026-11-02T07:30:00Z", _device(*SIZE, 2490.0, 0.0, (0, 0, 0)), _device(*SIZE, 2490.0, 0.40, (290, 0, 60)),
    _device(1280, 800, 2500.0, 0.21, (150, -20, 20)),
)  # fmt: skip
_GRID = np.stack(np.meshgrid(np.arange(0, SIZE[0], STRIDE), np.arange(0, SIZE[1], STRIDE)), -1).astype(float)
_RAYS = RIG.left.rays(_GRID)


@dataclass(frozen=True)
class SimulatedPanel:
    """Heads (n, 2) with diameters and heights, a seam along x at y = 0 with a profile of steps, on a cylinder."""

    heads: Array
    diameters: Array
    heights: Array
    length: float
    profile: Array  # amplitudes, wave numbers, phases (3, k)
    radius: float = 1800.0

    @classmethod
    def made(
        cls, rng: np.random.Generator, columns: int, rows: tuple[float, ...], pitch: float = 50.0
    ) -> SimulatedPanel:
        """Rows of heads at a regular pitch, each with a small error of its place, and a seam."""
        x = (np.arange(columns) - (columns - 1) / 2) * pitch
        heads = np.stack(np.meshgrid(x, np.array(rows)), -1).reshape(-1, 2)
        n = len(heads)
        profile = np.stack([rng.uniform(0.03, 0.1, 4), rng.uniform(0.02, 0.12, 4), rng.uniform(0, 6.28, 4)])
        return cls(
            heads + rng.normal(0, 0.3, heads.shape), rng.choice([6.4, 8.0], n), rng.normal(0, 0.06, n),
            columns * pitch + 20, profile,
        )  # fmt: skip

    def lift(self, xy: Array) -> Array:
        """(…, 3) points of the skin."""
        return np.concatenate([xy, -0.5 * xy[..., 1:] ** 2 / self.radius], axis=-1)

    def step(self, x: Array) -> Array:
        """Of the seam, mm."""
        amplitude, wave, phase = self.profile[:, :, None]
        return np.asarray((amplitude * np.sin(wave * x + phase)).sum(0))

    @property
    def layout(self) -> PanelLayout:
        """Its pattern as a drawing has it, without the small errors of places."""
        rivets = tuple(
            NominalRivet(f"N{k:02d}", tuple(self.lift(np.round(xy / 5) * 5).tolist()), float(d), row=f"row {xy[1]:.0f}")
            for k, (xy, d) in enumerate(zip(self.heads, self.diameters, strict=True))
        )
        ends = self.lift(np.array([[-self.length / 2, 0.0], [self.length / 2, 0.0]]))
        return PanelLayout(rivets, (NominalSeam("J01", tuple(map(tuple, ends.tolist()))),))

    def seen(
        self, placement: Placement, station: str, rng: np.random.Generator, nominal: Placement | None = None,
        listed: bool = False, expected: Placement | None = None,
    ) -> PanelScan:  # fmt: skip
        """A scan of it."""
        skin = self._skin(placement, rng)
        key = SceneKey("MSN-1", "P", station, datetime(2026, 11, 20, 8, int(station[1:]), tzinfo=UTC))
        rivets = self._rivets(placement, rng, listed)
        seam, across = self._seam(placement, rng, "J01" if listed else "S01")
        return PanelScan(key, RIG, skin, {RIVET.name: rivets, SEAM_STATION.name: seam}, across, nominal, expected)

    def _skin(self, placement: Placement, rng: np.random.Generator) -> Skin:
        rays = _RAYS @ placement.R.T
        along = np.full(rays.shape[:2], DISTANCE)
        for _ in range(6):
            at = placement.t + along[..., None] * rays
            off = at[..., 2] + 0.5 * at[..., 1] ** 2 / self.radius
            along -= off / (rays[..., 2] + at[..., 1] / self.radius * rays[..., 1])
        along += rng.normal(0, POINT_NOISE, along.shape)
        points = (along[..., None] * _RAYS).astype(np.float32)
        on_panel = np.abs((placement.t + along[..., None] * rays)[..., 0]) < self.length / 2
        points[~on_panel] = np.nan
        return Skin(points, np.where(on_panel, POINT_NOISE, np.nan).astype(np.float32))

    def _rivets(self, placement: Placement, rng: np.random.Generator, listed: bool) -> list[Rivet]:
        places = placement.to_rig(self.lift(self.heads))
        rows = []
        for k in np.flatnonzero(in_view(RIG, places, self.diameters / 2)):
            pixel = RIG.left.project(places[k])
            place = places[k] + rng.normal(0, [HEAD_NOISE, HEAD_NOISE, HEAD_NOISE / 4])
            height = float(self.heights[k] + rng.normal(0, VALUE_NOISE))
            rows.append(
                rivet_at(
                    f"N{k:02d}" if listed else f"R{len(rows) + 1:02d}", place.tolist(), pixel.tolist(),
                    float(self.diameters[k]), float(self.diameters[k] * 2490 / DISTANCE),
                    height_mean_mm=height, height_u95_mm=2 * VALUE_NOISE, tilt_deg=0.3, tilt_u95_deg=0.2,
                )
            )  # fmt: skip
        return rows

    def _seam(
        self, placement: Placement, rng: np.random.Generator, name: str
    ) -> tuple[list[SeamStation], dict[tuple[str, float], Array]]:
        x = np.arange(-self.length / 2, self.length / 2, 2.0) + float(rng.uniform(0, 2))
        places = placement.to_rig(self.lift(np.column_stack([x, np.zeros_like(x)])))
        seen = in_view(RIG, places, 0.0)
        steps = self.step(x) + rng.normal(0, VALUE_NOISE, len(x))
        # Side A is the one at the smaller v: of a rig that is turned upside down, the other one.
        down = placement.R[1, 1] < 0
        across = placement.R.T @ np.array([0.0, -1.0 if down else 1.0, 0.0])
        rows = [
            station_at(
                name, round(2.0 * n, 5), places[k].tolist(), RIG.left.project(places[k]).tolist(),
                step_mm=float(steps[k] * (1 if down else -1)), step_u95_mm=2 * VALUE_NOISE,
                width_mm=2.0, width_u95_mm=0.05, joint="butt",
            )
            for n, k in enumerate(np.flatnonzero(seen))
        ]  # fmt: skip
        return rows, {(name, row.s_mm): across for row in rows}


def facing(
    x: float, y: float, rng: np.random.Generator, shift: float = 15.0, turn: float = 5.0
) -> tuple[Placement, Placement]:
    """Where a rig stands before (x, y), off by up to a shift and a turn, and where it should stand."""
    middle = np.array([x, y, -0.5 * y**2 / 1800.0])
    tilt = Rotation.from_rotvec([-y / 1800.0, 0, 0]).as_matrix()
    nominal = Placement(tilt @ FACING, middle + tilt @ np.array([0.0, 0.0, DISTANCE]))
    axis = rng.normal(size=3)
    R = Rotation.from_rotvec(np.radians(turn) * rng.uniform(0.2, 1) * axis / np.linalg.norm(axis)).as_matrix()
    about = middle + rng.uniform(-1, 1, 3) * shift / np.sqrt(3)
    return Placement(R @ nominal.R, R @ (nominal.t - middle) + about), nominal


def rigid_rms(found: Array, true: Array) -> tuple[float, float]:
    """RMS and greatest distance of points (n, 3) after one rigid fit, mm."""
    a, b = found.mean(0), true.mean(0)
    u, _, vt = np.linalg.svd((found - a).T @ (true - b))
    R = vt.T @ np.diag([1, 1, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
    away = np.linalg.norm((found - a) @ R.T + b - true, axis=1)
    return float(np.sqrt((away**2).mean())), float(away.max())
