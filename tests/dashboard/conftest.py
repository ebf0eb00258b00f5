"""A store as a week of inspections leaves it: six aircraft, one panel that drifts, and a few findings."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import streamlit as st
from streamlit.testing.v1 import AppTest

from metrology.results import SceneKey
from storage.archive.store import Store

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))

from synthetic_scene import Recipe, synthetic_result  # noqa: E402

FIRST_NIGHT = datetime(2026, 11, 14, 21, 15, tzinfo=UTC)
AIRCRAFT = [f"MSN-042{i}" for i in range(6)]
WORST_HEIGHT = 0.237


def recipe(night: int, station: str, panel: str = "LH-F12") -> Recipe:
    """The scene of one station in one night; rivet R09 drifts upwards, R04 of the last night is the worst."""
    rng = np.random.default_rng([night, int(station[1:]), len(panel)])
    heights = 0.025 * rng.standard_normal(12)
    heights[8] = 0.08 + 0.012 * night
    last = night == len(AIRCRAFT) - 1
    if last and station == "S2":
        heights[3] = WORST_HEIGHT
    return Recipe(
        SceneKey(AIRCRAFT[night], panel, station, FIRST_NIGHT + timedelta(days=night, minutes=5 * int(station[1:]))),
        heights_mm=tuple(map(float, heights)),
        step_mm=0.08 if station == "S1" else 0.15,
        unmeasured=(5,) if last and station == "S1" else (),
        rig_id="rig-2026-11-02" if night < 3 else "rig-2026-11-17",
        version="0.1.0" if night < 5 else "0.2.0",
        size=(812, 617) if last else (406, 308),
        seed=night,
        warnings=("3 % of the pixels are saturated",) if (night, station) == (4, "S2") else (),
    )


def fill(root: Path) -> Path:
    """Publish the week into a store."""
    store = Store(root)
    for night in range(len(AIRCRAFT)):
        for station in ("S1", "S2"):
            store.publish(synthetic_result(recipe(night, station)))
    return root


@pytest.fixture(scope="session")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The week's store; do not write to it."""
    return fill(tmp_path_factory.mktemp("filled") / "store")


@pytest.fixture
def writable(filled: Path, tmp_path: Path) -> Path:
    """A copy to review in."""
    import shutil

    return Path(shutil.copytree(filled, tmp_path / "store", symlinks=True))


@pytest.fixture(autouse=True)
def _fresh_caches(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    for variable in ("FLUSHLINE_STORE", "FLUSHLINE_DASHBOARD_SETTINGS"):
        monkeypatch.delenv(variable, raising=False)
    yield
    st.cache_data.clear()
    st.cache_resource.clear()


def _page_script(name: str) -> None:
    from dashboard.app import PAGES

    PAGES[name][2]()


@pytest.fixture
def open_page(monkeypatch: pytest.MonkeyPatch) -> Callable[..., AppTest]:
    """Run a page on a store with query parameters."""

    def open_(name: str, root: Path, /, **parameters: Any) -> AppTest:
        monkeypatch.setenv("FLUSHLINE_STORE", str(root))
        page = AppTest.from_function(_page_script, kwargs={"name": name}, default_timeout=30)
        for key, value in parameters.items():
            page.query_params[key] = value
        return page.run()

    return open_


def texts(page: AppTest) -> str:
    """Everything a page says in words."""
    kinds = ("markdown", "caption", "info", "warning", "error", "success", "subheader", "code")
    return "\n".join(str(element.value) for kind in kinds for element in getattr(page, kind))
