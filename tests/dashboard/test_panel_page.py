"""The page of an assembled panel: its picture, what changed since another night, and what became of rework."""

from __future__ import annotations

import contextlib
import json
import shutil
from base64 import b64decode
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote
from xml.etree import ElementTree

import cv2
import numpy as np
import pandas as pd
import pytest
from streamlit.testing.v1 import AppTest

from dashboard import panels, same_place
from dashboard.before_after import before_and_after
from dashboard.data import Archive
from dashboard.figures.panel import panel_figure
from dashboard.figures.seam import seam_course_figure
from dashboard.locale import locale_of
from dashboard.panels import PanelPicture, in_scan, load_panel, stitched_pictures
from dashboard.pictures import shrunk
from dashboard.same_place import at_same_place, named, scans_of_place
from dashboard.scenes import load_features, load_scene_row
from dashboard.seam_course import seam_course, seam_names
from metrology.kinds import RIVET, SEAM_STATION
from metrology.results import PanelKey
from storage.archive import Store
from storage.archive.decisions import dispose, shown_finding
from storage.archive.panel_bundle import panel_document
from storage.archive.panel_changes import runs_of_panel
from storage.review import Feature, ReviewLog
from tasks.panel import assemble
from tests.support.panel_store import two_nights
from tests.support.week import AIRCRAFT

Open = Callable[..., AppTest]
ADDRESS = {"aircraft": "MSN-1", "panel": "P"}


@pytest.fixture(scope="module")
def nights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return two_nights(tmp_path_factory.mktemp("panel-page") / "store").root


def frames(page: AppTest, column: str) -> list[Any]:
    """The tables that have a column, none of them with a traceback beside it."""
    assert not page.exception
    assert not page.error
    return [frame.value for frame in page.dataframe if column in frame.value]


def texts(page: AppTest) -> str:
    return " ".join(element.value for kind in ("caption", "markdown", "info") for element in page.get(kind))


def test_the_picture_lies_under_the_features(nights: Path) -> None:
    archive = Archive(nights)
    view = load_panel(archive, "MSN-1", "P")
    assert view is not None
    picture = stitched_pictures(archive, view)[1]
    figure = panel_figure(view, None, locale_of(None, None), picture)
    [image] = figure.layout.images
    kind, __, drawing = image.source.partition(",")
    assert kind == "data:image/svg+xml"
    svg = ElementTree.fromstring(unquote(drawing))
    mask, grey = (_decoded(each) for each in svg.iter("{http://www.w3.org/2000/svg}image"))
    # Transparent where nothing was seen, and grey as stored elsewhere.
    seen = cv2.resize(picture.stitched.seen.astype(np.uint8), grey.shape[::-1], interpolation=cv2.INTER_AREA) > 0
    assert np.array_equal(mask > 0, seen)
    stored = shrunk(picture.stitched.grey, grey.shape[1])
    assert np.abs(grey[seen].astype(int) - stored[seen]).mean() < 3
    assert len(image.source) < 1_000_000
    heads = view.features["rivet"]
    assert image.x < heads["u_px"].min() < heads["u_px"].max() < image.x + image.sizex
    assert image.y < heads["v_px"].min() < heads["v_px"].max() < image.y + image.sizey
    (left, right), (lower, upper) = figure.layout.xaxis.range, figure.layout.yaxis.range
    assert left <= image.x < image.x + image.sizex <= right
    assert upper <= image.y < image.y + image.sizey <= lower


def _decoded(image: ElementTree.Element) -> np.ndarray:
    """The grey levels of a picture within an SVG."""
    content = np.frombuffer(b64decode(image.attrib["href"].partition(",")[2]), np.uint8)
    return np.asarray(cv2.imdecode(content, cv2.IMREAD_GRAYSCALE))


def test_the_map_of_deviations_is_small_enough_for_a_page(nights: Path) -> None:
    archive = Archive(nights)
    view = load_panel(archive, "MSN-1", "P")
    assert view is not None
    picture: PanelPicture = stitched_pictures(archive, view)[1]
    figure = panel_figure(view, None, locale_of(None, None), picture, deviation=True)
    [heat] = [trace for trace in figure.data if trace.type == "heatmap"]
    assert heat.z.size <= 150_000
    left, width = picture.stitched.left_mm, picture.stitched.size_mm[0]
    assert left <= heat.x0 < heat.x0 + heat.dx * (heat.z.shape[1] - 1) <= left + width
    assert not figure.layout.images


def test_a_stretch_that_nobody_saw_is_drawn_along_its_nominal_course(
    nights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive = Archive(nights)
    view = load_panel(archive, "MSN-1", "P")
    assert view is not None
    row = {"feature_id": "J01@0-40", "x_mm": 20.0, "y_mm": 5.0, "from_mm": 0.0, "to_mm": 40.0, "state": "not seen",
           "reason": None}  # fmt: skip
    seam = {"id": "J01", "course_mm": [[500, 5, 0], [900, 5, 0]]}
    monkeypatch.setattr(panels, "_judged_by", lambda manifest: {"seams": [seam]})
    view = panels.with_courses(archive, replace(view, coverage=pd.DataFrame([row])))
    figure = panel_figure(view, None, locale_of(None, None))
    [line] = [trace for trace in figure.data if trace.line.dash == "dot"]
    assert (min(line.x), max(line.x), set(line.y)) == (500, 540, {-5})
    assert figure.layout.xaxis.range[1] > 540


def test_a_panel_of_a_version_without_pictures_is_shown_as_marks(nights: Path, tmp_path: Path, open_page: Open) -> None:
    root = Path(shutil.copytree(nights, tmp_path / "store", symlinks=True))
    manifest = root / str(Store(root).query("SELECT bundle_path FROM panels").column(0)[0]) / "manifest.json"
    said = json.loads(manifest.read_text())
    del said["pictures"]
    manifest.chmod(0o644)
    manifest.write_text(json.dumps(said))
    page = open_page("panel", root, **ADDRESS)
    assert not page.exception
    assert "In the panel's own frame" in texts(page)


def test_changes_since_the_night_before(nights: Path, open_page: Open) -> None:
    page = open_page("panel", nights, **ADDRESS, view="Changes")
    [rows] = frames(page, "Change")
    found = dict(zip(rows["Feature"], rows["Change"], strict=True))
    assert found["N10"] == "cured"
    assert "worse" in found.values()


def test_what_became_of_rework(nights: Path, tmp_path: Path, open_page: Open) -> None:
    root = Path(shutil.copytree(nights, tmp_path / "store", symlinks=True))
    store = Store(root)
    first = runs_of_panel(store, PanelKey("MSN-1", "P"))[0]
    head = next(row for row in first.rows("panel_rivets") if row["rivet_id"] == "N10")
    with contextlib.closing(store.connect()) as connection:
        own = Feature("rivet", head["seen_as"][0])
        shown = shown_finding(connection, ReviewLog(root).read(), head["seen_by"][0], own)
    assert shown
    dispose(root, "m.weber", [shown], "rework")
    [rows] = frames(open_page("panel", root, **ADDRESS, view="Changes"), "Outcome")
    assert rows[["Feature", "Outcome"]].to_numpy().tolist() == [["N10", "cured"]]
    archive = Archive(root)
    view = load_panel(archive, "MSN-1", "P")
    assert view is not None
    found = before_and_after(archive, view, Feature("rivet", "N10"))
    assert found
    assert (found.disposition, found.state, found.same_names) == ("rework", "cured", True)
    assert found.before.scene.scene_id == head["seen_by"][0]
    assert found.after.scene.station == found.before.scene.station
    assert found.before.row.height_mean_mm == pytest.approx(0.2, abs=0.02)
    assert found.after.row.height_mean_mm == pytest.approx(0.0, abs=0.02)
    assert before_and_after(archive, view, Feature("rivet", "N11")) is None
    page = open_page("panel", root, **ADDRESS, feature="rivet:N10")
    said = texts(page)
    assert "Before" in said
    assert "After" in said
    assert len(page.get("image")) == 2
    assert not open_page("panel", root, **ADDRESS, feature="rivet:N11").get("image")
    unknown = replace(found.after, scene=found.after.scene._replace(registration="not recognised"))
    assert not replace(found, after=unknown).same_names


def test_work_that_no_later_scan_shows_has_no_after(nights: Path, tmp_path: Path, open_page: Open) -> None:
    root = Path(shutil.copytree(nights, tmp_path / "store", symlinks=True))
    store = Store(root)
    last = runs_of_panel(store, PanelKey("MSN-1", "P"))[-1]
    head = next(row for row in last.rows("panel_rivets") if row["decision"] == "fail")
    with contextlib.closing(store.connect()) as connection:
        own = Feature("rivet", head["seen_as"][0])
        shown = shown_finding(connection, ReviewLog(root).read(), head["seen_by"][0], own)
    assert shown
    dispose(root, "m.weber", [shown], "rework")
    [rows] = frames(open_page("panel", root, **ADDRESS, view="Changes"), "Outcome")
    assert list(rows["Outcome"]) == ["planned"]
    archive = Archive(root)
    view = load_panel(archive, "MSN-1", "P")
    assert view is not None
    assert before_and_after(archive, view, Feature("rivet", head["rivet_id"])) is None


def test_a_position_is_the_same_where_it_is_near() -> None:
    rows = pd.DataFrame({"seam_id": ["M1", "M1", "M2"], "s_mm": [10.0, 12.0, 10.9]})
    found: list[Any] = [named(SEAM_STATION, rows, *place) for place in (("M1", 11.2), ("M2", 10.0), ("M1", 14.0))]
    assert [row and row.s_mm for row in found] == [12.0, 10.9, None]


def test_the_same_place_on_other_aircraft_and_other_nights(filled: Path, open_page: Open) -> None:
    page = open_page("panel", filled, aircraft=AIRCRAFT[-1], panel="LH-F12")
    [slider] = page.select_slider
    assert (slider.label, list(slider.options), slider.value) == ("Aircraft", AIRCRAFT, AIRCRAFT[-1])
    assert "R04 on the scan of MSN-0425, station S2" in texts(page).replace("\\", "")
    page = slider.set_value(AIRCRAFT[2]).run()
    assert not page.exception
    assert f"R04 on the scan of {AIRCRAFT[2]}, station S2" in texts(page).replace("\\", "")
    assert "Found by its name" in texts(page)  # these scans know no frame of the panel


def test_a_place_is_known_by_the_panel_s_frame_or_else_by_its_name(
    filled: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive = Archive(filled)
    view = load_panel(archive, AIRCRAFT[-1], "LH-F12")
    assert view is not None
    found = in_scan(archive, view, Feature("rivet", "R19"))
    assert found is not None
    scenes = scans_of_place(archive, found.scene, ())
    assert scenes["aircraft_serial"].tolist() == AIRCRAFT
    assert scans_of_place(archive, found.scene, ("MSN-0421", "MSN-0425"))["aircraft_serial"].tolist() == [
        name for name in AIRCRAFT if name != "MSN-0421"
    ]  # its own stays
    other: Any = load_scene_row(archive, str(scenes["scene_id"].iloc[0]))
    there = at_same_place(archive, found, other)
    assert (there.feature, there.by_name) == (found.feature, True)
    for own, its in (("not recognised", None), (None, "not recognised")):
        apart = replace(found, scene=found.scene._replace(registration=own))
        assert not at_same_place(archive, apart, other._replace(registration=its)).comparable

    def moved(rows: pd.DataFrame, names: list[str]) -> pd.DataFrame:
        return rows.assign(feature_id=names, x_panel_mm=rows["x_mm"] + 500, y_panel_mm=rows["y_mm"], z_panel_mm=0.0)

    own = found.features["rivet"]
    placed = replace(found, features={"rivet": moved(own, own["feature_id"].tolist())})
    rows = load_features(archive, other, [RIVET])["rivet"]
    monkeypatch.setattr(same_place, "load_features", lambda *_: {"rivet": moved(rows, [*rows["feature_id"]][::-1])})
    names = dict(zip(rows["feature_id"], [*rows["feature_id"]][::-1], strict=True))
    there = at_same_place(archive, placed, other)
    assert (there.feature, there.by_name) == (Feature("rivet", names[found.feature.id]), False)


def test_a_seam_is_drawn_along_its_whole_length(writable: Path, open_page: Open) -> None:
    store = Store(writable)
    store.publish_panel(panel_document(assemble(store, PanelKey(AIRCRAFT[-2], "LH-F12"))))
    archive = Archive(writable)
    view = load_panel(archive, AIRCRAFT[-1], "LH-F12")
    assert view is not None
    assert seam_names(view) == ["M01", "M02"]
    course = seam_course(archive, view, "M02")
    step, gap = course.courses
    rows = store.query(
        "SELECT step_mm, width_mm, s_mm FROM panel_seam_stations WHERE aircraft_serial = ? AND seam_id = 'M02' "
        "ORDER BY s_mm", [AIRCRAFT[-1]],
    ).to_pandas()  # fmt: skip
    np.testing.assert_allclose(step.values, rows["step_mm"])
    np.testing.assert_allclose(gap.values, rows["width_mm"])
    np.testing.assert_allclose(course.s_mm, rows["s_mm"])
    # The example's limits, everywhere; what is beyond them is a stretch, and coloured so.
    lower, upper, *_serious = step.bounds
    assert (set(lower), set(upper)) == ({-0.2}, {0.2})
    assert list(step.severities) == ["blue" if abs(v) > 0.2 else "green" for v in step.values]
    assert any(abs(v) > 0.2 and first <= s <= last for v, s in zip(step.values, course.s_mm, strict=True)
               for first, last, _ in course.stretches)  # fmt: skip
    assert course.before == AIRCRAFT[-2]
    assert len(course.before_s_mm) == len(step.before) > 40
    # Where the air comes over B, a step of B above A falls away from it.
    seams = view.features["seam station"]
    blown = replace(view, features={**view.features, "seam station": seams.assign(step_into_wind_mm=-seams["step_mm"])})
    turned = seam_course(archive, blown, "M02")
    assert (turned.into_wind, turned.downstream, course.into_wind) == (True, -1, False)
    np.testing.assert_allclose(turned.courses[0].values, -step.values)
    figure = seam_course_figure(turned, Feature("seam station", "M02@136.0"), locale_of(None, None))
    carried = [name for trace in figure.data if trace.customdata is not None for name in trace.customdata]
    assert len(carried) == 2 * len(rows)
    page = open_page("panel", writable, aircraft=AIRCRAFT[-1], panel="LH-F12", view="Seam")
    assert f"{AIRCRAFT[-2]}, the aircraft before" in texts(page)


def test_the_air_is_an_arrow_on_the_map(nights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    view = load_panel(Archive(nights), "MSN-1", "P")
    assert view is not None
    seam = str(view.features["seam station"]["seam_id"].iloc[0])
    figure = panel_figure(view, None, locale_of(None, None), airflows={seam: (0.0, 2.0)})
    [arrow] = [note for note in figure.layout.annotations if note.showarrow]
    assert (arrow.ax, arrow.ay > 0) == (0, True)  # it begins below its tip, and the panel's y points upwards
