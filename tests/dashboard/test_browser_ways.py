"""Every way between pages, walked by clicks: what is clicked is what the next page shows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest

from tests.support.browser import click_point, click_row, new_page, settle

pytestmark = pytest.mark.browser
LAST = "MSN-0425~LH-F12~S2~20261119T212500Z"


def at(page: Any, path: str, **named: str) -> None:
    """Wait until the address is this page's and names these."""

    def there(url: str) -> bool:
        address = urlsplit(url)
        query = parse_qs(address.query)
        return address.path == f"/{path}" and all(query.get(name) == [value] for name, value in named.items())

    page.wait_for_url(there, wait_until="commit")
    settle(page)
    assert page.get_by_text("something it did not expect").count() == 0


def chosen(page: Any, field: str) -> str:
    """What a field with one value shows."""
    return str(page.get_by_role("combobox", name=field).first.input_value())


@pytest.fixture
def page(server: tuple[str, Path], chromium: Any) -> Iterator[Any]:
    page = new_page(chromium)
    yield page
    page.close()


def test_from_what_is_new_to_its_picture_its_trend_and_its_panel(server: tuple[str, Path], page: Any) -> None:
    home = server[0]
    page.goto(home)
    page.get_by_role("radio", name="New 6").or_(page.get_by_role("button", name="New 6")).filter(
        visible=True
    ).first.wait_for()
    settle(page)
    click_row(page, 0)
    at(page, "scene", scene=LAST, feature="rivet:R04")
    page.goto(f"{home}/?list=drifting")
    page.get_by_text("Moves each scan by").or_(page.get_by_text("its chart over time")).filter(
        visible=True
    ).first.wait_for()
    settle(page)
    click_row(page, 0)
    at(page, "trends", what="rivet", panel="LH-F12", name="R09")
    page.goto(home)
    page.get_by_text("select one to see it whole").wait_for()
    settle(page)
    click_row(page, 0, table=1)
    at(page, "panel", aircraft="MSN-0425", panel="LH-F12")


def test_a_panel_shows_a_feature_of_its_map_and_its_findings(server: tuple[str, Path], page: Any) -> None:
    page.goto(f"{server[0]}/panel?aircraft=MSN-0425&panel=LH-F12")
    page.get_by_text("the panel's own frame").wait_for()
    settle(page)
    assert page.get_by_text("Rivet R04").count()  # the gravest first
    click_point(page, 3)
    page.wait_for_url("**feature=*", wait_until="commit")
    settle(page)
    page.goto(f"{server[0]}/panel?aircraft=MSN-0425&panel=LH-F12&view=Findings")
    page.get_by_text("A stretch of a seam is one finding").wait_for()
    settle(page)
    click_row(page, 0)
    page.wait_for_url("**feature=rivet*", wait_until="commit")
    page.get_by_text("on the scan of MSN-0425, station").wait_for()
    page.goto(f"{server[0]}/panel?aircraft=MSN-0421&panel=LH-F12")
    page.get_by_text("were not put together yet").wait_for()


def test_from_the_overview_to_the_review(server: tuple[str, Path], page: Any) -> None:
    work = f"{server[0]}/?view=Where+work+waits"
    page.goto(work)
    page.get_by_text("select a row to review that panel").wait_for()
    settle(page)
    click_row(page, 0)
    at(page, "review", panel="LH-F12")
    aircraft = parse_qs(urlsplit(page.url).query)["aircraft"][0]
    page.get_by_text(f"{aircraft} · LH-F12").filter(visible=True).first.wait_for()
    # Back, and by a cell of the matrix.
    page.go_back()
    page.get_by_text("select a row to review that panel").wait_for()
    at(page, "")
    page.goto(work)
    page.get_by_text("select a row to review that panel").wait_for()
    settle(page)
    click_point(page, 2)
    at(page, "review", panel="LH-F12")
    # With a filter of its own, to another panel's review, the filter of the one page is not the other's.
    page.goto(f"{work}&aircraft=MSN-0424&period=last+30+days")
    page.get_by_text("select a row to review that panel").wait_for()
    settle(page)
    click_row(page, 0)
    at(page, "review", aircraft="MSN-0424", panel="LH-F12")
    assert chosen(page, "Scanned") == "any time"
    page.goto(work)
    page.get_by_role("link", name="Review what waits").click()
    at(page, "review")


def test_from_the_review_to_scene_trends_and_back(server: tuple[str, Path], page: Any) -> None:
    page.goto(f"{server[0]}/review?aircraft=MSN-0425&panel=LH-F12&scene={LAST}&feature=rivet:R09&numbers=German")
    page.get_by_text("Rivet R09").wait_for()
    settle(page)
    assert page.get_by_text("+0,139").count()
    page.get_by_role("link", name="Close-up").click()
    at(page, "scene", scene=LAST, feature="rivet:R09")
    page.get_by_text("Rivet R09").wait_for()
    assert page.get_by_text("+0,139").count()  # the way of writing numbers goes along
    page.get_by_role("link", name="Review", exact=True).click()
    at(page, "review", aircraft="MSN-0425", panel="LH-F12", scene=LAST)
    page.get_by_text("MSN-0425 · LH-F12 · S2").filter(visible=True).first.wait_for()
    # One click is one step back.
    settle(page)
    # Other tests may have decided about the gravest ones.
    record = page.get_by_role("button", name="Record for")
    first = record.inner_text().split(" for ")[-1].split("\n")[0]
    click_row(page, 1)
    page.wait_for_url("**feature=*", wait_until="commit")
    record.filter(has_not_text=first).wait_for()
    settle(page)
    page.go_back()
    at(page, "review", scene=LAST)
    assert "feature=" not in page.url
    record.filter(has_text=first).wait_for()
    page.get_by_role("link", name="Trend", exact=True).click()
    at(page, "trends", panel="LH-F12", station="S2")
    page.go_back()
    at(page, "review", scene=LAST)
    page.goto(f"{server[0]}/review?aircraft=MSN-0425&scene={LAST}&feature=rivet:R09&numbers=German")
    page.get_by_text("Rivet R09").wait_for()
    settle(page)
    page.get_by_role("link", name="Trend", exact=True).click()
    at(page, "trends", what="rivet", panel="LH-F12", station="S2", name="R09")
    assert (chosen(page, "Station"), chosen(page, "Rivet")) == ("S2", "R09")
    # A point of the control chart is a scan.
    click_point(page, 1)
    page.wait_for_url("**/scene?scene=*", wait_until="commit")
    settle(page)
    assert page.get_by_text("station S2").count()


def test_from_the_scene_by_its_table(server: tuple[str, Path], page: Any) -> None:
    page.goto(f"{server[0]}/scene?scene={LAST}&view=Table")
    page.get_by_text("Rivet R04").wait_for()
    settle(page)
    click_row(page, 1)
    at(page, "scene", scene=LAST, feature="rivet:R02", view="Table")
    page.get_by_text("Rivet R02").wait_for()
    click_row(page, 2, table=1)
    at(page, "scene", scene=LAST, feature="station:M1@8.0", view="Table")
    # The same row of the first table again, and after the browser's back button.
    click_row(page, 1)
    at(page, "scene", scene=LAST, feature="rivet:R02", view="Table")
    page.go_back()
    at(page, "scene", scene=LAST, feature="station:M1@8.0", view="Table")
    page.get_by_text("Seam M1 at 8 mm").wait_for()
    click_row(page, 1)
    at(page, "scene", scene=LAST, feature="rivet:R02", view="Table")
    click_row(page, 2, table=1)
    at(page, "scene", scene=LAST, feature="station:M1@8.0", view="Table")
    page.get_by_text("Seam M1 at 8 mm").wait_for()
    page.get_by_role("link", name="Trend", exact=True).click()
    at(page, "trends", what="seam", panel="LH-F12", station="S2", name="M1")
    page.goto(f"{server[0]}/scene?scene=nowhere")
    page.get_by_role("link", name="Find a scan in the archive").click()
    at(page, "archive")


def test_from_the_archive(server: tuple[str, Path], page: Any) -> None:
    page.goto(f"{server[0]}/archive?aircraft=MSN-0425")
    page.get_by_text("2 scans").wait_for()
    settle(page)
    click_row(page, 0, row_height=76, tick=True)
    page.get_by_test_id("stBaseButton-primary").click()
    at(page, "scene", scene=LAST)
    page.goto(f"{server[0]}/archive?aircraft=MSN-0425")
    page.get_by_text("2 scans").wait_for()
    settle(page)
    for row in (0, 1):
        click_row(page, row, row_height=76, tick=True)
    page.get_by_role("button", name="Compare").click()
    page.get_by_text("On these scans").wait_for()
    at(page, "archive", compare=f"{LAST},MSN-0425~LH-F12~S1~20261119T212000Z")
    page.get_by_role("button", name="Back to the list").click()
    page.get_by_text("scans, page").wait_for()
    at(page, "archive")


def test_from_the_runs_and_through_the_menu(server: tuple[str, Path], page: Any) -> None:
    page.goto(f"{server[0]}/runs?view=Warnings+and+failures")
    page.get_by_text("Inspected with warnings").wait_for()
    settle(page)
    click_row(page, 0)
    at(page, "scene", scene="MSN-0424~LH-F12~S2~20261118T212500Z")
    for name, path, said in (
        ("Tolerance review", "review", "Disposition"),
        ("Archive", "archive", "scans, page"),
        ("Trends", "trends", "Ppk"),
        ("Runs and rigs", "runs", "Scans inspected per day"),
        ("SQL", "sql", "Tables and views"),
        ("Overview", "", "Where work waits"),
    ):
        page.get_by_role("link", name=name).first.click()
        page.get_by_text(said).filter(visible=True).filter(visible=True).first.wait_for()
        at(page, path)
