"""Which limits and which pattern a scene meets: what is given, what is in force in the store, what was enrolled."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metrology.cloud import PixelFlag, Reconstruction
from metrology.panel import NominalRivet, PanelLayout
from metrology.rig_health import RigHealth
from storage.archive import Store
from storage.panel_spec import PanelSpecification, load_panel_spec
from storage.scene import Scene
from tasks import steps
from tasks.loaded import LoadedScene
from tasks.settings import InspectionSettings
from tests.support.results import small_key, small_result

SPEC = """
format = "flushline-panel/1"
panel = "{panel}"
revision = "{revision}"
[zones.default.height_mm]
upper = 0.01
source = "DS-1"
revision = "A"
"""


def given(tmp_path: Path, panel: str = "LH-F12", revision: str = "A") -> Path:
    path = tmp_path / f"{panel}-{revision}.toml"
    path.write_text(SPEC.format(panel=panel, revision=revision))
    return path


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store")


@pytest.fixture
def loaded() -> LoadedScene:
    scene = Scene(Path("scene"), small_key(), "rig-a", None, None, (1.0,), (), (), None, None)  # type: ignore[arg-type]
    return LoadedScene(scene, small_result().reconstruction.rig)


def keep(first: steps.Registration, store: Store) -> None:
    """What publishing the scene does with the pattern that it enrols."""
    assert first.enrolled is not None
    store.prepare()
    assert store.panels.enrol(first.enrolled, small_key().panel, small_key().station, "first")


def run(loaded: LoadedScene, spec: PanelSpecification, store: Store) -> steps.Registration:
    """Three heads in different places of a small scene."""
    result = small_result()
    rng = np.random.default_rng(3)
    rivets = [
        replace(r, x_mm=x, y_mm=y, z_mm=700.0, u_px=32 + x / 7, v_px=24 + y / 7)
        for r, (x, y) in zip(result.features["rivet"], rng.uniform(-60, 60, (3, 2)), strict=True)
    ]
    return steps.register({"rivet": rivets}, result.reconstruction, loaded, spec, store, InspectionSettings())


def test_the_first_scan_of_a_station_enrols_it_and_the_next_is_recognised(loaded: LoadedScene, store: Store) -> None:
    first = run(loaded, load_panel_spec(), store)
    assert first.status == "enrolled"
    assert not store.root.exists()
    keep(first, store)
    assert store.panels.stations("LH-F12") == ["S3"]
    again = run(loaded, load_panel_spec(), store)
    assert again.status == "recognised"
    assert [r.rivet_id for r in again.rivets] == ["R1", "R2", "R3"]
    assert again.rms_mm == pytest.approx(0, abs=1e-3)
    store.check_usable()


def test_the_pattern_of_the_panels_specification_comes_first(loaded: LoadedScene, store: Store, tmp_path: Path) -> None:
    first = run(loaded, load_panel_spec(), store)
    keep(first, store)
    assert first.enrolled is not None
    spec = load_panel_spec(given(tmp_path))
    named = tuple(replace(r, rivet_id=f"DWG-{k}") for k, r in enumerate(first.enrolled.rivets))
    with_pattern = replace(spec, layout=replace(first.enrolled, rivets=named))
    assert [r.rivet_id for r in run(loaded, with_pattern, store).rivets] == ["DWG-0", "DWG-1", "DWG-2"]
    other = replace(with_pattern, limits=replace(spec.limits, panel="RH-F12"))
    assert [r.rivet_id for r in run(loaded, other, store).rivets] == ["R1", "R2", "R3"]


def test_a_scan_in_which_nothing_was_found_enrols_nothing(loaded: LoadedScene, store: Store) -> None:
    result = small_result()
    registered = steps.register({}, result.reconstruction, loaded, load_panel_spec(), store, InspectionSettings())
    assert registered.rivets == ()
    assert registered.status == "not enrolled"
    assert registered.enrolled is None
    assert "not enrolled as the panel's pattern, since no rivet and no seam was found" in registered.warnings[0]
    assert not store.root.exists()


def health(verdict: str) -> RigHealth:
    return RigHealth(0.06, 0.004, 200, 0.001, 400, verdict, None)  # type: ignore[arg-type]


def contradicting(reconstruction: Reconstruction, camera: str, share: float) -> Reconstruction:
    view = getattr(reconstruction, camera)
    flags = np.zeros_like(view.flags)
    flags[: round(share * len(flags))] = PixelFlag.ORDER_RESIDUAL
    return replace(reconstruction, **{camera: replace(view, flags=flags)})


@pytest.mark.parametrize("camera", ["left", "right"])
def test_a_scan_with_contradictory_fringes_enrols_nothing(loaded: LoadedScene, store: Store, camera: str) -> None:
    result = small_result()
    doubts = steps.doubts(loaded, contradicting(result.reconstruction, camera, 0.25), health("ok"))
    assert doubts == (f"25% of the {camera} camera's fringes contradict each other",)
    registered = steps.register(
        {"rivet": result.features["rivet"]},
        result.reconstruction,
        loaded,
        load_panel_spec(),
        store,
        InspectionSettings(),
        doubts,
    )
    assert (registered.status, registered.enrolled) == ("not enrolled", None)
    assert doubts[0] in registered.warnings[0]
    assert [rivet.rivet_id for rivet in registered.rivets] == ["R1", "R2", "R3"]


@pytest.mark.parametrize(("verdict", "count"), [("ok", 0), ("warning", 0), ("unjudged", 1)])
def test_a_scan_that_cannot_judge_its_rig_enrols_nothing(loaded: LoadedScene, verdict: str, count: int) -> None:
    reconstruction = contradicting(small_result().reconstruction, "left", 0.0)
    assert len(steps.doubts(loaded, reconstruction, health(verdict))) == count


def test_the_example_gives_way_to_what_is_in_force(store: Store, tmp_path: Path) -> None:
    panel, example = small_key().panel, load_panel_spec()
    assert steps.specification(example, panel, store).example
    store.prepare()
    store.panels.add(given(tmp_path, revision="B"))
    assert steps.specification(example, panel, store).limits.revision == "B"
    assert steps.specification(None, panel, store).limits.revision == "B"
    assert steps.specification(load_panel_spec(given(tmp_path, "X-1")), panel, store).limits.panel == "X-1"


def test_a_pattern_without_the_scans_rivets_leaves_their_names(
    loaded: LoadedScene, store: Store, tmp_path: Path
) -> None:
    spec = load_panel_spec(given(tmp_path))
    far = PanelLayout(tuple(NominalRivet(f"N{k}", (7.0 * k, k * k * 3.0, 0.0)) for k in range(6)))
    registered = run(loaded, replace(spec, layout=far), store)
    assert registered.status == "not recognised"
    assert [r.rivet_id for r in registered.rivets] == ["R1", "R2", "R3"]
