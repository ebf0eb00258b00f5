"""Dispositions: append-only, tamper-evident, closed by a sign-off."""

from __future__ import annotations

import hashlib
import json
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

from metrology.errors import FlushlineError, OutdatedError, StoreError, UsageError
from metrology.kinds import SEAM_STATION
from storage import review_keeping
from storage.review import MAX_COMMENT, Feature, ReviewLog, ShownFinding, ShownScene
from storage.review_checking import check_log

SCENE = "A~P~S1~T"
RIVET = Feature("rivet", "R-07")
VALUES = {"height_mean_mm": 0.061, "decision": "fail", "panel_spec": "LH-F12 B", "software_version": "0.1.0"}


@pytest.fixture
def log(reviewed_store: Path) -> ReviewLog:
    return ReviewLog(reviewed_store)


def shown(log: ReviewLog, scene: str = SCENE, feature: Feature = RIVET, run: str = "run-1") -> ShownFinding:
    """A finding as somebody sees it who looks now."""
    last = log.read().last_about(scene, feature)
    return ShownFinding(scene, run, feature, VALUES, last.number if last else 0)


def shown_scene(log: ReviewLog, scene: str = SCENE) -> ShownScene:
    return ShownScene(scene, "run-1", {"n_rivets": 24}, log.read().last_of_scene(scene))


def dispose(log: ReviewLog, disposition: str = "rework", scene: str = SCENE, who: str = "m.weber") -> None:
    log.dispose(who, [shown(log, scene)], disposition, "shave the head")


def test_what_was_decided_comes_back_with_what_was_shown(log: ReviewLog) -> None:
    dispose(log)
    (entry,) = log.read().entries
    assert (entry.who, entry.disposition, entry.comment, entry.run_id) == (
        "m.weber",
        "rework",
        "shave the head",
        "run-1",
    )
    assert entry.shown == VALUES
    assert entry.at.tzinfo is not None


def test_the_last_disposition_counts_and_the_first_stays_on_record(log: ReviewLog) -> None:
    dispose(log, "rework")
    dispose(log, "use as is")
    review = log.read()
    assert [entry.disposition for entry in review.entries] == ["rework", "use as is"]
    assert review.current()["A~P~S1~T", RIVET].disposition == "use as is"


def test_a_signed_off_scene_is_locked_and_others_are_not(log: ReviewLog) -> None:
    dispose(log)
    log.sign_off("k.ito", shown_scene(log))
    before = log.head()
    with pytest.raises(UsageError, match=r"signed off by k\.ito"):
        dispose(log)
    with pytest.raises(UsageError, match="signed off"):
        log.sign_off("m.weber", shown_scene(log))
    assert log.head() == before
    dispose(log, scene="A~P~S2~T")
    assert set(log.read().sign_offs()) == {"A~P~S1~T"}


CHANGES = (
    lambda lines: [lines[0].replace("rework", "use as is"), *lines[1:]],
    lambda lines: lines[1:],
    lambda lines: [lines[0], lines[2]],
    lambda lines: [lines[1], lines[0], lines[2]],
    lambda lines: [lines[0], "{not json", lines[2]],
    lambda lines: [lines[0], json.dumps({**json.loads(lines[1]), "extra": 1}), lines[2]],
    lambda lines: [lines[0], lines[1], json.dumps({**json.loads(lines[2]), "at": "20261128090000"})],
    lambda lines: [lines[0], lines[1], json.dumps({**json.loads(lines[2]), "at": 1795000000})],
)


def old_log(log: ReviewLog, change=lambda lines: lines) -> Path:
    """Entries as an earlier version would have left them, in another store."""
    path = log.path.parents[2] / "old" / "reviews" / "log.jsonl"
    path.parent.mkdir(parents=True)
    lines = [entry.document for entry in log.read().entries]
    path.write_text("\n".join(change(lines)) + "\n")
    return path


@pytest.mark.parametrize("change", CHANGES)
def test_a_changed_log_of_an_earlier_version_is_read_up_to_there_and_not_taken_over(log: ReviewLog, change) -> None:
    for _ in range(3):
        dispose(log)
    path = old_log(log, change)
    before, old = path.read_bytes(), ReviewLog(path.parents[1])
    assert old.read().problem
    assert len(old.read().entries) < 3
    with pytest.raises(StoreError, match="nothing more is written"):
        dispose(old)
    assert path.read_bytes() == before
    assert old.read().problem


def test_a_log_of_an_earlier_version_is_taken_over_with_its_checksums(log: ReviewLog) -> None:
    dispose(log)
    dispose(log, "use as is", scene="A~P~S2~T")
    log.sign_off("k.ito", shown_scene(log))
    path = old_log(log)
    before, old = path.read_bytes(), ReviewLog(path.parents[1])
    assert old.read() == log.read()
    assert old.head() == log.head()
    assert not path.exists()
    assert path.with_name("log.jsonl.migrated").read_bytes() == before
    with pytest.raises(UsageError, match="signed off"):
        dispose(old)
    dispose(old, scene="A~P~S2~T")
    assert old.read().problem is None
    assert check_log(path.parents[1]).problems == ()


def test_what_an_earlier_version_writes_beside_the_database_is_told(log: ReviewLog) -> None:
    dispose(log)
    path = old_log(log)
    old = ReviewLog(path.parents[1])
    content = path.read_bytes()
    dispose(old)
    path.write_bytes(content)
    assert "earlier version wrote beside the database" in str(old.read().problem)
    with pytest.raises(StoreError, match="let no earlier version"):
        dispose(old)


def test_an_old_log_that_may_not_be_written_is_read_as_it_is(log: ReviewLog, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    dispose(log)
    path = old_log(log)
    monkeypatch.setattr(review_keeping, "locked", refuse)
    assert ReviewLog(path.parents[1]).read() == log.read()
    assert path.exists()


def test_a_write_that_a_crash_cut_short_is_no_entry(log: ReviewLog) -> None:
    dispose(log)
    path = old_log(log)
    with path.open("ab") as file:
        file.write(b'{"format": "flushline-review/1", "number": 2, "who": "a very lo')
    old = ReviewLog(path.parents[1])
    assert len(old.read().entries) == 1
    dispose(old, "scrap")
    review = old.read()
    assert review.problem is None
    assert [entry.disposition for entry in review.entries] == ["rework", "scrap"]


def _many(root: Path, station: str) -> None:
    for _ in range(10):
        dispose(ReviewLog(root), who="someone", scene=f"A~P~{station}~T")


def test_two_people_at_once_lose_nothing(reviewed_store: Path) -> None:
    with ProcessPoolExecutor(2) as people:
        for done in [people.submit(_many, reviewed_store, station) for station in ("S1", "S2")]:
            done.result()
    review = ReviewLog(reviewed_store).read()
    assert review.problem is None
    assert [entry.number for entry in review.entries] == list(range(1, 21))


@pytest.mark.parametrize(
    "wrong",
    [
        {"who": "  "},
        {"disposition": "ignore"},
        {"shown": []},
        {"comment": "x" * (MAX_COMMENT + 1)},
    ],
)
def test_what_makes_no_sense_is_refused(log: ReviewLog, wrong: dict) -> None:
    good = {"who": "m.weber", "shown": [shown(log)], "disposition": "rework", "comment": ""}
    with pytest.raises(UsageError):
        log.dispose(**{**good, **wrong})
    assert log.read().entries == ()


def test_what_was_decided_since_it_was_shown_is_not_decided_again(log: ReviewLog) -> None:
    seen, other = shown(log), shown(log, feature=Feature("rivet", "R-08"))
    log.dispose("k.ito", [shown(log)], "use as is")
    before = log.head()
    with pytest.raises(OutdatedError, match=r"R-07: found it decided since it was shown \(use as is by k\.ito at"):
        log.dispose("m.weber", [other, seen], "scrap")
    assert log.head() == before  # neither of the two
    log.dispose("m.weber", [other], "scrap")
    log.dispose("m.weber", [shown(log)], "scrap")  # who saw the decision may change it
    assert log.read().current()[SCENE, RIVET].disposition == "scrap"


def _scrap(root: Path, seen: ShownFinding) -> bool:
    try:
        ReviewLog(root).dispose("someone", [seen], "scrap")
    except OutdatedError:
        return False
    return True


def test_of_two_people_who_saw_the_same_one_is_first(reviewed_store: Path) -> None:
    with ProcessPoolExecutor(2) as people:
        seen = shown(ReviewLog(reviewed_store))
        outcomes = [done.result() for done in [people.submit(_scrap, reviewed_store, seen) for _ in range(6)]]
    assert sum(outcomes) == 1
    assert len(ReviewLog(reviewed_store).read().entries) == 1


def test_a_sign_off_is_for_the_decisions_that_were_shown(log: ReviewLog) -> None:
    dispose(log)
    seen = shown_scene(log)
    dispose(log, "scrap")
    with pytest.raises(OutdatedError, match=r"R-07 was decided since it was shown \(scrap by m\.weber"):
        log.sign_off("k.ito", seen)
    assert not log.read().sign_offs()
    dispose(log, scene="A~P~S2~T")  # another scene does not matter
    log.sign_off("k.ito", shown_scene(log))
    assert log.read().sign_offs()[SCENE].shown == {"n_rivets": 24}


def test_work_is_open_until_it_is_closed_with_a_reason(log: ReviewLog) -> None:
    dispose(log)
    assert set(log.read().work()) == {(SCENE, RIVET)}
    with pytest.raises(UsageError, match="reason"):
        log.close("k.ito", [shown(log)], "  ")
    (entry,) = log.close("k.ito", [shown(log)], "replaced, work order 4711")
    review = log.read()
    assert review.problem is None
    assert review.work() == {}
    assert review.closes() == {(SCENE, RIVET): entry}
    assert review.current()[SCENE, RIVET].disposition == "rework"
    with pytest.raises(UsageError, match="found no open work"):
        log.close("k.ito", [shown(log)], "again")
    dispose(log, "repair")
    assert set(log.read().work()) == {(SCENE, RIVET)}  # asked for anew
    dispose(log, "use as is")
    assert log.read().work() == {}


def test_closing_goes_by_what_was_shown(log: ReviewLog) -> None:
    dispose(log)
    seen = shown(log)
    dispose(log, "re-scan")
    with pytest.raises(OutdatedError):
        log.close("k.ito", [seen], "done")


def test_a_log_of_an_earlier_version_is_read_and_goes_on(log: ReviewLog) -> None:
    lines, previous = [], "0" * 64
    old = {"format": "flushline-review/1", "at": "2026-11-20T08:15:00Z", "who": "m.weber", "scene_id": SCENE,
           "run_id": "run-1", "comment": "", "shown": {"value_mm": 0.061}}  # fmt: skip
    for number, more in enumerate(
        (
            {"action": "disposition", "feature_kind": "rivet", "feature_id": "R-07", "disposition": "rework"},
            {"action": "sign-off", "feature_kind": None, "feature_id": None, "disposition": None},
        ),
        start=1,
    ):
        lines.append(json.dumps({**old, **more, "number": number, "previous": previous}).encode())
        previous = hashlib.sha256(lines[-1]).hexdigest()
    log.path.parent.mkdir()
    log.path.with_name("log.jsonl").write_bytes(b"\n".join(lines) + b"\n")
    assert log.read().problem is None
    # What was signed off with open work is still to be done, and can be closed.
    assert set(log.read().work()) == {(SCENE, RIVET)}
    log.close("k.ito", [shown(log)], "done before the sign-off")
    review = log.read()
    assert review.problem is None
    assert [entry.format[-1] for entry in review.entries] == ["1", "1", "2"]


def test_lines_and_quotes_in_a_comment_stay_in_one_entry(log: ReviewLog) -> None:
    comment = 'first\nsecond \u2028 "third" \\ {'
    log.dispose("ü", [shown(log, "s")], "repair", comment)
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
    for place in (24.000000001, 23.9999999):
        assert SEAM_STATION.id_of({"seam_id": "S1", "s_mm": place}) == "S1@24.0"
