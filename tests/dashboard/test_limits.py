"""Trends and capability by the limits that each value was judged by, from the specification in its run's bundle."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from streamlit.testing.v1 import AppTest

from dashboard.data import Archive
from dashboard.findings import Selection
from dashboard.scenes import find_feature, load_features, load_scene_row, requirements
from dashboard.standard import standard_of
from dashboard.trends import QUANTITIES, Subject, capability_of, layout, limit_groups, series, spread
from metrology.kinds import RIVET, SEAM_STATION
from metrology.statistics import capability
from metrology.tolerance import judge
from storage.archive.store import Store
from storage.panel_spec import load_panel_spec, panel_spec_from
from storage.review import Feature
from tests.support.synthetic_scene import synthetic_result
from tests.support.week import recipe, texts

NOSE = 0.04
SOURCE = {"source": "DS-9", "revision": "A"}
ZONES = {
    "nose": {"height_mm": {"lower": -NOSE, "upper": NOSE, **SOURCE}},
    "lee": {"step_into_wind_mm": {"upper": 0.05, **SOURCE}, "step_out_of_wind_mm": {"upper": 0.15, **SOURCE}},
}


def by_zones(night: int, revision: str = "B", zones: dict[str, Any] = ZONES) -> Any:
    """A night's scan of S1, judged by a specification with zones: R04 is in the nose, the seam in the lee."""
    document = deepcopy(dict(load_panel_spec().document))
    document |= {"panel": "LH-F12", "revision": revision, "zones": {**document["zones"], **zones}}
    del document["zones"]["default"]["step_mm"]
    made = synthetic_result(recipe(night, "S1"))
    spec = panel_spec_from(document, Path("spec.toml"))
    rivets = [replace(r, zone="nose" if r.rivet_id == "R04" else "default") for r in made.features["rivet"]]
    stations = [replace(s, zone="lee", step_into_wind_mm=-s.step_mm) for s in made.features["seam station"]]
    return replace(
        made,
        features={
            "rivet": judge(RIVET, rivets, spec.limits),
            "seam station": judge(SEAM_STATION, stations, spec.limits),
        },
        panel_spec=document,
        config_hash=f"zones-{revision}",
    )


@pytest.fixture(scope="module")
def zoned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    store = Store(tmp_path_factory.mktemp("zoned") / "store")
    for night in range(5):
        store.publish(by_zones(night))
    # What is in force today is nobody's business here.
    return store.root


def shown(archive: Archive, subject: Subject, quantity: str):
    about = QUANTITIES[quantity]
    groups = limit_groups(archive, subject, about, Selection())
    standard = standard_of(groups)
    rows = series(archive, subject, about, Selection(), standard)
    values = spread(archive, subject, about, Selection(), standard)
    assert values is not None
    return standard, rows, values, capability_of(subject, rows, values, standard.limit)


def test_a_rivet_s_capability_is_that_of_its_zone(zoned: Path) -> None:
    standard, rows, _, found = shown(Archive(zoned), Subject("rivet", "LH-F12", "S1", "R04"), "height")
    assert not standard.relative
    assert standard.note == ""
    assert (standard.limit.lower, standard.limit.upper, standard.limit.source) == (-NOSE, NOSE, "DS-9")
    right, default = (capability(rows["value"], -limit, limit) for limit in (NOSE, 0.1))
    assert found.cpk.value == pytest.approx(right.cpk.value)
    assert found.cpk.value < 0.6 * default.cpk.value


def test_features_with_different_limits_are_relative_to_their_own(zoned: Path) -> None:
    archive = Archive(zoned)
    standard, _, values, found = shown(archive, Subject("panel", "LH-F12"), "height")
    heights = archive.rows("SELECT height_mean_mm AS h, zone FROM rivets WHERE height_mean_mm IS NOT NULL")
    own = np.where(heights["zone"] == "nose", NOSE, 0.1)
    relative = (heights["h"] / own).to_numpy()
    assert standard.relative
    assert "judged by different limits (-0.040 … +0.040; -0.100 … +0.100)" in standard.note
    assert (standard.limit.lower, standard.limit.upper) == (-1.0, 1.0)
    assert (values.n, values.mean, values.sd) == pytest.approx((len(relative), relative.mean(), relative.std(ddof=1)))
    assert found.ppk.value == pytest.approx(capability(relative, -1, 1, ordered=False).ppk.value)
    places = layout(archive, "LH-F12", QUANTITIES["height"], Selection(), standard).set_index("name")
    nose = heights["h"][heights["zone"] == "nose"].mean() / NOSE
    assert places.loc["R04", "mean"] == pytest.approx(nose)


def test_a_revision_that_changed_the_limits_is_said(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    for night in range(4):
        tighter = {"nose": {"height_mm": {"lower": -0.02, "upper": 0.02, **SOURCE}}}
        store.publish(by_zones(night, "B") if night < 2 else by_zones(night, "C", {**ZONES, **tighter}))
    standard, rows, _, _ = shown(Archive(store.root), Subject("rivet", "LH-F12", "S1", "R04"), "height")
    heights = Archive(store.root).rows("SELECT height_mean_mm FROM rivets WHERE rivet_id = 'R04' ORDER BY captured_at")
    assert standard.relative
    assert list(rows["value"]) == pytest.approx(list(heights["height_mean_mm"] / [NOSE, NOSE, 0.02, 0.02]))


def test_a_seam_s_limits_are_those_by_wind(zoned: Path) -> None:
    archive = Archive(zoned)
    standard, _, _, _ = shown(archive, Subject("seam", "LH-F12", "S1", "M1"), "step")
    # Side B stands higher and lies upstream: steps fall out of the wind by up to 0.15.
    assert not standard.relative
    assert (standard.limit.lower, standard.limit.upper) == (-0.05, 0.15)


def test_a_close_up_shows_the_limits_of_the_verdict(zoned: Path) -> None:
    archive = Archive(zoned)
    row = load_scene_row(archive, "MSN-0424~LH-F12~S1~20261118T212000Z")
    features = load_features(archive, row)
    for station in features["seam station"].itertuples():
        chosen = Feature("seam station", station.feature_id)
        required = requirements(archive, row.bundle_path, chosen, station)
        limited = {r.name: r.limit for r in required if r.limit}
        assert set(limited) == {"step into the wind", "width"}
        assert (limited["step into the wind"].lower, limited["step into the wind"].upper) == (-0.15, 0.05)
        told = [r.limit.decision(r.value, r.u95) for r in required if r.limit]
        assert station.decision in told
    nose = find_feature(features, Feature("rivet", "R04"))
    limits = [r.limit.upper for r in requirements(archive, row.bundle_path, Feature("rivet", "R04"), nose)]
    assert limits == [NOSE, 1.0]  # its zone's height, the default's tilt


def test_runs_whose_limits_cannot_be_read_say_so(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    for night in (0, 1):
        result = synthetic_result(recipe(night, "S1"))
        store.publish(replace(result, panel_spec={"of": "another version"}, config_hash="old") if night else result)
    standard, rows, values, _ = shown(Archive(store.root), Subject("panel", "LH-F12"), "height")
    assert standard.relative
    assert "left out" in standard.note
    assert len(rows) == 1
    assert values.n == rows["n"].sum()


def test_the_page_says_by_what_it_holds_values(zoned: Path, open_page: Callable[..., AppTest]) -> None:
    page = open_page("trends", zoned, what="panel", panel="LH-F12", quantity="height")
    assert not page.exception
    assert "judged by different limits (−0.040" in texts(page)
    page = open_page("scene", zoned, scene="MSN-0424~LH-F12~S1~20261118T212000Z", feature="station:M1@40.0")
    assert not page.exception
    assert "Step into the wind" in texts(page)
    assert "no limit is known" not in texts(page)
