"""The page of an assembled panel: its picture, what changed since another night, and what became of rework."""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from streamlit.testing.v1 import AppTest

from dashboard import panels
from dashboard.data import Archive
from dashboard.figures.panel import panel_figure
from dashboard.locale import locale_of
from dashboard.panels import PanelPicture, load_panel, stitched_pictures
from metrology.results import PanelKey
from storage.archive import Store
from storage.archive.decisions import dispose, shown_finding
from storage.archive.panel_changes import runs_of_panel
from storage.review import Feature, ReviewLog
from tests.support.panel_store import two_nights

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
    assert image.source.startswith("data:image/webp;base64,")
    assert len(image.source) < 1_000_000
    heads = view.features["rivet"]
    assert image.x < heads["u_px"].min() < heads["u_px"].max() < image.x + image.sizex
    assert image.y < heads["v_px"].min() < heads["v_px"].max() < image.y + image.sizey
    (left, right), (lower, upper) = figure.layout.xaxis.range, figure.layout.yaxis.range
    assert left <= image.x < image.x + image.sizex <= right
    assert upper <= image.y < image.y + image.sizey <= lower


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
