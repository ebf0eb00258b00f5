"""A small rig and small scenes: a plane before two cameras, without the simulator."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from metrology.fringe import FringeCode
from metrology.results import SceneKey
from metrology.rig import Device, Rig
from storage.scene import write_scene

WIDTH, HEIGHT = 64, 48


def device(width: int, height: int, x_mm: float = 0.0) -> Device:
    """A pinhole camera at x, looking along z."""
    K = np.array([[100.0, 0, width / 2], [0, 100.0, height / 2], [0, 0, 1]])
    return Device(width, height, K, np.zeros(5), np.eye(3), np.array([-x_mm, 0.0, 0.0]))


@pytest.fixture(scope="session")
def rig() -> Rig:
    return Rig(
        "rig-a",
        "2026-11-02T07:30:00Z",
        device(WIDTH, HEIGHT),
        device(WIDTH, HEIGHT, 50.0),
        device(40, 30, 25.0),
        {"residuals": {"left": 0.01}, "cameras": {"left": {"serial": "C-17"}}},
    )


@pytest.fixture(scope="session")
def code() -> FringeCode:
    return FringeCode("x", 4, (7, 6, 5))


@pytest.fixture(scope="session")
def key() -> SceneKey:
    return SceneKey("MSN-1", "LH-F12", "S3", datetime(2026, 11, 20, 8, 15, tzinfo=UTC))


@pytest.fixture
def scene_folder(tmp_path: Path, rig: Rig, code: FringeCode, key: SceneKey) -> Path:
    """A complete scene folder of noise."""
    rng = np.random.default_rng(1)
    left, right = rng.integers(0, 200, (2, 1, code.frames, HEIGHT, WIDTH), np.uint8)
    folder = tmp_path / "scene"
    write_scene(folder, key, rig.id, code, [1.0], left, right)
    return folder
