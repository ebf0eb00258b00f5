"""A small rig and small scenes: a plane before two cameras, without the simulator."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from metrology.fringe import FringeCode
from metrology.results import SceneKey
from metrology.rig import Rig
from storage.scene import write_scene
from tests.storage.results import HEIGHT, WIDTH, small_key, small_rig


@pytest.fixture(scope="session")
def rig() -> Rig:
    return small_rig()


@pytest.fixture(scope="session")
def code() -> FringeCode:
    return FringeCode("x", 4, (7, 6, 5))


@pytest.fixture(scope="session")
def key() -> SceneKey:
    return small_key()


@pytest.fixture
def scene_folder(tmp_path: Path, rig: Rig, code: FringeCode, key: SceneKey) -> Path:
    """A complete scene folder of noise."""
    rng = np.random.default_rng(1)
    left, right = rng.integers(0, 200, (2, 1, code.frames, HEIGHT, WIDTH), np.uint8)
    folder = tmp_path / "scene"
    write_scene(folder, key, rig.id, code, [1.0], left, right)
    return folder
