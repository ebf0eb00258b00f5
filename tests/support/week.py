"""A week of inspections: six aircraft, one panel that drifts, and a few findings."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from streamlit.testing.v1 import AppTest

from metrology.results import PanelKey, SceneKey
from storage.archive.panel_bundle import panel_document
from storage.archive.store import Store
from tasks.panel import assemble
from tests.support.synthetic_scene import Recipe, synthetic_result

ROOT = Path(__file__).parents[2]

FIRST_NIGHT = datetime(2026, 11, 14, 21, 15, tzinfo=UTC)
AIRCRAFT = [f"MSN-042{i}" for i in range(6)]
WORST_HEIGHT = 0.237
BEFORE = datetime(2026, 11, 9, 21, 0, tzinfo=UTC)
"""Before the week: scans that a test adds for itself, at a station of its own, leave other tests' lists as they are."""


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
    """Publish the week into a store, and put the last aircraft's panel together."""
    store = Store(root)
    for night in range(len(AIRCRAFT)):
        for station in ("S1", "S2"):
            store.publish(synthetic_result(recipe(night, station)))
    store.publish_panel(panel_document(assemble(store, PanelKey(AIRCRAFT[-1], "LH-F12"))))
    return root


def texts(page: AppTest) -> str:
    """Everything a page says in words."""
    kinds = ("markdown", "caption", "info", "warning", "error", "success", "subheader", "code")
    return "\n".join(str(element.value) for kind in kinds for element in getattr(page, kind))
