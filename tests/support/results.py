"""Small results to store, without an inspection."""

from __future__ import annotations

import shutil
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from metrology.cloud import DecodedView, PixelFlag, Reconstruction
from metrology.inspection import InspectionResult
from metrology.overlay import Overlay
from metrology.results import Rivet, SceneKey, SeamStation
from metrology.rig import Device, Rig
from storage.archive.store import Store
from storage.rig import rig_document

WIDTH, HEIGHT = 64, 48


def device(width: int, height: int, x_mm: float = 0.0) -> Device:
    """A pinhole camera at x, looking along z."""
    K = np.array([[100.0, 0, width / 2], [0, 100.0, height / 2], [0, 0, 1]])
    return Device(width, height, K, np.zeros(5), np.eye(3), np.array([-x_mm, 0.0, 0.0]))


def small_rig() -> Rig:
    """Two cameras 50 mm apart and a projector between them, with keys that Flushline does not know."""
    return Rig(
        "rig-a",
        "2026-11-02T07:30:00Z",
        device(WIDTH, HEIGHT),
        device(WIDTH, HEIGHT, 50.0),
        device(40, 30, 25.0),
        {"residuals": {"left": 0.01}, "cameras": {"left": {"serial": "C-17"}}},
    )


def small_key(station: str = "S3", aircraft: str = "MSN-1", panel: str = "LH-F12") -> SceneKey:
    """A scene's key."""
    return SceneKey(aircraft, panel, station, datetime(2026, 11, 20, 8, 15, tzinfo=UTC))


def small_result(key: SceneKey | None = None, height_mm: float = 0.05, rivets: int = 3) -> InspectionResult:
    """A sloping plane with a hole, some rivets of one height and two seam positions, the second not measured."""
    rig = small_rig()
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    z = (700 + 0.1 * u).astype(np.float32)
    points = np.stack([(u - WIDTH / 2) / 100 * z, (v - HEIGHT / 2) / 100 * z, z], axis=-1).astype(np.float32)
    flags = np.zeros((HEIGHT, WIDTH), np.uint16)
    flags[:10, :5] = PixelFlag.UNMATCHED
    points[flags != 0] = np.nan
    sigma = np.where(flags == 0, np.float32(0.006), np.float32(np.nan))
    grey = np.full((HEIGHT, WIDTH), 90, np.float32)
    column = rig.projector.project(points)[..., 0].astype(np.float32)
    view = DecodedView(column, grey, grey, grey, flags)
    rivet = Rivet(
        "R1", x_mm=1.0, y_mm=2.0, z_mm=700.0, u_px=10.0, v_px=12.0, u_right_px=None, v_right_px=None,
        diameter_mm=8.0, major_px=20.0, minor_px=18.0, angle_deg=5.0, confidence=0.9,
    )  # fmt: skip
    measured = replace(
        rivet,
        height_mean_mm=height_mm,
        height_u95_mm=0.004,
        tilt_deg=0.3,
        tilt_u95_deg=0.05,
        severity="green",
        decision="pass",
    )
    station = SeamStation(
        "M1", 0.0, x_mm=1.0, y_mm=2.0, z_mm=700.0, u_px=10.0, v_px=12.0, step_mm=0.1, step_u95_mm=0.01,
        width_mm=2.4, width_u95_mm=0.05, n_left=90, n_right=95, severity="blue", decision="fail", reason="step",
    )  # fmt: skip
    unmeasured = SeamStation(
        "M1", 2.0, x_mm=None, y_mm=None, z_mm=None, u_px=11.0, v_px=13.0, decision="not measured",
        reason="over a rivet",
    )  # fmt: skip
    return InspectionResult(
        key=key or small_key(),
        reconstruction=Reconstruction(rig, view, view, points, sigma, flags),
        features={
            "rivet": tuple(replace(measured, rivet_id=f"R{i + 1}") for i in range(rivets)),
            "seam station": (station, unmeasured),
        },
        overlay=Overlay((40, 30), 24, (), ()),
        preview=np.full((HEIGHT, WIDTH), 90, np.uint8),
        rig_document=rig_document(rig),
        settings={"reconstruction": {"min_modulation": 3.0}},
        config_hash="c0ffee",
        panel_spec={"panel": "LH-F12", "revision": "B"},
        seconds={"load": 0.1, "total": 1.0},
        warnings=(),
        versions={"flushline": "0.1.0"},
    )


def copied(store: Store, folder: Path) -> Store:
    """A copy for one test of a store that several begin with: publishing takes longer."""
    return Store(Path(shutil.copytree(store.root, folder / "store", symlinks=True)))
