"""A small rig and small scenes: a plane before two cameras, without the simulator."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from uuid import uuid4

import numpy as np
import pytest
from sqlalchemy import create_engine, text

from metrology.fringe import FringeCode
from metrology.results import SceneKey
from metrology.rig import Rig
from storage.archive.layout import STORE_FORMAT
from storage.scene import write_scene
from tests.support.postgres import programs, running_server
from tests.support.results import HEIGHT, WIDTH, small_key, small_rig


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


@pytest.fixture(scope="session")
def postgresql(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The beginning of URLs of a PostgreSQL database."""
    if programs() is None:
        pytest.skip("PostgreSQL's server is not installed (Debian: postgresql)")
    with running_server(tmp_path_factory.mktemp("postgresql")) as url:
        yield url


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.services)])
def reviewed_store(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """The folder of a store whose review log is in SQLite, and in PostgreSQL."""
    root = tmp_path / "store"
    root.mkdir()
    if request.param == "postgresql":
        url, schema = request.getfixturevalue("postgresql"), f"of_{uuid4().hex}"
        engine = create_engine(url)
        with engine.begin() as connection:
            connection.execute(text(f"CREATE SCHEMA {schema}"))
        engine.dispose()
        document = {"format": STORE_FORMAT, "reviews": f"{url}&options=-csearch_path%3D{schema}"}
        (root / "flushline-store.json").write_text(json.dumps(document))
    return root
