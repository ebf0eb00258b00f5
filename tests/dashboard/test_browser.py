"""The ways a person takes, in a real browser: worst rivet of last night, why, dispose, export, trend, query.

Screenshots go to docs/images where FLUSHLINE_SCREENSHOTS is set, else to a temporary folder.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from metrology.results import SceneKey
from storage.archive.decisions import mark_false, mark_missed, shown_finding
from storage.archive.store import Store
from storage.review import Feature, ReviewLog, ShownScene
from tests.support.browser import choose, entries_of, new_page, record, settle
from tests.support.synthetic_scene import Recipe, synthetic_result
from tests.support.week import AIRCRAFT, BEFORE, ROOT, recipe

pytestmark = pytest.mark.browser

MOST_BYTES = 300_000
LAST = len(AIRCRAFT) - 1


# Where Plotly drew the station in the middle of the seam, in pixels of the page.
MIDDLE_STATION = """() => {
    const plot = [...document.querySelectorAll('.js-plotly-plot')].find(p => p._fullLayout.images.length);
    const trace = plot._fullData.find(t => t.customdata && String(t.customdata[0]).startsWith('station'));
    const i = Math.floor(trace.x.length / 2), box = plot.getBoundingClientRect(), layout = plot._fullLayout;
    return [box.x + layout.xaxis._offset + layout.xaxis.l2p(trace.x[i]),
            box.y + layout.yaxis._offset + layout.yaxis.l2p(trace.y[i])];
}"""


# Where Plotly drew the middle one of the positions that have a colour, in the last chart's upper part.
SEAM_POINT = """() => {
    const plot = [...document.querySelectorAll('.js-plotly-plot')].at(-1);
    const trace = plot._fullData.find(t => t.customdata), k = Math.floor(trace.x.length / 2);
    const box = plot.getBoundingClientRect(), x = plot._fullLayout.xaxis, y = plot._fullLayout.yaxis;
    return [box.x + x._offset + x.d2p(trace.x[k]), box.y + y._offset + y.d2p(trace.y[k])];
}"""


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where screenshots go."""
    folder = (
        ROOT / "docs" / "images" if os.environ.get("FLUSHLINE_SCREENSHOTS") else tmp_path_factory.mktemp("pictures")
    )
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def shoot(page: Any, folder: Path, name: str) -> None:
    """A screenshot that is small enough for the repository, with the colours of small marks kept."""
    path = folder / f"dashboard-{name}.png"
    page.screenshot(path=path)
    if path.stat().st_size > MOST_BYTES:
        from PIL import Image

        Image.open(path).convert("RGB").quantize(256, Image.Quantize.MAXCOVERAGE).save(path, optimize=True)
    assert path.stat().st_size <= MOST_BYTES


def test_from_the_worst_rivet_to_its_disposition_report_trend_and_query(
    server: tuple[str, Path], chromium: Any, pictures: Path
) -> None:
    address, root = server
    page = new_page(chromium)
    page.goto(address)
    page.get_by_text("Select one for its picture").wait_for()
    settle(page)
    shoot(page, pictures, "overview")

    # The worst rivet of last night …
    page.get_by_role("link", name="Tolerance review").first.click()
    page.get_by_text("Disposition", exact=True).filter(visible=True).first.wait_for()
    page.get_by_role("combobox", name="Scanned").click()
    page.get_by_role("option", name="last night").click()
    page.get_by_text("Rivet R04").wait_for()
    settle(page)
    assert "period=last+night" in page.url
    shoot(page, pictures, "review")

    # … why …
    page.get_by_role("link", name="Close-up").click()
    page.get_by_text("head as fitted").filter(visible=True).first.wait_for()
    settle(page)
    page.get_by_text("mm outside").filter(visible=True).first.wait_for()
    shoot(page, pictures, "scene")

    # … what shall happen with it …
    page.go_back()
    page.get_by_text("Disposition", exact=True).filter(visible=True).first.wait_for()
    settle(page)
    choose(page, "scrap", "cracked", who="M. Weber")
    record(page, "Record scrap for R04 (MSN-0425 LH-F12 S2)")
    (entry,) = entries_of(root, "MSN-0425")
    assert (entry.feature_id, entry.disposition, entry.comment) == ("R04", "scrap", "cracked")

    # … the report …
    page.get_by_role("combobox", name="State").click()
    page.get_by_role("option", name="decided").click()
    page.get_by_text("M. Weber").filter(visible=True).first.wait_for()
    settle(page)
    page.get_by_role("button", name="Export").click()
    with page.expect_download() as download:
        page.get_by_role("button", name="HTML report").click()
    report = Path(download.value.path()).read_text()
    assert "R04" in report
    assert "scrap, M. Weber" in report
    page.keyboard.press("Escape")

    # … its trend …
    page.get_by_role("link", name="Trend", exact=True).first.click()
    page.get_by_text("Ppk", exact=True).wait_for()
    settle(page)
    assert "name=R04" in page.url
    shoot(page, pictures, "trends")

    # … and a question of one's own.
    page.get_by_role("link", name="SQL").first.click()
    page.get_by_role("textbox", name="Query").fill(
        "SELECT who FROM dispositions WHERE scene_id LIKE 'MSN-0425%' AND comment = 'cracked'"
    )
    page.get_by_role("textbox", name="Query").press("Control+Enter")
    page.get_by_text("1 row", exact=True).wait_for()
    settle(page)
    shoot(page, pictures, "sql")


def test_a_click_on_the_picture_opens_the_close_up(server: tuple[str, Path], chromium: Any, pictures: Path) -> None:
    address, _ = server
    page = new_page(chromium, "dark", "de-DE")
    page.goto(f"{address}/scene?scene=MSN-0425~LH-F12~S2~20261119T212500Z")
    page.get_by_text("Niet R04").wait_for()
    settle(page)
    # Where Plotly drew the seam's stations: the chart's own axes tell.
    place = page.evaluate(MIDDLE_STATION)
    page.mouse.move(*place)
    page.wait_for_timeout(300)
    page.mouse.click(*place)
    page.get_by_text("Fuge M1 bei").filter(visible=True).first.wait_for()
    page.get_by_text("L1", exact=True).filter(visible=True).first.wait_for()
    settle(page)
    assert "feature=station" in page.url
    shoot(page, pictures, "seam-dark")


def prepare_pictures(root: Path) -> None:
    """Marks of people on last night's scan, and two aircraft whose panel passed by its first scans."""
    scene = recipe(LAST, "S2").key.scene_id
    store, log = Store(root), ReviewLog(root)
    [run] = store.query("SELECT run_id FROM scenes WHERE scene_id = ?", [scene]).column(0).to_pylist()
    with store.connect() as connection:
        shown = shown_finding(connection, log.read(), scene, Feature("rivet", "R02"))
    assert shown
    mark_false(root, "M. Weber", shown, "a drop of sealant")
    mark_missed(root, "K. Ito", ShownScene(scene, run, {}, 0), "between R09 and R10", (250.0, 330.0))
    for aircraft in ("MSN-0404", "MSN-0405"):
        key = SceneKey(aircraft, "RH-C07", "S9", BEFORE)
        store.publish(synthetic_result(Recipe(key, heights_mm=(0.0,) * 6, step_mm=0.05)))


def test_pages_fit_a_small_screen(server: tuple[str, Path], chromium: Any, pictures: Path) -> None:
    address, root = server
    prepare_pictures(root)
    scans = [recipe(night, "S2").key.scene_id for night in (3, 4, LAST)]
    light, dark = new_page(chromium), new_page(chromium, "dark", "de-DE")
    for page, path, name in (
        (light, "archive", "archive"),
        (light, "runs", "runs"),
        (light, f"scene?scene={scans[0]}&view=Deviation+map", ""),
        (light, "trends?what=panel", ""),
        (light, f"archive?compare={','.join(scans)}", "compare"),
        (light, f"scene?scene={scans[-1]}&view=Marks&feature=rivet:R02", "marks"),
        (dark, "trends?view=Pareto+of+panels&by=cause", "pareto-dark"),
        (dark, "trends?view=First-pass+yield", "yield-dark"),
    ):
        page.goto(f"{address}/{path}")
        page.get_by_text("Flushline ·").filter(visible=True).first.wait_for()
        settle(page)
        assert page.evaluate("document.querySelector('[data-testid=stMain]').scrollWidth") <= 1366
        if name:
            page.wait_for_timeout(300)  # charts are drawn a moment after the page is at rest
            shoot(page, pictures, name)


def test_a_click_on_a_seam_s_chart_opens_the_close_up(server: tuple[str, Path], chromium: Any, pictures: Path) -> None:
    page = new_page(chromium)
    page.goto(f"{server[0]}/panel?aircraft=MSN-0425&panel=LH-F12&view=Seam&seam=M02")
    page.get_by_text("Coloured bands").wait_for()
    settle(page)
    place = page.evaluate(SEAM_POINT)
    page.mouse.move(place[0] - 3, place[1])
    page.mouse.move(*place)
    page.locator(".hoverlayer .hovertext").filter(visible=True).first.wait_for()
    shoot(page, pictures, "panel")
    page.mouse.click(*place)
    page.get_by_text("Seam M02 at").filter(visible=True).first.wait_for()
    settle(page)
    assert "feature=station%3AM02" in page.url
    assert "view=" not in page.url


def test_the_home_page_by_its_name(server: tuple[str, Path], chromium: Any) -> None:
    page = new_page(chromium)
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(f"{server[0]}/overview?aircraft=MSN-0424")
    page.get_by_text("Where work waits").wait_for()
    settle(page)
    assert page.get_by_text("Page not found").count() == 0
    assert page.url == f"{server[0]}/?aircraft=MSN-0424"
    page.get_by_role("link", name="Trends").first.click()
    page.get_by_text("Ppk", exact=True).wait_for()
    page.go_back()
    page.get_by_text("Where work waits").wait_for()
    # A factory's network has no internet: everything comes from this server.
    assert [url for url in asked if not url.startswith((server[0], "data:", "blob:"))] == []
