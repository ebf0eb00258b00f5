"""Dispositions: append-only, tamper-evident, closed by a sign-off."""

from __future__ import annotations

import json
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

from metrology.errors import FlushlineError, StoreError, UsageError
from storage.review import MAX_COMMENT, Feature, ReviewLog, station_id

RIVET = Feature("rivet", "R-07")
SHOWN = {RIVET: {"height_mean_mm": 0.061, "decision": "fail", "panel_spec": "LH-F12 B", "software_version": "0.1.0"}}


@pytest.fixture
def log(tmp_path: Path) -> ReviewLog:
    return ReviewLog(tmp_path)


def dispose(log: ReviewLog, disposition: str = "rework", scene: str = "A~P~S1~T", who: str = "m.weber") -> None:
    log.dispose(who, scene, "run-1", [RIVET], disposition, "shave the head", SHOWN)


def test_what_was_decided_comes_back_with_what_was_shown(log: ReviewLog) -> None:
    dispose(log)
    (entry,) = log.read().entries
    assert (entry.who, entry.disposition, entry.comment, entry.run_id) == (
        "m.weber",
        "rework",
        "shave the head",
        "run-1",
    )
    assert entry.shown == SHOWN[RIVET]
    assert entry.at.tzinfo is not None


def test_the_last_disposition_counts_and_the_first_stays_on_record(log: ReviewLog) -> None:
    dispose(log, "rework")
    dispose(log, "use as is")
    review = log.read()
    assert [entry.disposition for entry in review.entries] == ["rework", "use as is"]
    assert review.current()["A~P~S1~T", RIVET].disposition == "use as is"


def test_a_signed_off_scene_is_locked_and_others_are_not(log: ReviewLog) -> None:
    dispose(log)
    log.sign_off("k.ito", "A~P~S1~T", "run-1", "", {"n_rivets": 24})
    before = log.path.read_bytes()
    with pytest.raises(UsageError, match=r"signed off by k\.ito"):
        dispose(log)
    with pytest.raises(UsageError, match="signed off"):
        log.sign_off("m.weber", "A~P~S1~T", "run-1", "", {})
    assert log.path.read_bytes() == before
    dispose(log, scene="A~P~S2~T")
    assert set(log.read().sign_offs()) == {"A~P~S1~T"}


@pytest.mark.parametrize(
    "change",
    [
        lambda lines: [lines[0].replace("rework", "use as is"), *lines[1:]],
        lambda lines: lines[1:],
        lambda lines: [lines[0], lines[2]],
        lambda lines: [lines[1], lines[0], lines[2]],
        lambda lines: [lines[0], "{not json", lines[2]],
        lambda lines: [lines[0], json.dumps({**json.loads(lines[1]), "extra": 1}), lines[2]],
        lambda lines: [lines[0], lines[1], json.dumps({**json.loads(lines[2]), "at": "20261128090000"})],
        lambda lines: [lines[0], lines[1], json.dumps({**json.loads(lines[2]), "at": 1795000000})],
    ],
)
def test_a_log_changed_behind_its_back_says_so_and_takes_no_more(log: ReviewLog, change) -> None:
    for _ in range(3):
        dispose(log)
    lines = log.path.read_text().splitlines()
    log.path.write_text("\n".join(change(lines)) + "\n")
    assert log.read().problem
    with pytest.raises(StoreError, match="nothing more is written"):
        dispose(log)


def test_a_write_that_a_crash_cut_short_is_no_entry(log: ReviewLog) -> None:
    dispose(log)
    with log.path.open("ab") as file:
        file.write(b'{"format": "flushline-review/1", "number": 2, "who": "a very lo')
    assert len(log.read().entries) == 1
    dispose(log, "scrap")
    review = log.read()
    assert review.problem is None
    assert [entry.disposition for entry in review.entries] == ["rework", "scrap"]


def _many(root: Path) -> None:
    for _ in range(10):
        dispose(ReviewLog(root), who="someone")


def test_two_people_at_once_lose_nothing(tmp_path: Path) -> None:
    with ProcessPoolExecutor(2) as people:
        for done in [people.submit(_many, tmp_path) for _ in range(2)]:
            done.result()
    review = ReviewLog(tmp_path).read()
    assert review.problem is None
    assert [entry.number for entry in review.entries] == list(range(1, 21))


@pytest.mark.parametrize(
    "wrong",
    [
        {"who": "  "},
        {"disposition": "ignore"},
        {"features": []},
        {"comment": "x" * (MAX_COMMENT + 1)},
    ],
)
def test_what_makes_no_sense_is_refused(log: ReviewLog, wrong: dict) -> None:
    good = {
        "who": "m.weber",
        "scene_id": "s",
        "run_id": "r",
        "features": [RIVET],
        "disposition": "rework",
        "comment": "",
        "shown": SHOWN,
    }
    with pytest.raises(UsageError):
        log.dispose(**{**good, **wrong})
    assert log.read().entries == ()


def test_lines_and_quotes_in_a_comment_stay_in_one_entry(log: ReviewLog) -> None:
    comment = 'first\nsecond \u2028 "third" \\ {'
    log.dispose("ü", "s", "r", [RIVET], "repair", comment, SHOWN)
    dispose(log)
    review = log.read()
    assert review.problem is None
    assert review.entries[0].comment == comment


def test_a_place_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "reviews").write_text("in the way")
    with pytest.raises(FlushlineError, match="review log"):
        dispose(ReviewLog(tmp_path))
    assert ReviewLog(tmp_path / "nowhere").read().entries == ()


def test_station_names_do_not_depend_on_the_last_digit() -> None:
    assert station_id("S1", 24.000000001) == station_id("S1", 23.9999999) == "S1@24.0"
