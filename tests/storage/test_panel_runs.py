"""Assembled panels in a store: tables, judging again, checks, rebuilding and pruning."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import plyfile
import pytest

from flows.cli import EXIT_BAD_INPUT, EXIT_DONE, main
from metrology.results import PanelKey
from storage.archive import Store, maintenance
from storage.archive.aircraft import _panel
from storage.archive.bundle import check_bundle
from storage.archive.panel_scans import newest_scans
from storage.archive.schema import PANEL_TABLES
from storage.export.panel_cloud import CELL_MM
from storage.report import assembled_page, assembled_record
from tests.support.panel_scans import SimulatedPanel, facing
from tests.support.panel_store import published, result_of
from tests.support.results import copied, small_key, small_result

KEY = PanelKey("MSN-1", "P")
RULES = """
format = "flushline-panel/1"
panel = "P"
revision = "{revision}"
[zones.default.height_mm]
lower = -{limit}
upper = {limit}
source = "DS-1"
revision = "{revision}"
[zones.default.step_mm]
lower = -1
upper = 1
source = "DS-1"
revision = "{revision}"
[[acceptance]]
id = "A1"
measure = "share"
kind = "rivet"
quantity = "height"
most = 0.1
source = "DS-1"
revision = "{revision}"
"""


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """A panel of three stations, put together."""
    rng = np.random.default_rng(0)
    panel = SimulatedPanel.made(rng, 15, (-62.0, 74.0))
    scans = [panel.seen(facing(x, 0.0, rng)[0], f"S{k}", rng) for k, x in enumerate((-220.0, 0.0, 220.0), 1)]
    store = published(Store(tmp_path_factory.mktemp("panels") / "store"), scans)
    assert main(["panel", "assemble", "--store", str(store.root)]) == EXIT_DONE
    return store


def one(store: Store, sql: str) -> object:
    return store.query(sql).column(0)[0].as_py()


def test_each_feature_is_in_the_tables_once(filled: Store) -> None:
    assert one(filled, "SELECT count(*) FROM panel_rivets") == 30
    assert one(filled, "SELECT count(DISTINCT rivet_id) FROM panel_rivets") == 30
    assert one(filled, "SELECT count(DISTINCT seam_id) FROM panel_seam_stations") == 1
    [panel] = filled.query("FROM panels").to_pylist()
    assert (panel["scene_id"], panel["n_scenes"], panel["n_parts"], panel["n_rivets"]) == ("MSN-1~P", 3, 1, 30)
    assert 1000 < panel["area_cm2"] < 3000
    stations = filled.query("FROM panel_stations ORDER BY station").to_pylist()
    assert [row["part"] for row in stations] == [1, 1, 1]
    R = np.array(stations[1]["rotation"]).reshape(3, 3)
    assert np.abs(R @ R.T - np.eye(3)).max() < 1e-5
    assert one(filled, "SELECT count(*) FROM panel_differences WHERE quantity = 'height'") >= 4
    assert one(filled, "SELECT count(*) FILTER (beyond) / count(*) FROM panel_differences") < 0.2  # type: ignore[operator]
    assert one(filled, "SELECT count(*) FROM latest_scenes") == 3  # a panel is no scene


def test_stored_values_are_judged_again_and_both_verdicts_stay(filled: Store, tmp_path: Path) -> None:
    store, spec = copied(filled, tmp_path), tmp_path / "spec.toml"
    before = store.query("SELECT rivet_id, height_mean_mm FROM panel_rivets ORDER BY ALL")
    judging = ["panel", "judge", "--store", str(store.root), "--aircraft", "MSN-1", "--panel", "P", "--panel-spec"]
    for revision, limit, expected in (("B", 1.0, "accepted"), ("C", 0.02, "rejected")):
        spec.write_text(RULES.format(revision=revision, limit=limit), encoding="utf-8")
        assert main([*judging, str(spec)]) == EXIT_DONE
        assert one(store, "SELECT verdict FROM panels") == expected
    assert store.query("SELECT rivet_id, height_mean_mm FROM panel_rivets ORDER BY ALL") == before
    verdicts = store.query("SELECT panel_spec, verdict FROM panel_verdicts ORDER BY judged_at").to_pylist()
    assert [(row["panel_spec"], row["verdict"]) for row in verdicts] == [
        ("example 1", "no rules"), ("P B", "accepted"), ("P C", "rejected"),
    ]  # fmt: skip
    assert str(one(store, "SELECT verdict_reason FROM panels")).startswith("A1: ")
    assert one(store, "SELECT count(*) FROM panel_findings WHERE reason LIKE '%example%'") == 0


def test_check_rebuild_and_prune_know_panel_runs(filled: Store, tmp_path: Path) -> None:
    store = copied(filled, tmp_path)
    assert main(["panel", "assemble", "--store", str(store.root)]) == EXIT_DONE  # again: the same scans
    before = [store.query(f"FROM {table.name} ORDER BY ALL") for table in PANEL_TABLES]
    assert maintenance.check(store.layout).problems == ()
    assert maintenance.rebuild(store.layout) == []
    assert [store.query(f"FROM {table.name} ORDER BY ALL") for table in PANEL_TABLES] == before
    assert len(maintenance.prune(store.layout)) == 1
    assert maintenance.check(store.layout).problems == ()
    assert maintenance.export(store.layout, str(tmp_path / "copy"), panel="P") == (4, 0)


def test_a_damaged_panel_run_is_named_and_gives_way_to_the_one_before(filled: Store, tmp_path: Path) -> None:
    store = copied(filled, tmp_path)
    first = one(store, "SELECT run_id FROM panels")
    assert main(["panel", "assemble", "--store", str(store.root)]) == EXIT_DONE
    run = store.root / str(one(store, "SELECT bundle_path FROM panels"))
    check_bundle(run)
    (run / "panel_rivets.parquet").chmod(0o644)
    (run / "panel_rivets.parquet").write_bytes(b"no longer")
    assert any("panel_rivets.parquet" in problem for problem in maintenance.check(store.layout).problems)
    assert any("panel_rivets.parquet" in problem for problem in maintenance.rebuild(store.layout))
    assert one(store, "SELECT run_id FROM panels") == first


def test_what_is_not_there_is_said(filled: Store, capsys: pytest.CaptureFixture[str]) -> None:
    store = str(filled.root)
    assert main(["panel", "assemble", "--store", store, "--aircraft", "MSN-9"]) == EXIT_BAD_INPUT
    assert "found no scan of MSN-9, expected one of: MSN-1 P" in capsys.readouterr().err
    judging = ["panel", "judge", "--store", store, "--aircraft", "MSN-1", "--panel", "P"]
    assert main(judging) == EXIT_BAD_INPUT
    assert "found no specification of P" in capsys.readouterr().err


def test_the_report_of_a_panel_begins_with_verdict_coverage_map_and_signatures(filled: Store, tmp_path: Path) -> None:
    store = copied(filled, tmp_path)
    spec = tmp_path / "spec.toml"
    spec.write_text(RULES.format(revision="A", limit=0.05))
    command = ["panel", "judge", "--store", str(store.root), "--aircraft", "MSN-1", "--panel", "P"]
    assert main([*command, "--panel-spec", str(spec)]) == EXIT_DONE
    out = tmp_path / "panel.html"
    report = ["report", "--store", str(store.root), "--aircraft", "MSN-1", "--panel", "P", "--out", str(out)]
    assert main([*report, "--csv"]) == EXIT_DONE
    page = out.read_text()
    first, rest = page.split("<h2>Acceptance rules</h2>")
    order = ["Panel MSN-1 P", "rejected", "A1: at most 10% of the rivets", "Coverage", "<svg", "approved: name, date"]
    assert sorted(order, key=first.index) == order
    assert re.findall(r"@\d|\bM\d (?:at )?\d", rest) == []  # no position of a seam is beyond its limits
    assert out.with_name("panel-panel_rivets.csv").read_text("utf-8-sig").count("\n") == 1 + one(
        store, "SELECT n_rivets FROM panels"
    )
    assert main([*report, "--stations"]) == EXIT_DONE
    assert "Station S2" in out.read_text()


def test_the_report_says_that_a_newer_scan_is_not_in_the_panel(filled: Store, tmp_path: Path) -> None:
    store = copied(filled, tmp_path)
    record = assembled_record(store, KEY)
    assert record.newer == ()
    [scan] = [each.scan for each in newest_scans(store, KEY) if each.scan.key.station == "S2"]
    store.publish(result_of(replace(scan, key=replace(scan.key, captured_at=scan.key.captured_at + timedelta(days=1)))))
    assert "not in it: a newer scan of S2; assemble the panel again" in assembled_page(assembled_record(store, KEY))


def test_an_aircraft_lists_its_panels(filled: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = copied(filled, tmp_path)
    store.publish(small_result(small_key("S7", aircraft="MSN-2", panel="Q")))
    other = tmp_path / "r.toml"
    other.write_text(RULES.format(revision="A", limit=0.05).replace('panel = "P"', 'panel = "R"'))
    assert main(["panel", "add", str(other), "--store", str(store.root)]) == EXIT_DONE
    capsys.readouterr()
    assert main(["panel", "list", "--store", str(store.root), "--aircraft", "MSN-1"]) == EXIT_DONE
    assert capsys.readouterr().out.splitlines() == [
        "panel P: no pattern; 3 stations; no rules",
        "panel Q: not; 0 stations; no scan",
        "panel R: not; 0 stations; no scan",
    ]
    assert main(["panel", "list", "--store", str(store.root), "--aircraft", "MSN-2"]) == EXIT_DONE
    assert "panel Q: partly; 1 station; not put together" in capsys.readouterr().out
    assert main(["panel", "list", "--store", str(store.root), "--aircraft", "MSN-9"]) == EXIT_BAD_INPUT


def test_a_panel_of_the_aircraft_is_done_when_all_of_its_pattern_is_measured(filled: Store, tmp_path: Path) -> None:
    store = copied(filled, tmp_path)

    def state(**changed: object) -> tuple[str, str]:
        row = {**store.query("FROM panels").to_pylist()[0], **changed}
        found = _panel(store, "P", {**row, "n": 3, "ids": row["scenes"]})
        return found.state, found.missing

    assert state(n_expected=40, n_not_seen=0, n_not_measured=0) == ("done", "")
    assert state(n_expected=40, n_not_seen=2, n_not_measured=1) == ("partly", "2 not seen, 1 not measured")
    assert state(n_expected=40, n_parts=2) == ("partly", "2 parts that nothing joins")


def test_the_clouds_of_a_panel_are_one(filled: Store, tmp_path: Path) -> None:
    out = tmp_path / "out"
    asked = ["export", "--aircraft", "MSN-1", "--panel", "P", "--store", str(filled.root), "--out", str(out)]
    assert main([*asked, "--format", "panel-ply"]) == EXIT_DONE
    [file] = out.rglob("*.ply")
    vertex = plyfile.PlyData.read(str(file))["vertex"]
    points = np.stack([vertex["x"], vertex["y"], vertex["z"]], axis=1).astype(float)
    assert np.ptp(points[:, 0]) > 600  # three fields of some 300 mm
    assert len(np.unique(np.floor(points / CELL_MM), axis=0)) > 0.999 * len(points)  # what overlaps is there once
    apart = points[:, 2] + 0.5 * points[:, 1] ** 2 / 1800  # the skin is a cylinder of 1800 mm
    assert np.std(apart - np.polyval(np.polyfit(points[:, 1], apart, 2), points[:, 1])) < 0.1
