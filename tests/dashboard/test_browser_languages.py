"""The language in a real browser: the browser's own at first, kept over pages, and answers to clicks in it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.support.browser import new_page, settle

pytestmark = pytest.mark.browser


def test_a_language_is_kept_over_pages_and_clicks_are_answered_in_it(server: tuple[str, Path], chromium: Any) -> None:
    page = new_page(chromium, locale="de-DE")
    page.goto(f"{server[0]}/review?aircraft=MSN-0425")
    page.get_by_text("Entscheid", exact=True).filter(visible=True).first.wait_for()
    settle(page)
    # With the longest words, too, the button is on a small screen.
    record = page.get_by_role("button", name="Eintragen")
    box = record.bounding_box()
    assert box["y"] + box["height"] <= 768
    record.click()
    page.get_by_text("Wählen Sie einen Entscheid").wait_for()
    page.get_by_role("button", name="Export").click()
    with page.expect_download() as download:
        page.get_by_role("button", name="HTML-Bericht").click()
    report = Path(download.value.path()).read_text()
    assert "Toleranzprüfung" in report
    assert "außerhalb von −0,100 … +0,100" in report
    assert str(server[1]) not in report  # who reads it needs no path of the server
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Einstellungen").click()
    page.get_by_role("combobox", name="Sprache").click()
    page.get_by_role("option", name="English").click()
    page.get_by_text("Disposition", exact=True).filter(visible=True).first.wait_for()
    settle(page)
    page.keyboard.press("Escape")
    page.get_by_role("link", name="Trends").first.click()
    page.get_by_text("Run rules").wait_for()
    assert "language" not in page.url


def test_sql_names_are_completed(server: tuple[str, Path], chromium: Any) -> None:
    page = new_page(chromium)
    page.goto(f"{server[0]}/sql?sql=+")
    field = page.get_by_role("textbox", name="Query")
    field.wait_for()
    settle(page)
    field.fill("")
    page.keyboard.type("SELECT count(*) AS n FROM seam_st")
    page.locator(".flushline-names span").first.wait_for()
    page.keyboard.press("Tab")
    page.keyboard.type(" WHERE seam_stations.width_m")
    page.locator(".flushline-names span").first.wait_for()
    page.keyboard.press("Tab")
    assert field.input_value() == "SELECT count(*) AS n FROM seam_stations WHERE seam_stations.width_mm"
    page.keyboard.type(" > 0")
    page.keyboard.press("Control+Enter")
    page.get_by_text("1 row", exact=True).wait_for()
