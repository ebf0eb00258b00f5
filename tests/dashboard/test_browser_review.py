"""A decision lands on what the person saw, in a real browser: two tabs, and scans stored meanwhile."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from dashboard.findings import feature_words
from dashboard.locale import Locale
from metrology.results import SceneKey
from storage.archive.store import Store
from storage.archive.work import standings
from storage.review import Entry, Feature, ReviewLog, ShownFinding
from tests.support.browser import SMALL, choose, click_row, entries_of, new_page, record, settle, wait
from tests.support.synthetic_scene import Recipe, synthetic_result
from tests.support.week import BEFORE, recipe

pytestmark = pytest.mark.browser


def open_review(chromium: Any, address: str, aircraft: str, **more: str) -> Any:
    """A tab that shows the review of an aircraft."""
    page = new_page(chromium)
    query = "&".join(f"{name}={value}" for name, value in {"aircraft": aircraft, **more}.items())
    page.goto(f"{address}/review?{query}")
    page.get_by_text("Disposition", exact=True).filter(visible=True).first.wait_for()
    settle(page)
    return page


def shown_name(page: Any) -> str:
    """The finding that the record button names."""
    label = page.get_by_role("button", name="Record").inner_text()
    return str(label.split(" for ")[-1].split("\n")[0])  # its key stands below


def words(entry: Entry) -> str:
    """What an entry is about, as the pages name it."""
    return feature_words(str(entry.feature_id), Locale("us"))


@pytest.fixture
def tabs(server: tuple[str, Path], chromium: Any) -> tuple[Any, Any, Path]:
    """Two tabs on the same list, and the store."""
    address, root = server
    return open_review(chromium, address, "MSN-0421"), open_review(chromium, address, "MSN-0421"), root


def test_two_tabs(tabs: tuple[Any, Any, Path]) -> None:
    first, second, root = tabs
    name = shown_name(first)
    assert name == shown_name(second)
    feature = name.split(" (")[0]
    choose(first, "scrap", "cracked", who="M. Weber")
    choose(second, "use as is", "checked by hand", who="K. Ito")
    record(second, f"Record use as is for {name}")
    # The second tab goes on, and to another aircraft.
    assert shown_name(second) != name
    second.goto(second.url.split("?")[0] + "?aircraft=MSN-0420")
    second.get_by_text("MSN-0420 LH-F12").filter(visible=True).first.wait_for()
    settle(second)

    record(first, f"Record scrap for {name}", "Not recorded")
    (entry,) = entries_of(root, "MSN-0421")
    assert (entry.who, entry.disposition, words(entry)) == ("K. Ito", "use as is", feature)
    assert first.get_by_text("found it decided since it was shown (use as is by K. Ito").count()
    # Shown anew: the same finding, with the other person's decision, and nothing chosen for it.
    assert shown_name(first) == name
    assert first.get_by_text("checked by hand").count()
    assert first.get_by_role("button", name=f"Record for {name}").count() == 1
    # Who has seen that decision may change it.
    choose(first, "scrap")
    record(first, f"Record scrap for {name}")
    assert [words(entry) for entry in entries_of(root, "MSN-0421")] == [feature, feature]
    # What was said of earlier decisions is offered.
    assert "checked by hand" in first.locator("#flushline-comments").inner_html()
    # The second tab decides about what it shows.
    other = shown_name(second)
    choose(second, "scrap", who="K. Ito")
    record(second, f"Record scrap for {other}")
    (entry,) = entries_of(root, "MSN-0420")
    assert words(entry) == other.split(" (")[0]


def test_a_scan_stored_between_showing_and_recording(server: tuple[str, Path], chromium: Any) -> None:
    address, root = server
    page = open_review(chromium, address, "MSN-0422")
    name = shown_name(page)
    choose(page, "scrap", who="M. Weber")
    # A graver scan of another station: other rows come first, and the finding is as it was.
    store = Store(root)
    store.publish(synthetic_result(replace(recipe(2, "S3"), heights_mm=(0.9,) * 12)))
    record(page, f"Record scrap for {name}")
    (entry,) = entries_of(root, "MSN-0422")
    assert f"{words(entry)} (MSN-0422 LH-F12" in name

    # The same scan inspected again, with other values: refused, and shown anew.
    name = shown_name(page)
    station = name.rstrip(")").split(" ")[-1]
    choose(page, "use as is", who="M. Weber")
    heights = (0.31, 0.32, 0.33, *recipe(2, station).heights_mm[3:])
    store.publish(synthetic_result(replace(recipe(2, station), heights_mm=heights, step_mm=0.3)))
    record(page, f"Record use as is for {name}", "Not recorded")
    assert page.get_by_text("was inspected again").count()
    assert shown_name(page) == name
    assert len(entries_of(root, "MSN-0422")) == 1

    # Several at once: all or none.
    page = open_review(chromium, address, "MSN-0422", kind="rivet")
    for row in (0, 2):
        click_row(page, row, tick=True)
    choose(page, "repair", who="M. Weber")
    (button,) = page.get_by_role("button", name="Record repair for 2 findings:").all()
    names = button.inner_text().split(": ")[-1].split("\n")[0]
    store.publish(synthetic_result(replace(recipe(2, "S3"), heights_mm=(0.8,) * 12)))
    record(page, f"Record repair for 2 findings: {names}", "Not recorded")
    assert len(entries_of(root, "MSN-0422")) == 1
    assert page.get_by_role("button", name="findings:").count() == 0  # nothing stays ticked
    for row in (0, 2):
        click_row(page, row, tick=True)
    choose(page, "repair", who="M. Weber")
    button = page.get_by_role("button", name="Record repair for 2 findings:")
    names = button.inner_text().split(": ")[-1].split("\n")[0]
    record(page, f"Record repair for 2 findings: {names}")
    recorded = [entry.feature_id for entry in entries_of(root, "MSN-0422")[1:]]
    assert ", ".join(map(str, recorded)) in names


def test_a_key_leads_to_the_name_which_stays(server: tuple[str, Path], chromium: Any) -> None:
    page = new_page(chromium, apart=True)
    page.goto(f"{server[0]}/review")
    name = page.get_by_role("textbox", name="Your name")
    name.wait_for()
    settle(page)
    page.keyboard.press("y")
    page.keyboard.type("Jörg Yilmaz")  # its letters are typed
    page.keyboard.press("Tab")
    settle(page)
    page.get_by_role("link", name="Archive").click()
    page.wait_for_url("**/archive**")
    settle(page)
    page.get_by_role("link", name="Tolerance review").click()
    for _ in range(2):
        name.wait_for()
        settle(page)
        assert name.input_value() == "Jörg Yilmaz"
        page.reload()
    page.context.close()


def test_a_sign_off_is_for_what_was_shown(server: tuple[str, Path], chromium: Any) -> None:
    address, root = server
    store, log = Store(root), ReviewLog(root)
    scene = recipe(3, "S1").key.scene_id
    [run] = store.query("SELECT run_id FROM scenes WHERE scene_id = ?", [scene]).column(0).to_pylist()
    with store.connect() as connection:
        findings = [standing.feature for standing in standings(connection, log.read(), scene)]
    log.dispose("K. Ito", [ShownFinding(scene, run, feature) for feature in findings], "use as is")

    page = open_review(chromium, address, "MSN-0423", state="decided", scene=scene)
    page.get_by_role("textbox", name="Your name").fill("M. Weber")
    page.get_by_role("textbox", name="Your name").press("Tab")
    settle(page)
    page.get_by_role("button", name="Sign off MSN-0423 LH-F12 S1 …").click()
    page.get_by_text("Signs: M. Weber").wait_for()
    settle(page)
    # Meanwhile somebody thinks better of one of them.
    feature = findings[0]
    last = log.read().last_about(scene, feature)
    log.dispose("K. Ito", [ShownFinding(scene, run, feature, {}, last.number if last else 0)], "scrap")
    page.get_by_role("button", name="Sign off MSN-0423 LH-F12 S1", exact=True).click()
    page.get_by_text("Not recorded").wait_for()
    settle(page)
    assert scene not in log.read().sign_offs()
    page.get_by_role("button", name="Sign off MSN-0423 LH-F12 S1 …").click()
    page.get_by_text("scrap: 1").wait_for()
    page.get_by_role("button", name="Sign off MSN-0423 LH-F12 S1", exact=True).click()
    page.get_by_text("this scan is locked").wait_for()
    assert log.read().sign_offs()[scene].who == "M. Weber"


def test_open_work_stays_until_a_later_scan_passes(server: tuple[str, Path], chromium: Any) -> None:
    address, root = server
    rivet = Feature("rivet", "R09")
    scene = recipe(4, "S2").key.scene_id
    page = open_review(chromium, address, "MSN-0424", scene=scene, feature="rivet:R09")
    choose(page, "rework", who="M. Weber")
    record(page, "Record rework for R09 (MSN-0424 LH-F12 S2)")
    page.goto(f"{address}/review?aircraft=MSN-0424&state=open+work")
    page.get_by_text("Open work: rework of R09").wait_for()
    settle(page)
    assert page.get_by_text("1 finding", exact=True).count()
    page.goto(f"{address}/scene?scene={scene}")
    page.get_by_text("1 open work").wait_for()
    sound = recipe(4, "S2")
    later = replace(sound.key, captured_at=sound.key.captured_at.replace(hour=23))
    heights = tuple(0.0 if i == 8 else height for i, height in enumerate(sound.heights_mm))
    Store(root).publish(synthetic_result(replace(sound, key=later, heights_mm=heights, warnings=())))
    page.goto(f"{address}/review?aircraft=MSN-0424&state=open+work")
    page.get_by_text("Nothing matches these filters").wait_for()
    last = ReviewLog(root).read().last_about(scene, rivet)
    assert last
    assert last.disposition == "rework"


def test_findings_are_decided_by_keys_alone(server: tuple[str, Path], chromium: Any) -> None:
    address, root = server
    own = SceneKey("MSN-0403", "LH-F12", "S9", BEFORE)
    Store(root).publish(synthetic_result(Recipe(own, heights_mm=(0.3, 0.25, 0.2, *[0.0] * 9), step_mm=0.05)))
    page = open_review(chromium, address, own.aircraft_serial)
    page.get_by_role("textbox", name="Your name").fill("M. Weber")
    page.get_by_role("textbox", name="Your name").press("Tab")
    settle(page)
    page.evaluate("document.activeElement.blur()")
    first = shown_name(page)
    page.keyboard.press("j")
    page.get_by_role("button", name="Record for").filter(has_not_text=first).wait_for()
    settle(page)
    second = shown_name(page)
    assert second != first
    click_row(page, 0)
    page.get_by_role("button", name=f"Record for {first}").wait_for()
    page.keyboard.press("j")
    page.get_by_role("button", name=f"Record for {second}").wait_for()
    settle(page)
    click_row(page, 0)  # the same cell again
    page.get_by_role("button", name=f"Record for {first}").wait_for()
    settle(page)
    # Two keys for a finding; the next one is looked at. No key waits for the page: what is pressed at once is acted on
    # in order, each on the finding that the one before led to.
    page.evaluate("document.activeElement.blur()")
    for key in ("j", "k", "w", "Enter", "s", "Enter"):
        page.keyboard.press(key)
    wait(lambda: len(entries_of(root, own.aircraft_serial)) == 2)
    rework, scrap = entries_of(root, own.aircraft_serial)
    assert (rework.disposition, words(rework)) == ("rework", first.split(" (")[0])
    assert (scrap.disposition, words(scrap)) == ("scrap", second.split(" (")[0])
    # A key that is pressed again chooses the same; Escape takes it back.
    settle(page)
    for key in ("u", "u"):
        page.keyboard.press(key)
    page.get_by_role("button", name="Record use as is for").wait_for()
    settle(page)
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Record for").wait_for()
    # All of it is on the screen of a laptop, without scrolling.
    settle(page)
    box = page.get_by_role("button", name="Sign off MSN-0403 LH-F12 S9 …").bounding_box()
    assert box["y"] + box["height"] <= SMALL[1] - 8
    assert page.evaluate("document.querySelector('[data-testid=stMain]').scrollTop") == 0
    # Enter on a button opens that, and records nothing.
    page.keyboard.press("u")
    page.get_by_role("button", name="Record use as is for").wait_for()
    page.get_by_role("button", name="Export").focus()
    page.keyboard.press("Enter")
    page.get_by_role("button", name="HTML report").wait_for()
    settle(page)
    assert len(entries_of(root, own.aircraft_serial)) == 2
