"""How findings stand, and that a decision is recorded about what the archive still shows."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest

from metrology.errors import OutdatedError, UsageError
from metrology.inspection import InspectionResult
from metrology.kinds import SEAM_STATION
from metrology.results import Decision
from metrology.tolerance import Limit, PanelSpec, judge
from storage.archive import Store
from storage.archive.decisions import (
    close_work,
    dispose,
    mark_false,
    mark_missed,
    shown_finding,
    sign_off,
    sign_off_all,
    undo,
    unmark,
)
from storage.archive.work import open_work, said, standings
from storage.evidence.chain import trace
from storage.report import scene_report
from storage.review import Disposition, Feature, ReviewLog, ShownFinding, ShownScene
from storage.review_checking import check_log
from storage.review_details import Numbers, Signature
from tests.support.results import copied, small_key, small_result

R1, R2 = Feature("rivet", "R1"), Feature("rivet", "R2")
SCENE = small_key().scene_id


def scan(
    days: float = 0,
    decision: Decision = "fail",
    height_mm: float = 0.3,
    station: str = "S3",
    registration: dict | None = None,
) -> InspectionResult:
    """One scan with R1 and R2, R1 with this verdict and height, and a seam that passes."""
    key = small_key(station)
    base = small_result(replace(key, captured_at=key.captured_at + timedelta(days=days)), rivets=2)
    first, second = base.features["rivet"]
    first = replace(first, height_mean_mm=height_mm, decision=decision)
    stations = tuple(replace(row, decision="pass", reason=None) for row in base.features["seam station"])
    features = {**base.features, "rivet": (first, second), "seam station": stations}
    return replace(base, features=features, registration=registration or {})


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """One scene; do not write to it."""
    store = Store(tmp_path_factory.mktemp("published") / "store")
    store.publish(scan())
    return store


@pytest.fixture
def store(published: Store, tmp_path: Path) -> Store:
    """A copy of it to write to."""
    return copied(published, tmp_path)


def seen(store: Store, scene_id: str = SCENE, feature: Feature = R1) -> ShownFinding:
    """A finding as somebody sees it who looks now."""
    with contextlib.closing(store.connect()) as connection:
        found = shown_finding(connection, ReviewLog(store.root).read(), scene_id, feature)
    assert found
    return found


def seen_scene(store: Store) -> ShownScene:
    return ShownScene(SCENE, seen(store).run_id, {}, ReviewLog(store.root).read().last_of_scene(SCENE))


def stand(store: Store, scene_id: str = SCENE) -> str:
    with contextlib.closing(store.connect()) as connection:
        return said(standings(connection, ReviewLog(store.root).read(), scene_id))


def decide(store: Store, disposition: Disposition, scene_id: str = SCENE) -> None:
    dispose(store.root, "m.weber", [seen(store, scene_id)], disposition)


def later(store: Store, **how: object) -> str:
    """Publish another scan; returns its name."""
    result = scan(**how)  # type: ignore[arg-type]
    store.publish(result)
    return result.key.scene_id


def test_a_finding_waits_until_it_is_decided(store: Store) -> None:
    assert stand(store) == "1 waiting"
    decide(store, "use as is")
    assert stand(store) == "1 decided"
    entry = ReviewLog(store.root).read().entries[-1]
    assert entry.shown["value_mm"] == 0.3
    assert entry.run_id == seen(store).run_id


@pytest.mark.parametrize("disposition", ["rework", "repair", "re-scan"])
@pytest.mark.parametrize("decision", ["pass", "conditional pass"])
def test_work_is_open_until_the_feature_passes_on_a_later_scan(
    store: Store, disposition: Disposition, decision: Decision
) -> None:
    decide(store, disposition)
    assert stand(store) == "1 open work"
    later(store, days=1)
    assert stand(store) == "1 open work"
    later(store, days=2, decision=decision, height_mm=0.05)
    assert stand(store) == "1 decided"


@pytest.mark.parametrize(
    "other",
    [
        {"days": -1, "decision": "pass"},
        {"days": 1, "decision": "pass", "station": "S4"},
        {"days": 1, "decision": "not measured"},
        {"days": 1, "decision": "pass", "registration": {"status": "not recognised"}},
    ],
    ids=["an earlier scan", "another station", "not measured", "ids of its own"],
)
def test_other_scans_leave_work_open(store: Store, other: dict) -> None:
    decide(store, "rework")
    later(store, **other)
    assert stand(store) == "1 open work"


def test_rivets_in_no_pattern_are_other_rivets_on_each_scan(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    extra = Feature("rivet", "X01")
    for days, decision in ((0, "fail"), (1, "pass")):
        base = scan(days, decision, registration={"status": "recognised", "unlisted": ["X01"]})  # type: ignore[arg-type]
        first, second = base.features["rivet"]
        features = {**base.features, "rivet": (replace(first, rivet_id="X01"), second)}
        store.publish(replace(base, features=features))
        if not days:
            dispose(store.root, "m.weber", [seen(store, feature=extra)], "rework")
    assert stand(store) == "1 open work"


def test_the_disposition_of_a_later_scan_takes_the_place_of_an_earlier_one(store: Store) -> None:
    decide(store, "rework")
    second = later(store, days=1)
    decide(store, "scrap", second)
    assert stand(store) == "1 decided"
    with contextlib.closing(store.connect()) as connection:
        assert open_work(connection, ReviewLog(store.root).read()) == {}


def test_a_person_closes_work_with_a_reason(store: Store) -> None:
    decide(store, "rework")
    close_work(store.root, "k.ito", [seen(store)], "replaced, work order 4711")
    assert stand(store) == "1 decided"


def test_a_decision_is_undone_by_a_further_entry(store: Store) -> None:
    log = ReviewLog(store.root)
    with pytest.raises(UsageError, match="found no decision about it as a whole"):
        undo(store.root, "m.weber", [seen(store)], "a mistake")
    dispose(store.root, "m.weber", [seen(store)], "scrap")
    assert log.read().current()  # what is known by now goes on with the next entries
    dispose(store.root, "m.weber", [seen(store)], "rework")
    close_work(store.root, "m.weber", [seen(store)], "measured by hand")
    assert stand(store) == "1 decided"
    shown = seen(store)
    with pytest.raises(UsageError, match="found no reason"):
        undo(store.root, "m.weber", [shown], " ")
    [entry] = undo(store.root, "k.ito", [shown], "another rivet was measured")
    assert (entry.format, entry.said[:24]) == ("flushline-review/4", "decision undone by k.ito")
    assert stand(store) == "1 open work"  # the rework that was closed
    with pytest.raises(OutdatedError, match="decided since it was shown"):
        undo(store.root, "m.weber", [shown], "again")
    undo(store.root, "k.ito", [seen(store)], "the wrong rivet")
    assert stand(store) == "1 decided"
    assert log.read().current()[SCENE, R1].disposition == "scrap"
    undo(store.root, "k.ito", [seen(store)], "not cracked after all")
    assert stand(store) == "1 waiting"
    assert log.read().current() == {}
    assert len(ReviewLog(store.root).read().entries) == 6  # nothing was taken out
    [decision] = [link for link in trace(store, f"{SCENE}/R1") if link.name == "decision"]
    assert decision.missing
    assert "nobody decided" in decision.said
    dispose(store.root, "m.weber", [seen(store)], "use as is")
    sign_off(store.root, "m.weber", seen_scene(store))
    with pytest.raises(UsageError, match="expected an open scene"):
        undo(store.root, "k.ito", [seen(store)], "too late")


def test_a_scan_with_open_work_or_a_finding_that_waits_is_not_signed_off(store: Store) -> None:
    with pytest.raises(UsageError, match=r"found R1 \(no disposition\), expected every finding decided"):
        sign_off(store.root, "k.ito", seen_scene(store))
    decide(store, "rework")
    with pytest.raises(UsageError, match=r"found R1 \(open work\)"):
        sign_off(store.root, "k.ito", seen_scene(store))
    later(store, days=1, decision="pass", height_mm=0.05)
    sign_off(store.root, "k.ito", seen_scene(store))
    assert SCENE in ReviewLog(store.root).read().sign_offs()


@pytest.fixture(params=["other values", "the same values", "a newer scan"])
def change(request: pytest.FixtureRequest) -> tuple[Callable[[Store], object], str]:
    """What is stored between showing and recording, and what the refusal says."""
    return {
        "other values": (lambda store: store.publish(scan(height_mm=0.9)), "inspected again"),
        "the same values": (lambda store: store.publish(scan()), "inspected again"),
        "a newer scan": (lambda store: store.publish(scan(days=1)), "found a newer scan of its station"),
    }[request.param]


def test_what_changed_since_it_was_shown_is_not_decided(
    store: Store, change: tuple[Callable[[Store], object], str]
) -> None:
    before, (act, said_) = seen(store), change
    untouched = seen(store, feature=R2)
    act(store)
    with pytest.raises(OutdatedError, match=f"R1: {said_}.*look at it as it is now first|{said_}"):
        dispose(store.root, "m.weber", [before], "scrap")
    with pytest.raises(OutdatedError, match=said_):
        dispose(store.root, "m.weber", [untouched, before], "scrap")
    assert ReviewLog(store.root).read().entries == ()
    decide(store, "scrap")  # as it is now


def test_what_is_gone_or_was_never_shown_is_not_decided(store: Store) -> None:
    with pytest.raises(OutdatedError, match="no more in the archive"):
        dispose(store.root, "m.weber", [ShownFinding(SCENE, "run", Feature("rivet", "R9"))], "scrap")
    other = replace(seen(store), values={**seen(store).values, "value_mm": 0.31})
    with pytest.raises(OutdatedError, match=r"found value_mm 0\.3, expected 0\.31 as it was shown"):
        dispose(store.root, "m.weber", [other], "scrap")


def test_a_disposition_does_not_hold_for_other_values(store: Store) -> None:
    decide(store, "use as is")
    store.publish(scan())  # inspected again, with the same outcome
    assert stand(store) == "1 decided"
    store.publish(scan(height_mm=0.9))
    assert stand(store) == "1 waiting"
    decide(store, "scrap")
    assert stand(store) == "1 decided"


SEAM = Feature("seam station", "M1@2.0-8.0")
AT = (0.0, 2.0, 4.0, 6.0, 8.0, 10.0)


def seam_scan(steps: Sequence[float], days: float = 0, shift: float = 0.0) -> InspectionResult:
    """One scan with a seam of these steps at every 2 mm, from `shift` on, judged by a limit of 0.2 mm."""
    base = scan(days, "pass", 0.05)
    first = base.features["seam station"][0]
    rows = [replace(first, s_mm=s + shift, step_mm=step, reason=None) for s, step in zip(AT, steps, strict=True)]
    judged = judge(SEAM_STATION, rows, PanelSpec("P", "A", {"default": {"step_mm": Limit(-0.2, 0.2)}}))
    return replace(base, features={**base.features, "seam station": tuple(judged)})


BAD = (0.1, 0.3, 0.4, 0.35, 0.3, 0.1)


@pytest.fixture
def seam_store(tmp_path: Path) -> Store:
    """One scan with a seam of which four positions together are too high."""
    store = Store(tmp_path / "store")
    store.publish(seam_scan(BAD))
    return store


def test_a_stretch_of_a_seam_is_one_finding_decided_at_once(seam_store: Store) -> None:
    assert stand(seam_store) == "1 waiting"
    shown = seen(seam_store, feature=SEAM)
    assert (shown.values["value_mm"], shown.values["from_mm"], shown.values["to_mm"]) == (0.4, 2.0, 8.0)
    assert shown.values["reason"].startswith("from 2 to 8 mm (8 mm), worst at 4 mm: step +0.400")
    dispose(seam_store.root, "m.weber", [shown], "use as is")
    assert stand(seam_store) == "1 decided"
    [entry] = ReviewLog(seam_store.root).read().entries
    assert (entry.feature_id, entry.format) == ("M1@2.0-8.0", "flushline-review/3")
    assert [each["value_mm"] for each in entry.shown["positions"]] == [0.3, 0.4, 0.35, 0.3]
    with pytest.raises(OutdatedError, match=r"M1@2\.0-8\.0: found it decided since it was shown"):
        dispose(seam_store.root, "k.ito", [shown], "scrap")


def test_decisions_about_positions_hold_for_their_stretch(seam_store: Store) -> None:
    positions = [Feature("seam station", f"M1@{s:.1f}") for s in (2, 4, 6, 8)]
    dispose(seam_store.root, "m.weber", [seen(seam_store, feature=each) for each in positions[:3]], "use as is")
    assert stand(seam_store) == "1 waiting"  # of one position nobody decided
    dispose(seam_store.root, "m.weber", [seen(seam_store, feature=positions[3])], "use as is")
    assert stand(seam_store) == "1 decided"


@pytest.mark.parametrize(
    ("steps", "state"),
    [
        (BAD, "1 decided"),
        ((0.1, 0.3, 0.4, 0.35, 0.1, 0.1), "1 decided"),  # what is left was decided
        ((0.1, 0.3, 0.4, 0.35, 0.3, 0.3), "1 waiting"),  # it reaches farther
        ((0.1, 0.3, 0.5, 0.35, 0.3, 0.1), "1 waiting"),
    ],
)
def test_a_decision_about_a_stretch_holds_for_its_positions_as_shown(
    seam_store: Store, steps: Sequence[float], state: str
) -> None:
    dispose(seam_store.root, "m.weber", [seen(seam_store, feature=SEAM)], "use as is")
    seam_store.publish(seam_scan(steps))
    assert stand(seam_store) == state


def test_work_on_a_stretch_is_open_until_all_of_it_passes(seam_store: Store) -> None:
    dispose(seam_store.root, "m.weber", [seen(seam_store, feature=SEAM)], "rework")
    assert stand(seam_store) == "1 open work"
    seam_store.publish(seam_scan((0.1, 0.1, 0.1, 0.1, 0.3, 0.1), days=1))
    assert stand(seam_store) == "1 open work"
    seam_store.publish(seam_scan((0.1,) * 6, days=2))
    assert stand(seam_store) == "1 decided"


@pytest.mark.parametrize(
    ("steps", "shift", "state"),
    [
        ((0.1,) * 6, 0.7, "1 decided"),
        ((0.1, 0.1, 0.1, 0.3, 0.1, 0.1), 0.7, "1 open work"),
        ((0.1,) * 6, 5.0, "1 open work"),  # its beginning was not seen again
    ],
)
def test_work_on_a_stretch_is_done_where_positions_lie_between_those_before(
    seam_store: Store, steps: Sequence[float], shift: float, state: str
) -> None:
    dispose(seam_store.root, "m.weber", [seen(seam_store, feature=SEAM)], "rework")
    seam_store.publish(seam_scan(steps, days=1, shift=shift))
    assert stand(seam_store) == state


def test_work_on_a_stretch_is_closed_by_a_person_at_once(seam_store: Store) -> None:
    dispose(seam_store.root, "m.weber", [seen(seam_store, feature=SEAM)], "repair")
    close_work(seam_store.root, "k.ito", [seen(seam_store, feature=SEAM)], "filled, work order 4711")
    assert stand(seam_store) == "1 decided"
    assert sign_off(seam_store.root, "k.ito", replace(seen_scene(seam_store), run_id=seen(seam_store).run_id))


def test_a_decision_about_a_stretch_is_undone_for_all_of_it(seam_store: Store) -> None:
    dispose(seam_store.root, "m.weber", [seen(seam_store, feature=SEAM)], "use as is")
    undo(seam_store.root, "m.weber", [seen(seam_store, feature=SEAM)], "not looked at")
    assert stand(seam_store) == "1 waiting"
    positions = [Feature("seam station", f"M1@{s:.1f}") for s in (2, 4, 6, 8)]
    dispose(seam_store.root, "m.weber", [seen(seam_store, feature=each) for each in positions], "use as is")
    with pytest.raises(UsageError, match="as a whole"):  # each was decided alone
        undo(seam_store.root, "m.weber", [seen(seam_store, feature=SEAM)], "not looked at")
    undo(seam_store.root, "m.weber", [seen(seam_store, feature=positions[0])], "not looked at")
    assert stand(seam_store) == "1 waiting"


def test_a_stretch_without_its_positions_is_refused(seam_store: Store) -> None:
    with pytest.raises(UsageError, match="found no positions, expected those of the stretch"):
        ReviewLog(seam_store.root).dispose("m.weber", [ShownFinding(SCENE, "run", SEAM)], "scrap")


def test_marks_of_false_and_missed_fasteners_are_kept_and_decide_nothing(store: Store) -> None:
    measured = store.query("FROM rivets ORDER BY ALL")
    shown = seen(store)
    mark_false(store.root, "m.weber", shown, "a spot of paint")
    with pytest.raises(OutdatedError, match=r"no fastener here by m\.weber"):
        mark_false(store.root, "k.ito", shown, "so say I")
    with pytest.raises(UsageError, match="found it marked"):
        mark_false(store.root, "k.ito", seen(store), "so say I")
    mark_missed(store.root, "k.ito", seen_scene(store), "", (12.5, 80.0))
    mark_missed(store.root, "k.ito", seen_scene(store), "beside R2, under the tape")
    for wrong in (lambda: mark_missed(store.root, "k.ito", seen_scene(store), " "),
                  lambda: mark_false(store.root, "k.ito", seen(store, feature=R2), " "),
                  lambda: unmark(store.root, "k.ito", SCENE, 7, "no such entry")):  # fmt: skip
        with pytest.raises(UsageError):
            wrong()
    unmark(store.root, "m.weber", SCENE, 1, "it is one after all")
    with pytest.raises(OutdatedError, match="taken back"):
        unmark(store.root, "m.weber", SCENE, 1, "again")
    rows = store.query("FROM marks ORDER BY number").to_pylist()
    place = store.query("SELECT u_px, v_px FROM rivets WHERE rivet_id = 'R1'").to_pylist()[0]
    assert [(row["mark"], row["feature_id"], row["u_px"], row["v_px"], row["holds"]) for row in rows] == [
        ("false", "R1", place["u_px"], place["v_px"], False), ("missed", None, 12.5, 80.0, True),
        ("missed", None, None, None, True),
    ]  # fmt: skip
    assert (rows[0]["taken_back_by"], rows[0]["taken_back_because"]) == ("m.weber", "it is one after all")
    assert rows[2]["comment"] == "beside R2, under the tape"
    assert store.query("FROM rivets ORDER BY ALL") == measured
    assert stand(store) == "1 waiting"
    log = ReviewLog(store.root)
    before = log.read()
    assert [entry.number for entry in before.standing_marks(SCENE)] == [2, 3]
    decide(store, "rework")
    mark_false(store.root, "m.weber", seen(store), "paint")
    assert stand(store) == "1 open work"  # a mark takes nothing away from what was decided
    assert log.read().marks() == [*before.marks(), (log.read().entries[-1], None)]
    assert check_log(store.root).problems == ()
    assert "fastener missed" in scene_report(store, SCENE).html


def test_numbers_of_the_paperwork_and_the_signature_are_kept_beside_the_comment(store: Store) -> None:
    numbers = Numbers(concession="NCR-4711", part_number="MS20470", work_order="WO-9")
    dispose(store.root, "m.weber", [seen(store)], "rework", "shave it", numbers)
    close_work(store.root, "m.weber", [seen(store)], "shaved")
    with pytest.raises(UsageError, match="characters that are no text"):
        dispose(store.root, "m.weber", [seen(store)], "rework", "", Numbers(part_number="\0"))
    signature = Signature(role="design authority", meaning="released", confirmed="log-in, name typed")
    sign_off_all(store.root, "k.ito", [seen_scene(store)], signature=signature)
    columns = "concession, part_number, work_order"
    given = tuple(numbers.model_dump().values())
    for table in ("decisions WHERE number = 1", "dispositions"):
        assert tuple(store.query(f"SELECT {columns} FROM {table}").to_pylist()[0].values()) == given
    [signed] = store.query("SELECT role, meaning, confirmed FROM decisions WHERE action = 'sign-off'").to_pylist()
    assert signed == signature.model_dump()
    entries = ReviewLog(store.root).read().entries
    assert [entry.format[-1] for entry in entries] == ["5", "2", "5"]  # what earlier versions can read, they read
    report = scene_report(store, SCENE).html
    for text in ("concession NCR-4711; part MS20470; work order WO-9; shave it", "design authority: released"):
        assert text in report
    assert check_log(store.root).problems == ()
