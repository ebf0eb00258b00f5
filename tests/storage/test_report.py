"""Reports say all that was found and what it rests on, in one page that needs nothing else."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

from metrology.errors import StoreError
from metrology.inspection import InspectionResult
from metrology.kinds import SEAM_STATION
from metrology.tolerance import Limit, PanelSpec, judge
from storage.archive import Store
from storage.archive.enrolment import pattern_of
from storage.archive.schema import OF_KIND
from storage.panel_spec import load_panel_spec
from storage.report import panel_page, panel_record, rows_csv, scene_page, scene_record
from storage.report.overlays import write_overlays
from storage.report.redrawn import redrawn_overlay
from storage.review import Feature, ReviewLog, ShownFinding
from tests.support.results import small_key, small_result
from tests.support.week import fill

VOID = {"meta", "img", "br", "link", "image", "line", "ellipse", "rect", "circle", "polygon", "polyline", "path"}


class Checker(HTMLParser):
    """Text of a page; complains about tags that do not match and about anything fetched from elsewhere."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text: list[str] = []
        self.sources: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag not in VOID or (tag in ("ellipse", "rect", "circle", "polygon", "line")):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def read(page: str) -> str:
    checker = Checker()
    checker.feed(page)
    assert checker.open == []
    assert all(source.startswith(("data:", "#")) for source in checker.sources)
    return " ".join(" ".join(checker.text).split())


def result(**changes: object) -> InspectionResult:
    base = small_result(small_key("S3"))
    rivets = (
        base.features["rivet"][0],
        replace(
            base.features["rivet"][1], severity="red", decision="fail", reason="height +0.300 <b> outside; see DS-1"
        ),
        replace(
            base.features["rivet"][2],
            height_mean_mm=None,
            height_u95_mm=None,
            decision="not measured",
            reason="missing: no head",
        ),
    )
    return replace(
        base,
        features={**base.features, "rivet": rivets},
        panel_spec=load_panel_spec().document,
        warnings=("a & b",),
        **changes,
    )


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "store")
    store.publish(result())
    return store


def test_a_scene_page_is_whole_and_says_everything(store: Store) -> None:
    scene_id = small_key("S3").scene_id
    page = scene_page(scene_record(store, scene_id))
    text = read(page)
    for said in (
        "Inspection of MSN-1 LH-F12 S3", "2026-11-20 08:15:00 UTC", "a & b", "R1", "R3",
        "not measured", "missing: no head",
        "height +0.300 <b> outside", "+0.0500 ± 0.0040", "M1", "ISO 14253-1", "example, not for production", "rig-a",
        scene_id, "c0ffee", "flushline 0.1.0", "min_modulation", "over a rivet",
    ):  # fmt: skip
        assert said in text
    assert page.count("data:image/") == 2
    # The page's verdict is the gravest one: shown first.
    assert re.search(r"badge fail big", page)


def test_what_people_decided_is_in_the_report(store: Store) -> None:
    scene = scene_record(store, small_key("S3").scene_id)
    shown = ShownFinding(scene.scene["scene_id"], scene.scene["run_id"], Feature("rivet", "R2"), {"decision": "fail"})
    ReviewLog(store.root).dispose("B. Engineer", [shown], "rework", "shave the head")
    text = read(scene_page(scene_record(store, small_key("S3").scene_id)))
    assert "B. Engineer" in text
    assert "shave the head" in text
    assert "Findings: 3 waiting, 1 open work. Open work: R2." in text
    closed = ShownFinding(shown.scene_id, shown.run_id, shown.feature, {}, 1)
    ReviewLog(store.root).close("K. Ito", [closed], "work order 4711")
    text = read(scene_page(scene_record(store, small_key("S3").scene_id)))
    assert "Findings: 3 waiting, 1 decided." in text
    assert "work closed work order 4711" in " ".join(text.split())


def test_a_panel_page_leads_from_station_to_station(store: Store) -> None:
    later = small_result(small_key("S4"), rivets=2)
    store.publish(replace(later, panel_spec=load_panel_spec().document))
    record = panel_record(store, "MSN-1", "LH-F12")
    page = panel_page(record)
    text = read(page)
    assert "Station S3" in text
    assert "Station S4" in text
    assert 'href="#station-S4"' in page
    assert "Needs attention" in text
    # Stations that enrolled themselves have frames of their own: no common map.
    assert "Map" not in text.split()


def test_a_panel_with_a_nominal_pattern_has_a_map(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    base = result()
    placed = tuple(
        replace(r, x_panel_mm=10.0 * k, y_panel_mm=5.0, z_panel_mm=0.0) for k, r in enumerate(base.features["rivet"])
    )
    document = {**load_panel_spec().document, "panel": "LH-F12", "rivets": [{"id": "R1", "position_mm": [0, 5, 0]}]}
    store.publish(replace(base, features={**base.features, "rivet": placed}, panel_spec=document))
    assert "Map" in read(panel_page(panel_record(store, "MSN-1", "LH-F12"))).split()


def test_csv_has_every_column_and_empty_cells_for_what_was_not_measured(store: Store) -> None:
    scene = scene_record(store, small_key("S3").scene_id)
    text = rows_csv(scene.of_kind["rivet"], [column.name for column in OF_KIND["rivet"].columns])
    rows = list(csv.DictReader(io.StringIO(text, newline="")))
    assert [row["rivet_id"] for row in rows] == ["R1", "R2", "R3"]
    assert rows[2]["height_mean_mm"] == ""
    assert float(rows[0]["height_mean_mm"]) == 0.05
    assert rows[0]["captured_at"] == "2026-11-20T08:15:00Z"


def test_cells_are_no_formulas() -> None:
    assert rows_csv([{"a": "=1+1", "b": -0.5}], ["a", "b"]).splitlines()[1] == "'=1+1,-0.5"


def test_overlays_of_a_panel_make_a_folder_with_an_index(store: Store, tmp_path: Path) -> None:
    index = write_overlays(store, panel_record(store, "MSN-1", "LH-F12"), tmp_path / "overlays")
    page = index.read_text(encoding="utf-8")
    assert (index.parent / "S3.png").is_file()
    assert (index.parent / "S3.svg").is_file()
    assert 'href="S3.png"' in page
    assert 'href="S3.svg"' in page


def test_an_overlay_of_the_open_work_alone_with_names(tmp_path: Path) -> None:
    root = fill(tmp_path / "store")
    store = Store(root)
    (row,) = store.query(
        "SELECT scene_id, run_id FROM latest_scenes WHERE aircraft_serial = 'MSN-0425' AND station = 'S2'"
    ).to_pylist()
    scene, run = row["scene_id"], row["run_id"]
    with pytest.raises(StoreError, match="no open rework"):
        redrawn_overlay(store, scene, work_alone=True)
    ReviewLog(root).dispose("B. Engineer", [ShownFinding(scene, run, Feature("rivet", "R04"))], "rework")
    of_panel = store.query(
        "SELECT rivet_id, own FROM (SELECT rivet_id, unnest(seen_by) AS scene, unnest(seen_as) AS own "
        f"FROM panel_rivets) WHERE scene = '{scene}'"
    ).to_pylist()
    names = {row["own"]: row["rivet_id"] for row in of_panel}
    labels = {label.feature: label.text for label in redrawn_overlay(store, scene).labels if label.feature}
    assert names["R04"] != "R04"
    assert labels["R04"].startswith(f"{names['R04']} +0.24")
    work = [label.text for label in redrawn_overlay(store, scene, work_alone=True).labels if label.feature]
    assert work == [labels["R04"]]


def test_what_the_store_does_not_hold_is_said(store: Store) -> None:
    with pytest.raises(StoreError, match="no scene"):
        scene_record(store, "nothing")
    with pytest.raises(StoreError, match="MSN-9 LH-F12"):
        panel_record(store, "MSN-9", "LH-F12")


def test_limits_that_cannot_be_read_any_more_are_said(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    store.publish(small_result(small_key("S3")))
    text = read(scene_page(scene_record(store, small_key("S3").scene_id)))
    assert "cannot be read by this version" in text


def test_an_inspected_scene_becomes_a_pattern_of_what_was_found(store: Store) -> None:
    key, layout = pattern_of(store, small_key("S3").scene_id)
    assert key == small_key("S3")
    assert [rivet.rivet_id for rivet in layout.rivets] == ["R1", "R2"]
    assert list(layout.stations) == ["S3"]


def test_a_stretch_of_a_seam_is_one_line(tmp_path: Path) -> None:
    base = small_result()
    first = base.features["seam station"][0]
    rows = [replace(first, s_mm=2.0 * k, step_mm=0.1 * k, reason=None) for k in range(6)]
    judged = judge(SEAM_STATION, rows, PanelSpec("P", "A", {"default": {"step_mm": Limit(-0.25, 0.25)}}))
    store = Store(tmp_path / "store")
    store.publish(replace(base, features={**base.features, "seam station": tuple(judged)}))
    text = read(scene_page(scene_record(store, base.key.scene_id)))
    assert "findings: 1 " in text
    assert "from 6 to 10 mm (6 mm), worst at 10 mm: step +0.500" in text
