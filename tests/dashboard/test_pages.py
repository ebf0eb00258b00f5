"""Every page on a normal, an empty and a hostile store, and with whatever a URL may say."""

from __future__ import annotations

import os
import re
import tarfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pytest
from streamlit.testing.v1 import AppTest

from dashboard.access import Person
from dashboard.app import PAGES
from dashboard.comparing import differences
from dashboard.data import Archive
from dashboard.findings import Selection, Wanted, findings
from dashboard.first_pass import Yield, first_pass
from dashboard.frame import plain
from dashboard.locale import Locale
from dashboard.questions import MORE, QUESTIONS
from dashboard.review_report import html_report
from dashboard.scenes import load_features, load_scene_row
from dashboard.sql_runner import run_query
from dashboard.trends import PARETO, QUANTITIES, Subject, outside_by, series
from metrology.kinds import HOLE, RIVET
from metrology.results import Hole, SceneKey
from metrology.tolerance import judge
from storage.archive.schema import TABLES
from storage.archive.store import Store
from storage.archive.views import VIEWS
from storage.panel_spec import load_panel_spec
from storage.review import Feature, ReviewLog, ShownFinding, ShownScene
from tests.support.synthetic_scene import Recipe, synthetic_result
from tests.support.week import AIRCRAFT, WORST_HEIGHT, recipe, texts

DATA = Path(__file__).resolve().parent.parent / "data"
Open = Callable[..., AppTest]
WORK = "Where work waits"
LAST = "MSN-0425~LH-F12~S2~20261119T212500Z"


def clean(page: AppTest) -> AppTest:
    """Neither a traceback nor an error on the page."""
    assert not page.exception
    assert not page.error, [error.value for error in page.error]
    return page


@pytest.mark.parametrize("name", PAGES)
def test_page_shows_a_filled_store(name: str, filled: Path, open_page: Open) -> None:
    page = clean(open_page(name, filled))
    assert PAGES[name][0] in texts(page)


@pytest.fixture(scope="module")
def old_store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of the first version; do not write to it."""
    folder = tmp_path_factory.mktemp("old")
    with tarfile.open(DATA / "store-0.1.0.tar.xz") as tar:
        tar.extractall(folder, filter="tar")
    return folder / "store"


@pytest.mark.parametrize("name", PAGES)
def test_page_shows_an_old_store_that_may_not_be_changed(
    name: str, old_store: Path, open_page: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("storage.archive.store.os.access", lambda path, mode: False)
    before = sorted((old_store / ".index").rglob("*"))
    page = clean(open_page(name, old_store, scene="MSN-2~LH-F12~S1~20261120T081500Z"))
    assert PAGES[name][0] in texts(page)
    assert sorted((old_store / ".index").rglob("*")) == before


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize("exists", [True, False])
def test_empty_store_says_what_to_do_next(name: str, exists: bool, tmp_path: Path, open_page: Open) -> None:
    root = tmp_path / "store"
    if exists:
        root.mkdir()
    page = clean(open_page(name, root))
    assert "flushline inspect" in texts(page)


def test_without_a_store_it_says_how_to_start() -> None:
    page = AppTest.from_function(_run, kwargs={"name": "overview"}).run()
    assert not page.exception
    assert "flushline dashboard" in page.error[0].value.replace("\\", "")


def _run(name: str) -> None:
    from dashboard.app import PAGES

    PAGES[name][2]()


HOSTILE = ("<script>alert(1)</script>'; DROP TABLE scenes; --", "../" + "💥" * 2000)


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize("value", HOSTILE)
def test_hostile_urls_do_no_harm(name: str, value: str, filled: Path, open_page: Open) -> None:
    keys = ("scene", "feature", "aircraft", "panel", "station", "rig", "period", "verdict", "kind", "state", "view",
            "what", "name", "quantity", "rules", "measure", "query", "numbers")  # fmt: skip
    page = open_page(name, filled, **dict.fromkeys(keys, value))
    assert not page.exception
    assert "<script>" not in texts(page).replace("\\<script\\>", "")


@pytest.mark.parametrize("feature", ["rivet:R99", "rivet:", "station:M1@nan", ":", "rivet:R01:x", "💥"])
def test_unknown_features_show_the_gravest_instead(feature: str, filled: Path, open_page: Open) -> None:
    page = clean(open_page("scene", filled, scene=LAST, feature=feature))
    assert "Rivet R04" in texts(page)


@pytest.mark.parametrize("compare", ["a,b", LAST, f"{LAST},{LAST}", ",,,", f"{LAST},../x"])
def test_comparing_takes_anything(compare: str, filled: Path, open_page: Open) -> None:
    assert not open_page("archive", filled, compare=compare).exception


def make_hostile(root: Path, change: str) -> Path:
    """Put an index of our making in the place of the published one."""
    target = root / ".index" / "generations" / f"archive-9-{change.replace(' ', '-')}.duckdb"
    with duckdb.connect(str(target)) as connection:
        if change != "no tables":
            source = os.path.realpath(root / "archive.duckdb")
            connection.execute(f"ATTACH '{source}' AS old (READ_ONLY)")
            for table in TABLES:
                connection.execute(f"CREATE TABLE {table.name} AS FROM old.{table.name}")
            for view in VIEWS:
                connection.execute(view.create_sql)
            for statement in _CHANGES[change]:
                connection.execute(statement)
            connection.execute("DETACH old")
    (root / "archive.duckdb").unlink()
    (root / "archive.duckdb").symlink_to(os.path.relpath(target, root))
    return root


_NUMBERS = {
    "rivets": ("x_mm", "y_mm", "z_mm", "u_px", "v_px", "diameter_mm", "major_px", "minor_px", "angle_deg",
               "height_mean_mm", "height_u95_mm", "tilt_deg", "tilt_u95_deg"),
    "seam_stations": ("s_mm", "x_mm", "y_mm", "z_mm", "u_px", "v_px", "step_mm", "step_u95_mm", "width_mm",
                      "width_u95_mm"),
}  # fmt: skip


def _all_numbers(value: str) -> list[str]:
    return [
        f"UPDATE {table} SET {', '.join(f'{column} = {value}' for column in columns)}"
        for table, columns in _NUMBERS.items()
    ]


_CHANGES = {
    "no rows": ["DELETE FROM rivets", "DELETE FROM seam_stations"],
    "no scenes": ["DELETE FROM scenes"],
    "nothing measured": _all_numbers("NULL"),
    "nan": _all_numbers("'nan'"),
    "huge": _all_numbers("1e300"),
    "infinite": _all_numbers("'inf'"),
    "markup": [
        "UPDATE rivets SET reason = '<img src=x onerror=alert(1)> **[x](javascript:1)**', rivet_id = '<b>' || rivet_id",
        "UPDATE scenes SET operator = '`', rig_id = '<script>', warnings = ['# <script>alert(1)</script>']",
    ],
    "paths out of the store": [
        "UPDATE scenes SET preview_path = '../../../../etc/passwd', cloud_path = '/etc/passwd', "
        "overlay_path = '../x', bundle_path = '..'"
    ],
    "files gone": [
        "UPDATE scenes SET preview_path = 'gone.png', cloud_path = 'gone', overlay_path = 'gone', bundle_path = 'gone'"
    ],
    "wrong files": ["UPDATE scenes SET preview_path = 'flushline-store.json', cloud_path = 'flushline-store.json'"],
    "null columns": [
        "UPDATE scenes SET rig_id = NULL, software_version = NULL, status = NULL, warnings = NULL, n_rivets = NULL, "
        "n_stations = NULL, preview_path = NULL, cloud_path = NULL, bundle_path = NULL, processed_at = NULL, "
        "epipolar_rms_px = NULL, seconds_total = NULL, run_id = NULL, panel_spec = NULL"
    ],
    "strange verdicts": ["UPDATE rivets SET decision = 'maybe', severity = 'pink'"],
    "missing column": ["DROP VIEW latest_rivets", "ALTER TABLE rivets DROP COLUMN height_mean_mm"],
    "missing table": ["DROP TABLE seam_stations"],
    "no tables": [],
}


@pytest.mark.parametrize("change", _CHANGES)
def test_hostile_stores_never_raise(change: str, writable: Path, open_page: Open) -> None:
    make_hostile(writable, change)
    of_scenes = any("scenes" in statement or "TABLE" in statement for statement in _CHANGES[change])
    for name in ("overview", "scene", "review", "trends", *(("archive", "runs") if of_scenes else ())):
        page = open_page(name, writable)
        assert not page.exception, name
        assert not any("something it did not expect" in error.value for error in page.error), name


def damage(root: Path, file: str, content: bytes | None) -> None:
    """Put content in the place of a file of every bundle, or nothing."""
    for path in root.glob(f"bundles/**/{file}"):
        path.unlink()
        if content is not None:
            path.write_bytes(content)


def open_all(root: Path, views: Sequence[str], open_page: Open) -> None:
    """Views of a scene, or "review", without a traceback."""
    for view in views:
        page = (
            open_page("review", root, scene=LAST)
            if view == "review"
            else open_page("scene", root, scene=LAST, view=view)
        )
        assert not page.exception, view
        assert not any("something it did not expect" in error.value for error in page.error), view


# What reads a file; the close-up beside every view reads the cloud, the rig and the manifest.
READ_BY = {
    "cloud.parquet": ("Deviation map", "3-D", "Files", "review"),
    "preview.png": ("Picture", "Files", "review"),
    "overlay.png": ("Overlay", "Files"),
    "rig.json": ("Picture", "Files"),
    "manifest.json": ("Picture", "Files", "review"),
}
CONTENTS = pytest.mark.parametrize("content", [None, b"", b"no picture"], ids=["gone", "empty", "garbage"])


@CONTENTS
@pytest.mark.parametrize("file", READ_BY)
def test_a_damaged_bundle_is_said_in_one_line(
    file: str, content: bytes | None, writable: Path, open_page: Open
) -> None:
    damage(writable, file, content)
    open_all(writable, READ_BY[file], open_page)
    if file == "overlay.png" and content is not None:
        (error,) = open_page("scene", writable, scene=LAST, view="Overlay").error
        assert "overlay.png: found no readable picture" in error.value.replace("\\", "")


@pytest.mark.parametrize("content", [None, b"no picture"], ids=["gone", "garbage"])
def test_a_bundle_that_is_damaged_throughout_is_no_error(
    content: bytes | None, writable: Path, open_page: Open
) -> None:
    for file in READ_BY:
        damage(writable, file, content)
    open_all(writable, ("Picture", "Deviation map", "3-D", "Overlay", "Table", "Files", "review"), open_page)


def test_the_review_lists_all_that_the_overview_counts(filled: Path, open_page: Open) -> None:
    waiting = next(
        m.value for m in open_page("overview", filled, view=WORK).metric if m.label == "Waiting for a person"
    )
    said = [caption.value for caption in open_page("review", filled).caption]
    assert any(text.startswith(f"{waiting} findings") for text in said), said


def test_counts_are_of_features_and_stretches(filled: Path, open_page: Open) -> None:
    found = findings(Archive(filled), Wanted(state="all"))  # of all scans: each is the newest of its station
    outside = found[found["decision"].isin(["fail", "conditional fail"])]
    assert (outside["n_positions"] > 1).any()
    listed = open_page("archive", filled).dataframe[0].value
    assert listed["fail"].sum() == len(outside)
    assert listed["not_measured"].sum() == (found["decision"] == "not measured").sum()
    assert (listed["fail"] > 0).sum() == len(open_page("archive", filled, verdict="with fails").dataframe[0].value)
    said = texts(open_page("overview", filled, view=WORK))
    for decision, n in found["decision"].value_counts().items():
        assert re.search(rf"{re.escape(str(decision))} {n}\b", said), said
    # Of the rivets and seams, those that are in no finding pass.
    features = Archive(filled).rows("SELECT sum(n_rivets + n_seams) AS n FROM scenes")["n"][0]
    names = found["scene_id"] + found["feature_kind"] + found["feature_id"].str.split("@").str[0]
    assert re.search(rf"\bpass {features - names.nunique():.0f}\b", said), said


def test_the_review_lists_no_gauges(writable: Path, open_page: Open) -> None:
    gauge = AIRCRAFT[-1]
    (writable / "dashboard.toml").write_text(f'not_aircraft = ["{gauge[:-1]}[{gauge[-1]}]"]\n')
    found = findings(Archive(writable), Wanted())["aircraft_serial"].value_counts()
    page = clean(open_page("review", writable))
    assert gauge not in set(page.dataframe[0].value["Aircraft"])
    assert any(c.value.startswith(f"{found.sum() - found[gauge]} findings · without") for c in page.caption)
    chosen = clean(open_page("review", writable, aircraft=gauge)).dataframe[0].value
    assert set(chosen["Aircraft"]) == {gauge}


def test_what_may_be_a_gauge_is_said_where_the_settings_name_none(writable: Path, open_page: Open) -> None:
    def hints() -> list[str]:
        return [c.value for c in clean(open_page("review", writable)).caption if "gauges?" in c.value]

    assert hints() == []
    key = SceneKey("STD-0001", "standard-part", "S1", datetime(2026, 11, 19, 9, tzinfo=UTC))
    Store(writable).publish(synthetic_result(Recipe(key, heights_mm=(0.5, *[0.0] * 11))))
    assert hints() == [r"STD\-\*: gauges?"]
    (writable / "dashboard.toml").write_text('not_aircraft = ["STD-*"]\n')
    assert hints() == []


def test_a_finding_is_listed_with_what_its_verdict_is_about(writable: Path, open_page: Open) -> None:
    key = SceneKey("MSN-0499", "LH-F12", "S1", datetime(2026, 11, 19, 9, tzinfo=UTC))
    Store(writable).publish(synthetic_result(Recipe(key, heights_mm=(0.3, *[0.0] * 11), tilt_deg=1.4)))
    rows = clean(open_page("review", writable, aircraft="MSN-0499", kind="rivet")).dataframe[0].value
    tilted = rows[rows["Quantity"] == "tilt"]
    assert len(tilted) >= 11
    assert tilted["Value"].between(1.2, 1.6).all()
    assert (tilted["Value"] + tilted["To limit"]).round(6).eq(1.0).all()  # the example limits' tilt
    archive = Archive(writable)
    found = findings(archive, Wanted(selection=Selection(aircraft=("MSN-0499",))))
    page = html_report(found, archive, Locale(), "Hall 7", "en").decode()
    assert re.search(r"tilt \+1\.[2-6]\d* °", page)
    news = clean(open_page("overview", writable, since="any time", list="new")).dataframe[0].value
    tilted = news[(news["Aircraft"] == "MSN-0499") & (news["Quantity"] == "tilt")]
    assert len(tilted) >= 11
    assert tilted["Value"].between(1.2, 1.6).all()
    assert tilted["Before, mm"].isna().all()
    # All the others are about what their kind is listed by: no column more.
    assert "Quantity" not in clean(open_page("review", writable, aircraft="MSN-0425")).dataframe[0].value


def test_a_disposition_stays_chosen_until_it_is_taken_back(filled: Path, open_page: Open) -> None:
    def pressed(page: AppTest, label: str) -> AppTest:
        return clean(next(b for b in page.button if b.label == label).click().run())

    def offered(page: AppTest) -> str:
        return next(b.label for b in page.button if str(b.key).startswith("record-"))

    page = clean(open_page("review", filled))
    for __ in range(2):
        page = pressed(page, "rework")
        assert offered(page).startswith("Record *rework*")
    assert offered(pressed(page, "✕")).startswith("Record for")
    assert offered(pressed(pressed(page, "rework"), "scrap")).startswith("Record *scrap*")


def test_a_signature_counts_scans_as_one_says_it(writable: Path, open_page: Open) -> None:
    key = SceneKey("MSN-0498", "LH-F12", "S1", datetime(2026, 11, 19, 9, tzinfo=UTC))
    Store(writable).publish(synthetic_result(Recipe(key, heights_mm=(0.0,) * 12, step_mm=0.01)))
    said = texts(clean(open_page("panel", writable, aircraft="MSN-0498", panel="LH-F12")))
    assert plain("released with 1 scan; verdict") in said
    assert "1 scans" not in said


def test_the_worst_of_a_panel_is_a_height_or_a_step_and_no_diameter(writable: Path, open_page: Open) -> None:
    scan = synthetic_result(recipe(5, "S3"))
    hole = Hole(
        "H1", x_mm=1.0, y_mm=2.0, z_mm=700.0, u_px=90.0, v_px=90.0, kind="open hole", diameter_mm=8.27,
        diameter_u95_mm=0.02,
    )  # fmt: skip
    holes = tuple(judge(HOLE, [hole], load_panel_spec().limits))
    assert holes[0].decision == "conditional fail"
    Store(writable).publish(replace(scan, features={**scan.features, HOLE.name: holes}))
    panels = open_page("overview", writable, view=WORK).dataframe[0].value.set_index("Aircraft")
    assert panels.loc[scan.key.aircraft_serial, "Worst, mm"] == pytest.approx(WORST_HEIGHT, abs=0.005)


def test_few_points_are_not_called_in_control(filled: Path, open_page: Open) -> None:
    said = texts(open_page("trends", filled, what="rivet", panel="LH-F12", station="S2"))
    assert "In control" not in said
    assert "say little yet" in said or "Not steady" in said


@pytest.mark.parametrize("view", ["Deviation map", "3-D", "Overlay", "Table", "Files"])
def test_every_view_of_a_scene(view: str, filled: Path, open_page: Open) -> None:
    clean(open_page("scene", filled, scene=LAST, view=view))


@pytest.mark.parametrize("change", ["nan", "paths out of the store", "null columns"])
def test_views_of_hostile_scenes(change: str, writable: Path, open_page: Open) -> None:
    make_hostile(writable, change)
    for view in ("Picture", "Deviation map", "3-D", "Overlay", "Table", "Files"):
        page = open_page("scene", writable, scene=LAST, view=view)
        assert not page.exception, view
        assert not any("something it did not expect" in error.value for error in page.error), view
        assert "root:" not in texts(page), view


@pytest.mark.parametrize("what", ["rivet", "seam", "panel", "fastener type"])
def test_trends_of_every_subject(what: str, filled: Path, open_page: Open) -> None:
    page = clean(open_page("trends", filled, what=what))
    assert [metric.label for metric in page.metric] == ["Cp", "Cpk", "Pp", "Ppk"]
    assert page.metric[3].value != "–"


def test_a_scan_after_rework_is_not_averaged_with_the_one_before(writable: Path) -> None:
    panel = Subject("panel", "LH-F12")
    before = series(Archive(writable), panel, QUANTITIES["height"], Selection())
    sound = recipe(5, "S2")
    again = replace(sound.key, captured_at=sound.key.captured_at + timedelta(hours=3))
    Store(writable).publish(synthetic_result(replace(sound, key=again, heights_mm=(0.5,) * 12)))
    after = series(Archive(writable), panel, QUANTITIES["height"], Selection())
    assert len(after) == len(before) + 1
    last = after[after["aircraft_serial"] == again.aircraft_serial].sort_values("captured_at")
    assert list(last["n"]) == [before["n"].iloc[-1], 12]
    assert last["value"].iloc[0] == before["value"].iloc[-1]
    assert last["value"].iloc[1] == pytest.approx(0.5, abs=0.01)


def test_two_scans_are_compared_with_the_uncertainty_of_each_change(filled: Path) -> None:
    archive = Archive(filled)
    names = archive.rows("SELECT scene_id FROM scenes WHERE station = 'S2' ORDER BY captured_at DESC LIMIT 2")[
        "scene_id"
    ]
    after, before = (load_features(archive, load_scene_row(archive, str(name))) for name in names)
    rows = differences(before, after)
    worst = rows.iloc[0]
    assert (worst["feature_id"], worst["quantity"]) == ("R04", "height")
    one, other = (side["rivet"].set_index("rivet_id").loc["R04"] for side in (before, after))
    assert worst["difference_mm_2"] == other["height_mean_mm"] - one["height_mean_mm"]
    assert worst["difference_u95_mm_2"] == pytest.approx(np.hypot(one["height_u95_mm"], other["height_u95_mm"]))
    steps, seams = rows[rows["quantity"] == "step"], before["seam station"]
    assert len(steps) == len(seams)
    # Places of both scans, half a step apart: each has its nearest; a scan without the seam leaves them alone.
    shifted = {**after, "seam station": after["seam station"].assign(s_mm=after["seam station"]["s_mm"] + 0.5)}
    again = differences(before, shifted)
    assert again[again["quantity"] == "step"]["difference_mm_2"].notna().all()
    alone = differences(before, {**after, "seam station": after["seam station"].iloc[:0]})
    assert alone[alone["quantity"] == "step"]["difference_mm_2"].isna().all()


def test_any_number_of_scans_are_compared_with_the_first(filled: Path, open_page: Open) -> None:
    archive = Archive(filled)
    sql = "SELECT scene_id FROM scenes WHERE station = 'S1' ORDER BY captured_at"
    names = [str(name) for name in archive.rows(sql)["scene_id"]][2:]
    scans = [load_features(archive, load_scene_row(archive, name)) for name in names]
    without = [{**scans[0], "seam station": scans[0]["seam station"].iloc[:0]}, *scans[1:]]
    rows = differences(*scans)
    assert len(rows) == len(differences(*without)) == 12 + 2 * len(scans[0]["seam station"])
    assert differences(*without)[rows["quantity"] == "step"]["difference_mm_3"].isna().all()
    gap = rows[(rows["quantity"] == "width") & (rows["feature_id"] == scans[0]["seam station"]["feature_id"][3])].iloc[
        0
    ]
    for number, scan in enumerate(scans[1:], 2):
        one, other = scans[0]["seam station"].iloc[3], scan["seam station"].iloc[3]
        assert gap[f"difference_mm_{number}"] == pytest.approx(other["width_mm"] - one["width_mm"])
        u95 = np.hypot(one["width_u95_mm"], other["width_u95_mm"])
        assert gap[f"difference_u95_mm_{number}"] == pytest.approx(u95)
    # However they are named in the address, the first is the oldest.
    shown = clean(open_page("archive", filled, compare=",".join(reversed(names)))).dataframe[0].value
    drifting = shown[(shown["Feature"] == "R09") & (shown["Quantity"] == "height")].iloc[0]
    assert list(drifting[[f"Change 1 → {number}, mm" for number in (2, 3, 4)]] > 0) == [True] * 3


def test_findings_are_counted_by_what_is_alike_in_them(filled: Path, open_page: Open) -> None:
    archive = Archive(filled)
    counted = {by: outside_by(archive, Selection(), by) for by in PARETO}
    # The review's list, where a stretch is one line, too.
    found = findings(archive, Wanted(state="all"))
    outside = found[found["decision"].isin(["fail", "conditional fail"])]
    for by, column in (("panel", "panel"), ("station", "station"), ("aircraft", "aircraft_serial")):
        assert counted[by] == outside[column].value_counts().to_dict()
    of_kind = outside["feature_kind"].value_counts()
    assert counted["cause"] == {"height": of_kind["rivet"], "step": of_kind["seam station"]}
    assert sum(counted["fastener type"].values()) == of_kind["rivet"]
    assert counted["operator"] == {"M. Weber": len(outside)}
    assert (
        "Findings by" in clean(open_page("trends", filled, view="Pareto of panels", by="cause")).button_group[1].label
    )


def test_first_pass_yield_is_told_by_first_scans(writable: Path, open_page: Open) -> None:
    found = findings(Archive(writable), Wanted(state="all"))  # every scan of the week is the first of its station
    outside = set(found[found["decision"].isin(["fail", "conditional fail"])]["aircraft_serial"])
    assert first_pass(Archive(writable), "panel") == [Yield("LH-F12", 0, len(outside), 0)]
    fine = replace(recipe(0, "S1"), heights_mm=(0.0,) * 12, step_mm=0.0)
    for serial, days, unmeasured in (
        ("GOOD-1", -60, ()),
        ("VAGUE-1", -60, (5,)),
        # A re-scan that passes makes no first pass of it, nor does it bring the panel into a later month.
        (AIRCRAFT[0], 1, ()),
        ("VAGUE-1", -20, ()),
    ):
        key = replace(fine.key, aircraft_serial=serial, captured_at=fine.key.captured_at + timedelta(days=days))
        Store(writable).publish(synthetic_result(replace(fine, key=key, unmeasured=unmeasured)))
    week = Yield("2026-11", 0, len(outside), 0)
    assert first_pass(Archive(writable), "month") == [Yield("2026-09", 1, 0, 1), week]
    assert first_pass(Archive(writable), "month", since=fine.key.captured_at - timedelta(days=30)) == [week]
    of_aircraft = first_pass(Archive(writable), "aircraft", without=("MSN-*",))
    assert of_aircraft == [Yield("GOOD-1", 1, 0, 0), Yield("VAGUE-1", 0, 0, 1)]
    shown = clean(open_page("trends", writable, view="First-pass yield", **{"yield": "week"})).dataframe[0].value
    assert shown["Panels"].sum() == len(outside) + 2


def test_first_pass_yield_says_how_sure_it_is() -> None:
    low, high = Yield("P", 9, 1, 0).interval
    assert (low, high) == pytest.approx((0.55498, 0.99747), abs=1e-5)  # 9 of 10 by Clopper and Pearson
    assert Yield("P", 0, 3, 0).interval[0] == 0
    assert Yield("P", 3, 0, 0).interval[1] == 1
    assert Yield("P", 1, 0, 1).share == 0.5


def test_a_damaged_index_is_one_line(writable: Path, open_page: Open) -> None:
    target = Path(os.path.realpath(writable / "archive.duckdb"))
    target.chmod(0o644)
    target.write_bytes(b"not a database" * 1000)
    for name in ("overview", "archive", "scene", "review", "trends", "runs"):
        page = open_page(name, writable)
        assert not page.exception
        assert len(page.error) == 1
        assert "readable index" in page.error[0].value.replace("\\", "")


def test_quarantined_scenes_are_listed(writable: Path, tmp_path: Path, open_page: Open) -> None:
    folder = tmp_path / "inbox" / "quarantine"
    folder.mkdir(parents=True)
    (folder / "scan-7.reason.txt").write_text("scene.json: found no key 'rig', expected it\n")
    (writable / "dashboard.toml").write_text(f'inboxes = ["{tmp_path / "inbox"}"]\n')
    page = clean(open_page("runs", writable, view="Warnings and failures"))
    assert "found no key" in page.dataframe[-1].value.to_string()


def test_a_wrong_settings_file_is_one_line(writable: Path, open_page: Open) -> None:
    (writable / "dashboard.toml").write_text("roles = 7\n")
    page = open_page("overview", writable, view=WORK)
    assert not page.exception
    assert "dashboard.toml" in page.error[0].value.replace("\\", "")


def test_a_damaged_manifest_leaves_the_page_without_limits(writable: Path, open_page: Open) -> None:
    for manifest in writable.glob("bundles/*/*/*/*/manifest.json"):
        manifest.chmod(0o644)
        manifest.write_text('{"panel_spec": {"zones": {"default": {"height_mm": {"lower": 3, "upper": 1}}}}}')
    page = clean(open_page("scene", writable, scene=LAST))
    assert "This version cannot read the limits of this run" in texts(page)


def test_a_scan_with_an_unjudged_rig_is_counted_in_every_list(writable: Path, open_page: Open) -> None:
    sound = recipe(5, "S1", "RH-F99")
    sound = replace(sound, heights_mm=(0.0,) * 12, unmeasured=())
    assert "could not be judged" not in texts(open_page("overview", writable, view=WORK))
    Store(writable).publish(replace(synthetic_result(sound), rig_verdict="unjudged", warnings=("cannot tell",)))
    overview = clean(open_page("overview", writable, view=WORK))
    assert "Scans whose rig could not be judged: 1." in texts(overview)
    panels = overview.dataframe[0].value.set_index("Panel")["Rig not judged"]
    assert panels["RH-F99"] == 1
    assert panels["LH-F12"].sum() == 0
    listed = {
        verdict: set(open_page("archive", writable, verdict=verdict).dataframe[0].value["panel"])
        for verdict in ("rig unjudged", "all pass", "any verdict")
    }
    assert listed["rig unjudged"] == {"RH-F99"}
    assert "RH-F99" not in listed["all pass"]
    assert "RH-F99" in listed["any verdict"]
    assert "rig not judged" in texts(open_page("scene", writable, scene=sound.key.scene_id))
    assert open_page("runs", writable).dataframe[0].value["Rig not judged"].sum() == 1
    rigs = open_page("runs", writable, view="Rig health").dataframe[0].value.set_index("Rig calibration")
    assert rigs.loc["rig-2026-11-17", "Rig not judged"] == 1
    warned = open_page("runs", writable, view="Warnings and failures").dataframe[0].value
    assert list(warned["Rig check"][warned["Panel"] == "RH-F99"]) == ["unjudged"]


def test_a_scan_ahead_of_the_clock_is_listed_by_when_it_was_stored(writable: Path, open_page: Open) -> None:
    made = recipe(5, "S1", "RH-F99")
    ahead = replace(made.key, captured_at=made.key.captured_at.replace(year=2612))
    Store(writable).publish(synthetic_result(replace(made, key=ahead)))
    rigs = open_page("runs", writable, view="Rig health", numbers="ISO").dataframe[0].value
    assert rigs["Last used"].max().year < 2612
    assert rigs["Scans"].sum() == 13


def test_a_wrong_fastener_s_diameter_stands_beside_the_expected_one(writable: Path, open_page: Open) -> None:
    made = synthetic_result(recipe(5, "S1", "RH-F99"))
    rivets = [replace(rivet, diameter_nominal_mm=rivet.diameter_mm) for rivet in made.features["rivet"]]
    rivets[2] = replace(rivets[2], diameter_mm=8.0, diameter_u95_mm=0.05, diameter_nominal_mm=5.5)
    made = replace(made, features={**made.features, "rivet": judge(RIVET, rivets, load_panel_spec().limits)})
    Store(writable).publish(made)
    said = texts(clean(open_page("scene", writable, scene=made.key.scene_id, feature="rivet:R03"))).replace("\\", "")
    assert "8.000 ± 0.050" in said
    assert "of 5.5 mm expected" in said
    assert "wrong fastener: 8.0 mm, expected 5.5" in said


def test_new_results_show_without_a_restart(writable: Path, open_page: Open) -> None:
    page = open_page("overview", writable, view=WORK)
    assert "RH-F99" not in page.multiselect(key="panel").options
    Store(writable).publish(synthetic_result(recipe(0, "S3", "RH-F99")))
    page.run()
    assert "RH-F99" in page.multiselect(key="panel").options


def test_the_worst_rivet_of_last_night_is_first(filled: Path, open_page: Open) -> None:
    page = clean(open_page("review", filled, period="last night"))
    said = texts(page)
    assert "Rivet R04" in said
    assert "0.23" in said
    assert "outside" in said


def button(page: AppTest, begins: str) -> Any:
    """The button whose label begins so."""
    return next(button for button in page.button if button.label.startswith(begins))


def choose(page: AppTest, disposition: str, comment: str = "") -> AppTest:
    """Choose a disposition, give a name, and say why."""
    page = next(b for b in page.button if b.label == disposition).click().run()
    page.text_input(key="who").set_value("M. Weber")
    page = page.run()
    next(field for field in page.text_input if field.label == "Comment").set_value(comment)
    return page


def chosen_dispositions(page: AppTest) -> list[str]:
    """Buttons of dispositions that are chosen."""
    dispositions = [b for b in page.button if str(b.key).startswith("disposition-")]
    assert len(dispositions) == 5
    return [b.label for b in dispositions if b.proto.type == "primary"]


def test_disposing_is_recorded_with_what_was_shown(writable: Path, open_page: Open) -> None:
    page = clean(open_page("review", writable, period="last night"))
    page = clean(choose(page, "rework", "shave the head"))
    record = button(page, "Record")
    assert record.label.replace("\\", "") == "Record *rework* for R04 (MSN-0425 LH-F12 S2)"
    page = clean(record.click().run())
    assert "Recorded *rework* for R04 (MSN-0425 LH-F12 S2)." in texts(page).replace("\\", "")
    (entry,) = ReviewLog(writable).read().entries
    assert (entry.who, entry.disposition, entry.comment) == ("M. Weber", "rework", "shave the head")
    assert (entry.scene_id, entry.feature_id) == (LAST, "R04")
    assert entry.shown["value_mm"] == pytest.approx(WORST_HEIGHT, abs=0.01)
    assert entry.shown["software_version"] == "0.2.0"
    assert "example" in entry.shown["panel_spec"]


def test_part_and_work_order_of_rework_are_fields_of_the_entry(writable: Path, open_page: Open) -> None:
    page = choose(open_page("review", writable, period="last night"), "rework", "shave the head")
    for label, number in (("Part number", "MS20470"), ("Work order", "WO-9")):
        next(field for field in page.text_input if field.label == label).set_value(number)
    clean(button(page, "Record").click().run())
    (entry,) = ReviewLog(writable).read().entries
    assert (entry.comment, entry.numbers.given) == ("shave the head", {"part": "MS20470", "work order": "WO-9"})


def test_false_and_missed_fasteners_are_marked_and_taken_back(writable: Path, open_page: Open) -> None:
    def fill(page: AppTest, label: str, text: str) -> AppTest:
        next(field for field in page.text_input if field.label == label).set_value(text)
        return page

    page = clean(open_page("scene", writable, scene=LAST, feature="rivet:R04", view="Marks"))
    page = fill(fill(page, "Your name", "M. Weber").run(), "Why is it none?", "a spot of paint")
    page = clean(button(page, "No fastener at").click().run())
    assert "Marked: no fastener at R04." in texts(page)
    assert "Give your name, and the place" in texts(button(page, "A fastener was missed").click().run())
    for field, pixel in zip(page.number_input, (120, 80), strict=True):
        field.set_value(pixel)
    page = clean(button(page, "A fastener was missed").click().run())
    assert [field.value for field in page.number_input] == [None, None]
    false, missed = ReviewLog(writable).read().standing_marks(LAST)
    assert (false.feature_id, false.who, false.comment) == ("R04", "M. Weber", "a spot of paint")
    assert missed.mark is not None
    assert (missed.mark.u_px, missed.mark.v_px) == (120, 80)
    page = clean(open_page("review", writable, scene=LAST, feature="rivet:R04"))
    assert "no fastener here" in texts(page)
    page = fill(fill(page, "Your name", "K. Ito").run(), "Why is it taken back?", "it is one after all")
    page = clean(button(page, "Take back mark 1").click().run())
    assert ReviewLog(writable).read().standing_marks(LAST) == [missed]


def test_disposing_needs_a_name_and_a_disposition(writable: Path, open_page: Open) -> None:
    page = open_page("review", writable)
    assert "Choose a disposition" in texts(button(page, "Record").click().run())
    assert ReviewLog(writable).read().entries == ()


def test_accepting_asks_for_a_concession_where_the_settings_say_so(writable: Path, open_page: Open) -> None:
    (writable / "dashboard.toml").write_text("concessions = true\n")
    page = choose(open_page("review", writable, period="last night"), "use as is", "thin shim")
    assert "needs its concession" in texts(button(page, "Record").click().run())
    assert ReviewLog(writable).read().entries == ()
    next(field for field in page.text_input if field.label.startswith("Concession")).set_value("NCR-4711")
    clean(button(page, "Record").click().run())
    (entry,) = ReviewLog(writable).read().entries
    assert (entry.numbers.concession, entry.comment) == ("NCR-4711", "thin shim")


def test_the_list_says_how_far_beyond_the_limit_and_sorts_by_it(filled: Path, open_page: Open) -> None:
    page = clean(open_page("review", filled, aircraft="MSN-0425", sort="farthest beyond"))
    rows = page.dataframe[0].value
    assert rows["To limit"].iloc[0] == pytest.approx(0.1 - WORST_HEIGHT, abs=0.005)
    assert rows["To limit"].dropna().is_monotonic_increasing
    assert rows["To limit"].isna().iloc[-1]  # what was not measured comes last


def test_what_an_address_asks_for_in_vain_is_said(filled: Path, open_page: Open) -> None:
    page = open_page("review", filled, aircraft=["MSN-0425", "MSN-9999"], state="lost")
    said = texts(page).replace("\\", "")
    assert "shown without it: aircraft MSN-9999; state lost" in said
    assert "MSN-9999" not in texts(open_page("review", filled, aircraft="MSN-0425"))


def test_a_panel_is_signed_off_with_all_its_scans_or_not_at_all(writable: Path, open_page: Open) -> None:
    address = {"aircraft": "MSN-0420", "panel": "LH-F12"}
    (writable / "dashboard.toml").write_text('[roles.titles]\n"*" = "quality inspector"\n')
    page = clean(open_page("panel", writable, **address))
    assert "were not put together yet" in texts(page)
    archive = Archive(writable)
    for station in ("S1", "S2"):
        scene = next(str(s) for s in archive.rows("SELECT scene_id FROM scenes WHERE aircraft_serial = 'MSN-0420' "
                                                  f"AND station = '{station}'")["scene_id"])  # fmt: skip
        for standing in archive.standings(scene):
            shown = archive.shown(scene, standing.feature)
            assert shown is not None
            ReviewLog(writable).dispose("K. Ito", [shown], "use as is")
    page = open_page("panel", writable, **address)
    page.text_input(key="who").set_value("M. Weber")
    clean(button(page.run(), "Sign off panel").click().run())
    signed = ReviewLog(writable).read().sign_offs()
    assert {entry.who for entry in signed.values()} == {"M. Weber"}
    assert len(signed) == 2
    for entry in signed.values():
        assert entry.signature is not None
        assert "panel MSN-0420 LH-F12 released with 2 scans" in entry.signature.meaning
        assert (entry.signature.role, entry.signature.confirmed) == ("quality inspector", "given name")


def test_nothing_is_chosen_for_the_next_finding(writable: Path, open_page: Open) -> None:
    page = open_page("review", writable)
    page = choose(page, "scrap", "cracked")
    page = clean(button(page, "Record *scrap*").click().run())
    assert "Recorded" in texts(page)
    assert not chosen_dispositions(page)
    assert next(field for field in page.text_input if field.label == "Comment").value == ""


SHOWN = ShownFinding(LAST, "run", Feature("rivet", "R04"))


def test_a_decision_of_another_person_is_said_instead_of_overruled(writable: Path, open_page: Open) -> None:
    page = open_page("review", writable)
    page = clean(choose(page, "scrap"))
    ReviewLog(writable).dispose("K. Ito", [SHOWN], "use as is", "checked by hand")
    page = button(page, "Record *scrap* for R04").click().run()
    assert not page.exception
    (error,) = page.error
    assert "Not recorded" in error.value
    assert "R04: found it decided since it was shown (use as is by K.Ito" in error.value.replace("\\", "").replace(
        ". ", "."
    )
    assert [entry.who for entry in ReviewLog(writable).read().entries] == ["K. Ito"]
    # Shown anew: R04 with the other person's decision, nothing chosen.
    assert "Rivet R04" in texts(page)
    assert "checked by hand" in texts(page)
    assert not chosen_dispositions(page)


def test_open_work_is_counted_alike_and_can_be_closed(writable: Path, open_page: Open) -> None:
    waiting = {m.label: m.value for m in open_page("overview", writable, view=WORK).metric}
    ReviewLog(writable).dispose("K. Ito", [SHOWN], "rework")
    now = {m.label: m.value for m in open_page("overview", writable, view=WORK).metric}
    assert now["Waiting for a person"] == waiting["Waiting for a person"]
    assert (waiting["Open work"], now["Open work"]) == ("0", "1")
    assert "3 waiting, 1 open work" in texts(open_page("scene", writable, scene=LAST))
    page = open_page("review", writable, state="open work")
    assert "1 finding" in texts(page)
    assert "Open work: rework of R04" in texts(page)
    page.text_input(key="who").set_value("M. Weber")
    page = page.run()
    close = button(page, "Close *rework* of R04")
    page = close.click().run()
    assert "Give your name and the reason" in texts(page)
    next(field for field in page.text_input if field.label.startswith("Why")).set_value("work order 4711")
    page = clean(button(page, "Close *rework* of R04").click().run())
    assert "Closed *rework* of R04" in texts(page)
    last = ReviewLog(writable).read().entries[-1]
    assert (last.action, last.who, last.comment, last.feature_id) == ("close", "M. Weber", "work order 4711", "R04")
    assert "3 waiting, 1 decided" in texts(open_page("scene", writable, scene=LAST))


def test_a_decision_is_undone_with_a_reason(writable: Path, open_page: Open) -> None:
    ReviewLog(writable).dispose("K. Ito", [SHOWN], "scrap")
    page = open_page("review", writable, scene=LAST, feature="rivet:R04", state="all")
    page.text_input(key="who").set_value("M. Weber")
    page = button(page.run(), "Undo *scrap* of R04").click().run()
    assert "Give your name and the reason" in texts(page)
    next(field for field in page.text_input if field.label == "Why is it undone?").set_value("not cracked")
    page = clean(button(page, "Undo *scrap* of R04").click().run())
    assert "Undone: *scrap* of R04" in texts(page)
    assert "**decision undone** by M. Weber · not cracked" in texts(page)
    assert not [other for other in page.button if other.label.startswith("Undo")]
    assert "4 waiting" in texts(open_page("scene", writable, scene=LAST))


def test_an_undo_lets_no_part_pass_without_the_design_authority(
    writable: Path, open_page: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    ReviewLog(writable).dispose("K. Ito", [SHOWN], "use as is")
    ReviewLog(writable).dispose("K. Ito", [replace(SHOWN, last_entry=1)], "scrap")
    for authority in (True, False):
        person = Person("m.weber", "reviewer", True, authority)
        monkeypatch.setattr("dashboard.frame.current_person", lambda *_, person=person: person)
        page = clean(open_page("review", writable, scene=LAST, feature="rivet:R04", state="all"))
        assert bool([other for other in page.button if other.label.startswith("Undo")]) is authority


def test_a_signed_off_scene_offers_no_form(writable: Path, open_page: Open) -> None:
    log = ReviewLog(writable)
    log.dispose("a", [SHOWN], "scrap")
    log.sign_off("K. Ito", ShownScene(LAST, "run", {}, 1))
    page = clean(open_page("review", writable, scene=LAST, state="decided"))
    assert "this scan is locked" in texts(page)
    assert not [button for button in page.button if "Record" in button.label or "Sign off" in button.label]


def test_a_tampered_log_is_said_and_not_written(writable: Path, open_page: Open) -> None:
    log = ReviewLog(writable)
    for number in range(2):
        log.dispose("a", [replace(SHOWN, last_entry=number)], "rework")
    log.path.write_bytes(log.path.read_bytes().replace(b"rework", b"scrap ", 1))
    page = open_page("review", writable)
    assert not page.exception
    assert "expected" in texts(page)
    assert not [button for button in page.button if "Record" in button.label]
    assert "review log needs attention" in texts(open_page("overview", writable, view=WORK))


def test_the_query_page_answers_and_says_what_is_wrong(filled: Path, open_page: Open) -> None:
    page = clean(open_page("sql", filled))
    page.text_area(key="sql").set_value("SELECT count(*) AS n FROM rivets")
    run = next(button for button in page.button if button.label == "Run")
    page = clean(run.click().run())
    assert page.dataframe[0].value["n"][0] == 12 * 12
    page.text_area(key="sql").set_value("DROP TABLE rivets")
    page = next(button for button in page.button if button.label == "Run").click().run()
    assert not page.exception
    assert "read\\-only" in page.error[0].value


@pytest.mark.parametrize("question", [*QUESTIONS, *MORE])
def test_each_question_is_answered(question: str, filled: Path) -> None:
    answer = run_query(filled, {**QUESTIONS, **MORE}[question])
    assert len(answer.rows.columns) > 1


def test_a_question_is_answered_by_one_click_and_kept(filled: Path, open_page: Open) -> None:
    page = clean(open_page("sql", filled))
    page = clean(next(b for b in page.button if b.label == "Recurring at the same place").click().run())
    rows = page.dataframe[0].value
    assert list(rows["rivet_id"]) == ["R09", "R09"]  # it drifts on both stations
    assert list(rows["aircraft"]) == [4, 4]
    assert next(b for b in page.button if str(b.key).startswith("asked-0")).label.startswith("SELECT")
    page.toggle(key="sql_chart").set_value(True)
    clean(page.run())


def test_a_link_to_a_question_asks_it(filled: Path, open_page: Open) -> None:
    page = clean(open_page("sql", filled, query="Recurring at the same place"))
    assert list(page.dataframe[0].value["rivet_id"]) == ["R09", "R09"]
    # Choosing another one here does not, and neither does a text that somebody wrote.
    page.selectbox(key="query").set_value("By operator")
    assert list(clean(page.run()).dataframe[0].value["rivet_id"]) == ["R09", "R09"]
    assert not clean(open_page("sql", filled, sql="SELECT 7 AS seven")).dataframe
    assert not clean(open_page("sql", filled)).dataframe


def test_an_address_holds_a_query(filled: Path, open_page: Open) -> None:
    page = clean(open_page("sql", filled, sql="SELECT 7 AS seven, 1 AS one"))
    assert page.text_area(key="sql").value == "SELECT 7 AS seven, 1 AS one"
