"""What changed between two assemblies of a panel."""

from __future__ import annotations

import contextlib
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flows.cli import EXIT_BAD_INPUT, EXIT_DONE, main
from metrology.assembly.changes import Snapshot, changes
from metrology.assembly.rows import ChangeRow
from metrology.assembly.verdict import findings
from metrology.kinds import BY_NAME, RIVET
from metrology.results import PanelKey, Rivet
from metrology.tolerance import judge
from storage.archive import Store
from storage.archive.decisions import dispose, shown_finding
from storage.archive.panel_changes import PanelRun, compared, earlier_shifts, runs_of_panel
from storage.archive.panel_history import frames_of
from storage.panel_spec import load_panel_spec
from storage.report import assembled_page, assembled_record
from storage.review import Feature, ReviewLog
from tests.support.panel_store import two_nights
from tests.support.results import copied
from tests.support.rows import rivet_at

KEY_OF_PANEL = PanelKey("MSN-1", "P")
LIMITS = load_panel_spec().limits
SOUND, PROUD, PROUDER = 0.01, 0.14, 0.19


def heads(*heights: float) -> list[Rivet]:
    rows = [
        rivet_at(f"R{k:02d}", (30.0 * k, 0, 0), (100, 100), 8.0, 30.0, height_mean_mm=height, height_u95_mm=0.01,
                 tilt_deg=0.1, tilt_u95_deg=0.05, x_panel_mm=30.0 * k, y_panel_mm=0.0, z_panel_mm=0.0)
        for k, height in enumerate(heights, 1)
    ]  # fmt: skip
    return judge(RIVET, rows, LIMITS)


def snapshot(rows: list[Rivet], frame: str = "own 1", reach: float = 1000.0) -> Snapshot:
    none = {name: [] for name in BY_NAME}
    features = {**none, RIVET.name: [(1, row) for row in rows]}
    return Snapshot(
        {1: frame}, features, findings({**none, RIVET.name: rows}, LIMITS), lambda f, x, y: f == frame and x < reach
    )


def found(now: Snapshot, before: Snapshot) -> dict[str, ChangeRow]:
    return {row.feature_id: row for row in changes(now, before, LIMITS)}


def test_findings_are_new_worse_better_unchanged_or_gone() -> None:
    before = snapshot(heads(SOUND, PROUD, PROUDER, PROUD, PROUD))
    now = found(snapshot(heads(PROUD, PROUDER, PROUD, PROUD + 0.01, SOUND)), before)
    assert [row.change for row in now.values()] == ["new", "worse", "better", "unchanged", "gone"]
    assert now["R02"].difference == pytest.approx(0.05)
    assert now["R02"].difference_u95 == pytest.approx(np.hypot(0.01, 0.01))
    assert (now["R01"].before_decision, now["R05"].decision) == ("pass", "pass")


def test_what_is_not_in_the_same_frame_is_not_compared() -> None:
    now = found(snapshot(heads(PROUD), "own 2"), snapshot(heads(PROUDER, PROUD)))
    assert (now["R01"].change, now["R01"].before_value, now["R01"].reason) == ("not seen", PROUDER, "not seen")
    assert now["R02"].change == "not seen"


def test_a_head_that_is_not_found_any_more_is_not_cured() -> None:
    now = found(snapshot(heads(SOUND)), snapshot(heads(SOUND, PROUD)))
    assert (now["R02"].change, now["R02"].reason) == ("not seen", "not found")
    now = found(snapshot(heads(SOUND), reach=40), snapshot(heads(SOUND, PROUD)))
    assert now["R02"].reason == "not seen"


@pytest.fixture(scope="module")
def nights(tmp_path_factory: pytest.TempPathFactory) -> Store:
    return two_nights(tmp_path_factory.mktemp("nights") / "store")


def rivets(store: Store) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = store.query(
        "FROM panel_changes WHERE feature_kind = 'rivet' AND abs(value) + abs(before_value) > 0.18 ORDER BY change"
    ).to_pylist()
    return rows


def test_a_second_night_is_compared_with_the_first(nights: Store) -> None:
    gone, worse = rivets(nights)
    assert (gone["change"], worse["change"]) == ("gone", "worse")
    assert worse["difference"] == pytest.approx(0.04, abs=0.01)
    names = nights.query("SELECT rivet_id, height_mean_mm FROM panel_rivets").to_pylist()
    assert {row["rivet_id"]: row["height_mean_mm"] for row in names}[worse["feature_id"]] == pytest.approx(
        worse["value"], abs=1e-4
    )
    assert len(names) == 30
    assert {row["rivet_id"] for row in names} == {f"N{k:02d}" for k in range(1, 31)}
    assert nights.query("SELECT count(DISTINCT frame_id) FROM panel_stations").column(0)[0].as_py() == 1


def test_runs_are_compared_in_either_order_and_the_command_says_it(
    nights: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = runs_of_panel(nights, KEY_OF_PANEL)
    assert {row.change for row in compared(first, second) if abs(row.value or 0) > 0.18} == {"new"}
    asked = ["panel", "changes", "--store", str(nights.root), "--aircraft", "MSN-1", "--panel", "P"]
    capsys.readouterr()
    assert main(asked) == EXIT_DONE
    said = capsys.readouterr().out
    assert "since 2026-11-20" in said.splitlines()[0]
    assert any(line.startswith("  worse") and "mm" in line for line in said.splitlines())
    assert main([*asked, "--since", "2026-11-01"]) == EXIT_BAD_INPUT
    assert "expected one of 2026-11-20" in capsys.readouterr().err


def test_without_an_earlier_assembly_there_is_nothing_to_compare(
    nights: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["panel", "changes", "--store", str(nights.root), "--aircraft", "MSN-1", "--panel", "Q"]
    assert main(asked) == EXIT_BAD_INPUT
    assert "found no assembled panel MSN-1 Q" in capsys.readouterr().err


def test_work_on_a_head_is_cured_or_not_by_the_scan_after(
    nights: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = copied(nights, tmp_path)
    first, _ = runs_of_panel(store, KEY_OF_PANEL)
    rows = {row["rivet_id"]: row for row in first.rows("panel_rivets")}
    gone, worse = (row["feature_id"] for row in rivets(store))
    with contextlib.closing(store.connect()) as connection:
        for name in (gone, worse):
            scene, own = rows[name]["seen_by"][0], rows[name]["seen_as"][0]
            shown = shown_finding(connection, ReviewLog(store.root).read(), scene, Feature("rivet", own))
            assert shown
            dispose(store.root, "m.weber", [shown], "rework", "set anew")
    asked = ["panel", "changes", "--store", str(store.root), "--aircraft", "MSN-1", "--panel", "P"]
    assert main(asked) == EXIT_DONE
    said = [line for line in capsys.readouterr().out.splitlines() if "rework of" in line]
    assert [(line.split()[2].rstrip(","), line.rpartition(": ")[2]) for line in said] == [
        (worse, "not cured"), (gone, "cured"),
    ]  # fmt: skip


def test_a_damaged_earlier_run_is_no_reason_not_to_store_the_next(nights: Store, tmp_path: Path) -> None:
    store = copied(nights, tmp_path)
    first = store.layout.scene_folder(KEY_OF_PANEL.panel_id) / runs_of_panel(store, KEY_OF_PANEL)[0].run_id
    (first / "panel_rivets.parquet").chmod(0o644)
    (first / "panel_rivets.parquet").write_bytes(b"no longer")
    assert main(["panel", "assemble", "--store", str(store.root)]) == EXIT_DONE
    assert store.query("SELECT count(*) FROM panel_changes").column(0)[0].as_py() == 0
    assert store.query("SELECT count(*) FROM panel_rivets").column(0)[0].as_py() == 30


def test_the_report_says_what_changed(nights: Store, tmp_path: Path) -> None:
    page = assembled_page(assembled_record(nights, KEY_OF_PANEL))
    _, _, changed = page.partition("<h2>Changes since 2026-11-20 08:03:00 UTC</h2>")
    assert changed.index("worse") < changed.index("cured") < changed.index("<h2>Stations</h2>")
    assert page.count("<image href=") == 1


def test_runs_that_kept_no_name_of_their_frame_have_one(nights: Store) -> None:
    first, second = runs_of_panel(nights, KEY_OF_PANEL)
    older = [{**row, "frame_id": None} for row in first.rows("panel_stations")]
    assert frames_of(older, first.manifest) == frames_of(older[::-1], first.manifest)
    assert frames_of(older, first.manifest) != frames_of([{**row, "x_mm": 0.0} for row in older], first.manifest)
    assert frames_of(second.rows("panel_stations"), {}) == frames_of(first.rows("panel_stations"), {})


def test_runs_of_one_shift_count_once() -> None:
    start = datetime(2026, 11, 20, 8, tzinfo=UTC)

    def run(hours: float) -> PanelRun:
        at = start + timedelta(hours=hours)
        return PanelRun(str(hours), at, frozenset([str(hours)]), {}, lambda table: (), lambda name: b"")

    runs = [run(hours) for hours in (0, 0.5, 1, 24, 24.5, 48, 48.5)]
    assert [each.run_id for each in earlier_shifts(runs[-1], runs)] == ["1", "24.5"]
    assert [each.run_id for each in earlier_shifts(runs[2], runs)] == ["0", "0.5"]
    assert earlier_shifts(runs[0], runs) == []
