"""A small rig that sees what the full-size one sees, and panels to put before it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from metrology.fringe import FringeCode
from simulator.panel import Panel, Rivet, Seam, Skin, Surface
from simulator.rig import RigDesign
from simulator.scene import Stage, make_rig, set_up
from simulator.spec import Placement, RigSpec, SceneKeys, SimulationSpec

KEYS = SceneKeys("MSN-1", "P1", "S1", "2026-11-20T08:00:00Z")
SMALL = RigDesign(camera_width=260, camera_height=200, camera_focal_px=3640.0)


def small_spec(panel: Panel, **changes: object) -> SimulationSpec:
    """A specification for the small rig: 260 × 200 px at full resolution, about 50 × 40 mm of the panel."""
    values: dict[str, object] = {
        "format": "flushline-simulation/1", "scene": KEYS, "panel": panel, "rig": RigSpec(design=SMALL, seed=3),
        "placements": (Placement((0.0, 0.0, 0.0), (2.0, -3.0, 1.0)),), "fringe": FringeCode("x", 4, (70, 64, 59)),
    }  # fmt: skip
    return SimulationSpec(**{**values, **changes})  # type: ignore[arg-type]


@pytest.fixture(scope="session")
def make_spec() -> Callable[..., SimulationSpec]:
    """`small_spec`."""
    return small_spec


@pytest.fixture(scope="session")
def panel() -> Panel:
    """One of everything that has relief."""
    return Panel(
        skin=Skin(1500.0, 3000.0, 25.0),
        rivets=(
            Rivet("R1", -11.0, 8.0, 8.0, 0.12, 0.5, 40.0),
            Rivet("R2", -12.0, -8.0, 6.0, -0.08, 0.3, 200.0, crown_mm=0.2, arcs_deg=((20.0, 290.0),)),
        ),
        seams=(Seam("J1", ((5.0, -110.0), (7.0, 0.0), (4.0, 110.0)), (1.8, 2.2), (0.1, 0.3, 0.2), chamfer_mm=0.3),),
        surface=Surface(brushing=0.0, blotches=0.0),
    )


@pytest.fixture(scope="session")
def spec(panel: Panel) -> SimulationSpec:
    return small_spec(panel)


@pytest.fixture(scope="session")
def stage(spec: SimulationSpec) -> Stage:
    return set_up(spec, make_rig(spec), spec.placements[0])


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)
