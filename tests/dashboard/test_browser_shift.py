"""What a shift asks of the pages, in a real browser: few lines, few keys, and answers by one click that are right."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dashboard.questions import QUESTIONS
from metrology.kinds import SEAM_STATION
from metrology.results import SceneKey
from metrology.tolerance import judge
from storage.archive.store import Store
from storage.archive.work import DECIDED, standings
from storage.panel_spec import load_panel_spec
from storage.review import ReviewLog
from tests.support.browser import entries_of, new_page, settle
from tests.support.synthetic_scene import Recipe, synthetic_result
from tests.support.week import BEFORE

pytestmark = pytest.mark.browser
POSITIONS, FINDINGS, MOST_KEYS = 92, 50, 3
KEYED = 10  # of the fifty are decided here, each disposition twice: all of them take a minute, and no other key


def review_of(chromium: Any, address: str, aircraft: str) -> Any:
    """The review of an aircraft, with the reviewer's name given."""
    page = new_page(chromium)
    page.goto(f"{address}/review?aircraft={aircraft}")
    page.get_by_text("Disposition", exact=True).filter(visible=True).first.wait_for()
    settle(page)
    page.get_by_role("textbox", name="Your name").fill("M. Weber")
    page.get_by_role("textbox", name="Your name").press("Tab")
    settle(page)
    page.evaluate("document.activeElement.blur()")
    return page


def test_92_findings_of_a_seam_are_one_line(server: tuple[str, Path], chromium: Any) -> None:
    address, root = server
    store, key = Store(root), SceneKey("MSN-0401", "LH-F12", "S9", BEFORE)
    sound = synthetic_result(Recipe(key, heights_mm=(0.0,) * 6))
    # Twice as many positions, each beyond the limit of 0.2 mm.
    rows = [
        replace(row, s_mm=row.s_mm + shift, step_mm=0.31)
        for row in sound.features[SEAM_STATION.name]
        for shift in (0.0, 2.0)
    ][:POSITIONS]
    rows = judge(SEAM_STATION, rows, load_panel_spec().limits)
    store.publish(replace(sound, features={**sound.features, SEAM_STATION.name: tuple(rows)}))
    [found] = store.query(
        "SELECT count(*) AS n FROM seam_stations WHERE scene_id = ? AND decision = 'fail'", [key.scene_id]
    ).to_pylist()
    assert found["n"] == POSITIONS

    page = review_of(chromium, address, key.aircraft_serial)
    page.get_by_text("1 finding", exact=True).wait_for()
    assert page.get_by_text("Seam M1 0–182 mm").count()
    page.keyboard.press("s")
    page.get_by_role("button", name="Record scrap for M1 0–182 mm").wait_for()
    settle(page)
    page.keyboard.press("Enter")
    page.get_by_text("Nothing waits here").filter(visible=True).first.wait_for()
    [entry] = entries_of(root, key.aircraft_serial)
    assert (entry.feature_id, entry.disposition) == ("M1@0.0-182.0", "scrap")
    with store.connect() as connection:
        assert {s.state for s in standings(connection, ReviewLog(root).read(), key.scene_id)} == {DECIDED}
    page.close()


def test_fifty_findings_take_three_keys_each_at_most(server: tuple[str, Path], chromium: Any) -> None:
    address, root = server
    key = SceneKey("MSN-0402", "LH-F12", "S9", BEFORE)
    heights = tuple(0.15 + 0.002 * k for k in range(FINDINGS))
    Store(root).publish(synthetic_result(Recipe(key, heights, step_mm=0.05)))
    page = review_of(chromium, address, key.aircraft_serial)
    page.get_by_text(f"{FINDINGS} findings", exact=True).wait_for()
    pressed = 0

    def press(letter: str) -> None:
        nonlocal pressed
        pressed += 1
        page.keyboard.press(letter)

    record = page.get_by_role("button", name="Record")
    # Down and up again first: who looks before deciding needs the third key.
    first = record.inner_text().split(" for ")[-1].split("\n")[0]
    press("j")
    record.filter(has_not_text=first).wait_for()
    press("k")
    record.filter(has_text=first).wait_for()
    settle(page)
    looked, pressed = pressed, 0
    assert looked == 2
    letters = {"u": "use as is", "w": "rework", "p": "repair", "s": "scrap", "n": "re-scan"}
    for k in range(1, KEYED + 1):
        letter = "uwpsn"[(k - 1) % len(letters)]
        press(letter)
        page.get_by_role("button", name=f"Record {letters[letter]} for").wait_for()
        page.wait_for_function(_AT_REST)
        press("Enter")
        if k < KEYED:
            page.get_by_role("button", name=f"Record {letters[letter]} for").wait_for(state="detached")
            page.wait_for_function(_AT_REST)
    page.get_by_text("Recorded").filter(visible=True).first.wait_for()
    settle(page)
    assert looked // 2 + pressed / KEYED <= MOST_KEYS  # with a step down for each, and none back
    entries = entries_of(root, key.aircraft_serial)
    assert len({entry.feature_id for entry in entries}) == len(entries) == KEYED
    assert [entry.disposition for entry in entries] == 2 * list(letters.values())
    # What is used as it is, or scrapped, is decided; work stays in the list.
    page.get_by_text(f"{FINDINGS - 2 * KEYED // len(letters)} findings", exact=True).wait_for()
    page.close()


_AT_REST = '() => document.querySelector(\'[data-testid="stApp"][data-test-script-state="notRunning"]\')'


def newest(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows of the newest scan of each station."""
    last = rows.groupby(["aircraft_serial", "panel", "station"])["captured_at"].transform("max")
    return rows[rows["captured_at"] == last]


@pytest.fixture
def tables(server: tuple[str, Path]) -> dict[str, pd.DataFrame]:
    """What the shared store holds, to reckon answers from without SQL."""
    store = Store(server[1])
    return {name: store.query(f"FROM {name}").to_pandas() for name in ("scenes", "rivets", "seam_stations")}


def outside(rows: pd.DataFrame) -> pd.Series:
    return rows["decision"].isin(["fail", "conditional fail"])


def worst(answer: pd.DataFrame, tables: dict[str, pd.DataFrame]) -> None:
    in_order = ("pass", "conditional pass", "no limit")
    values = pd.concat(
        rows[~rows["decision"].isin(in_order)].assign(value=rows[column].abs())[["aircraft_serial", "value"]]
        for rows, column in (
            (newest(tables["rivets"]), "height_mean_mm"),
            (newest(tables["seam_stations"]), "step_mm"),
        )
    )
    expected = values.groupby("aircraft_serial")["value"].max()
    found = answer.set_index("aircraft_serial")["value_mm"].abs()
    pd.testing.assert_series_equal(found.sort_index(), expected.sort_index(), check_names=False, atol=1e-4)


def share_of_length(answer: pd.DataFrame, tables: dict[str, pd.DataFrame]) -> None:
    rows = newest(tables["seam_stations"])
    rows = rows[rows["decision"] != "not measured"]
    expected = 100 * outside(rows).groupby(rows["aircraft_serial"]).mean()
    found = answer.set_index("aircraft_serial")["percent_outside"]
    pd.testing.assert_series_equal(found.sort_index(), expected.sort_index(), check_names=False, atol=0.051)


def first_pass(answer: pd.DataFrame, tables: dict[str, pd.DataFrame]) -> None:
    scenes = tables["scenes"].sort_values("captured_at").drop_duplicates(["aircraft_serial", "panel", "station"])
    rows = pd.concat([tables["rivets"], tables["seam_stations"]])
    rows = rows[rows["scene_id"].isin(scenes["scene_id"])]
    passed = ~outside(rows).groupby([rows["panel"], rows["aircraft_serial"]]).any()
    expected = passed.groupby(level="panel").agg(["size", "sum"])
    found = answer.set_index("panel")[["aircraft", "passed_at_once"]].sort_index()
    assert found.to_numpy().tolist() == expected.to_numpy().tolist()


def never(answer: pd.DataFrame, tables: dict[str, pd.DataFrame]) -> None:
    rows = tables["rivets"]
    seen = rows["height_mean_mm"].notna().groupby([rows["aircraft_serial"], rows["station"], rows["rivet_id"]]).any()
    expected = {name for name, found in seen.items() if not found}
    assert expected
    assert expected <= set(answer[["aircraft_serial", "station", "name"]].itertuples(index=False, name=None))


def drift(answer: pd.DataFrame, tables: dict[str, pd.DataFrame]) -> None:
    rows = tables["rivets"].dropna(subset=["height_mean_mm"]).sort_values("captured_at")
    heights = rows[(rows["station"] == "S1") & (rows["rivet_id"] == "R09")]["height_mean_mm"].to_numpy(float)
    [found] = answer[(answer["station"] == "S1") & (answer["rivet_id"] == "R09")].to_dict("records")
    assert found["scans"] == len(heights)
    assert found["mm_each_scan"] == pytest.approx(np.polyfit(np.arange(len(heights)), heights, 1)[0], abs=1e-4)


def beyond(answer: pd.DataFrame, tables: dict[str, pd.DataFrame]) -> None:
    rivets, seams = newest(tables["rivets"]), newest(tables["seam_stations"])
    limits = 0.1, 0.2  # of the example specification
    expected = max(rivets["height_mean_mm"].abs().max() - limits[0], seams["step_mm"].abs().max() - limits[1])
    assert answer["beyond_mm"].iloc[0] == pytest.approx(expected, abs=1e-3)


def recurring(answer: pd.DataFrame, tables: dict[str, pd.DataFrame]) -> None:
    rows = newest(tables["rivets"])
    rows = rows[outside(rows)]
    aircraft = rows.groupby(["station", "rivet_id"])["aircraft_serial"].nunique()
    found = answer.set_index(["station", "rivet_id"])["aircraft"]
    assert found.to_dict() == aircraft[aircraft > 1].to_dict()


def by_type(answer: pd.DataFrame, tables: dict[str, pd.DataFrame]) -> None:
    rows = newest(tables["rivets"]).dropna(subset=["diameter_mm"])
    assert answer["rivets"].sum() == len(rows)
    assert answer["outside"].sum() == outside(rows).sum()


def by_operator(answer: pd.DataFrame, tables: dict[str, pd.DataFrame]) -> None:
    [found] = answer.to_dict("records")  # no scan of the store names anybody
    assert found["scans"] == len(tables["scenes"])
    assert found["features"] == len(tables["rivets"]) + len(tables["seam_stations"])


CHECKS: dict[str, Callable[[pd.DataFrame, dict[str, pd.DataFrame]], None]] = {
    "Worst of each aircraft": worst,
    "Share of seam length out of tolerance": share_of_length,
    "First-pass yield": first_pass,
    "Never measured": never,
    "Drift from aircraft to aircraft": drift,
    "Distance to the limit": beyond,
    "Recurring at the same place": recurring,
    "By fastener type": by_type,
    "By operator": by_operator,
}


def test_each_of_the_ten_questions_is_answered_by_one_click(
    server: tuple[str, Path], chromium: Any, tables: dict[str, pd.DataFrame]
) -> None:
    page = new_page(chromium)
    page.goto(f"{server[0]}/sql")
    page.get_by_role("button", name=next(iter(QUESTIONS))).wait_for()
    settle(page)
    assert len(QUESTIONS) == 10
    for question in QUESTIONS:
        page.get_by_role("button", name=question, exact=True).click()
        page.get_by_role("button", name="Download CSV").wait_for()
        settle(page)
        with page.expect_download() as download:
            page.get_by_role("button", name="Download CSV").click()
        answer = pd.read_csv(io.BytesIO(Path(download.value.path()).read_bytes()))
        if question == "Who decided what":
            log = ReviewLog(server[1]).read().entries
            assert answer["who"].tolist() == [entry.who for entry in reversed(log)]
            said = answer["comment"].astype(object).where(answer["comment"].notna(), "")
            assert said.tolist() == [entry.comment or "" for entry in reversed(log)]
        else:
            CHECKS[question](answer, tables)
    page.close()
