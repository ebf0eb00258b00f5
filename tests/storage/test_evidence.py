"""What a value rests on: every link by name for each kind of feature, missing ones named; verifications and rigs."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from importlib.resources import files
from pathlib import Path

import jsonschema
import pytest

from dashboard.locale import Locale
from dashboard.reports import wording_of
from flows.cli import main
from metrology.errors import StoreError, UsageError
from metrology.inspection import InspectionResult
from metrology.results import Hole
from storage.archive import Store, maintenance
from storage.archive.bundle import document_hash
from storage.certificate import CertificateModel
from storage.evidence.chain import missing, trace
from storage.evidence.verifications import ArtefactModel, MeasureModel, ScanModel, VerificationModel, verified
from storage.export.events import rigs_due
from storage.panel_spec import load_panel_spec
from storage.report import scene_page, scene_record, scene_report
from storage.review import Feature as ReviewedFeature
from storage.review import ReviewLog, ShownFinding, ShownScene
from storage.wording import written_in
from tests.support.results import small_key, small_result, small_rig

CAPTURED = datetime(2026, 11, 20, 8, 15, tzinfo=UTC)
RIG = small_rig()
BOARD = {"type": "chessboard", "cols": 9, "rows": 6, "spacing_mm": 20.0, "certificate": {"number": "B-77"}}
SPEC = """
format = "flushline-panel/1"
panel = "LH-F12"
revision = "C"
[zones.default]
height_mm = {lower = -0.1, upper = 0.1, source = "DS-1", revision = "B"}
step_mm = {lower = -0.2, upper = 0.2, source = "DS-2", revision = "A"}
hole_diameter_mm = {upper = 6, source = "DS-3", revision = "A"}
"""
HOLE = Hole(
    "H1", x_mm=1.0, y_mm=2.0, z_mm=700.0, u_px=10.0, v_px=12.0, kind="hole", diameter_mm=4.8, diameter_u95_mm=0.02,
    decision="pass",
)  # fmt: skip


def rig_document() -> dict[str, object]:
    calibration = {"board": BOARD, "reprojection_rms_px": {"left": 0.01}}
    return {**small_result().rig_document, "calibration": calibration}


def result(tmp_path: Path) -> InspectionResult:
    (tmp_path / "panel.toml").write_text(SPEC)
    base = small_result()
    return replace(
        base,
        features={**base.features, "hole": (HOLE,)},
        reconstruction=replace(base.reconstruction, frames_digest="f00d"),
        panel_spec=load_panel_spec(tmp_path / "panel.toml").document,
        rig_document=rig_document(),
        operator="A. Meyer",
    )


def verification(
    days: float = -1, decision: str = "pass", due_days: float = 30, **changes: object
) -> VerificationModel:
    at = CAPTURED + timedelta(days=days)
    model = VerificationModel(
        rig_id="rig-a", rig_hash=document_hash(rig_document()), verified_at=at, processed_at=at,
        due_at=at + timedelta(days=due_days), software_version="0.1.0", config_hash="c0ffee",
        artefact=ArtefactModel(id="RP-1", kind="rivet-plate", certificate=CertificateModel(number="D-1")),
        scans=(ScanModel(name="scan", captured_at=at),),
        measures=(MeasureModel(name="height", of="R1", unit="mm", value=0.003, u95=0.001, limit=0.01,
                               decision=decision),),  # type: ignore[arg-type]
    )  # fmt: skip
    return model.model_copy(update=changes)


@pytest.mark.parametrize(
    ("name", "value"),
    [("R1", "height +0.0500 ± 0.0040 mm"), ("M1@0.0", "step +0.1000 ± 0.0100 mm"), ("H1", "4.8000 ± 0.0200 mm")],
)
def test_the_chain_of_each_kind_is_whole(name: str, value: str, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    store = Store(tmp_path / "store")
    scanned = result(tmp_path)
    run = store.publish(scanned)
    store.keep_verification(verification(), "<p>report</p>")
    scene = scanned.key.scene_id
    log = ReviewLog(store.root)
    if name.startswith("M1"):
        log.dispose(
            "B. Roy", [ShownFinding(scene, run, ReviewedFeature("seam station", name), {}, 0)], "use as is", "thin"
        )
    log.sign_off("C. Lin", ShownScene(scene, run, {}, log.read().last_of_scene(scene)))
    links = {link.name: link for link in trace(store, f"{scene}/{name}")}
    assert missing(list(links.values())) == []
    assert value in next(iter(links.values())).said
    assert "f00d" in links["frames"].said
    assert links["operator"].said == "A. Meyer"
    assert "B-77" in links["board certificate"].said
    assert "rivet-plate RP-1 (certificate D-1" in links["verification"].said
    assert "DS-" in links["limits"].said
    assert links["specification"].said == "LH-F12 C"
    assert "flushline 0.1.0" in links["software"].said
    assert "signed off by C. Lin" in links["sign-off"].said
    assert main(["trace", name, "--store", str(store.root)]) == 0
    assert "the chain is whole" in capsys.readouterr().out
    page = scene_page(scene_record(store, scene))
    assert all(text in page for text in ("B-77", "RP-1", "f00d", "A. Meyer", "signed off by C. Lin"))
    with written_in(wording_of(Locale("de"), "de")):
        german = {link.name: link.said for link in scene_record(store, scene).chain}
    assert german["verification"].startswith("i.O. am 2026-11-")
    assert "mit rivet-plate RP-1 (Zertifikat D-1, ohne Fälligkeit), nächste fällig 2026-12-" in german["verification"]
    assert german["sign-off"].startswith("abgezeichnet von C. Lin am ")
    assert german["frames"] == "Prüfsumme f00d"


def test_every_missing_link_is_named(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    store = Store(tmp_path / "store")
    store.publish(replace(small_result(), panel_spec=load_panel_spec().document, versions={}))
    assert main(["trace", "M1@2.0", "--store", str(store.root)]) == 1
    said = capsys.readouterr().out
    named = said.splitlines()[-1].removeprefix("the chain lacks: ").split(", ")
    assert named == [
        "seam station", "operator", "frames", "board certificate", "verification", "software", "specification",
        "decision", "sign-off",
    ]  # fmt: skip
    assert "<b>missing</b>: never verified" in scene_page(scene_record(store, small_key().scene_id))
    german = scene_report(store, small_key().scene_id, wording_of(Locale("de"), "de")).html
    assert "<b>fehlend</b>: nie überprüft; flushline verify zeigt, ob der Messkopf richtig misst" in german
    assert "<b>fehlend</b>: der Scan ist offen; im Dashboard abzeichnen" in german


def test_a_name_that_several_scans_have_is_not_guessed(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    for station in ("S1", "S2"):
        store.publish(small_result(small_key(station)))
    with pytest.raises(UsageError, match=r"R1: found it in 2 scenes, expected one of MSN-1~LH-F12~S1~.*/R1, "):
        trace(store, "R1")
    with pytest.raises(UsageError, match="found no such feature"):
        trace(store, f"{small_key('S1').scene_id}/R99")


@pytest.mark.parametrize(
    ("kept", "problem"),
    [
        ([], "never verified"),
        ([verification()], None),
        ([verification(decision="conditional pass")], None),
        ([verification(decision="conditional fail")], "failed its last verification .*height of R1: \\+0.0030"),
        ([verification(-40)], "overdue: its last verification held until 2026-11-10"),
        ([verification(1)], "not verified before"),
        ([verification(-3, "fail"), verification(-1)], None),
        ([verification(-1), verification(1, "fail")], "failed the verification that followed"),
        ([verification(rig_hash="other")], "another calibration of the same id"),
        ([verification(measures=())], "failed"),
    ],
)
def test_what_a_rig_rests_on(kept: list[VerificationModel], problem: str | None, tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    for model in kept:
        store.keep_verification(model, "")
    found = verified(store.verifications.of_rig("rig-a"), document_hash(rig_document()), CAPTURED).problem(CAPTURED)
    if problem is None:
        assert found is None
    else:
        assert re.search(problem, str(found))


def test_verifications_are_only_added(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    first = store.keep_verification(verification(), "one")
    second = store.keep_verification(verification(decision="fail"), "two")
    assert first != second
    assert json.loads(first.read_text())["measures"][0]["decision"] == "pass"
    assert first.with_suffix(".html").read_text() == "one"
    assert not first.stat().st_mode & 0o222
    assert [v.model.verdict for v in store.verifications.of_rig("rig-a")] == ["pass", "fail"]
    first.chmod(0o600)
    first.write_text("{")
    with pytest.raises(StoreError, match=first.name):
        store.verifications.all()


def test_rigs_and_verifications_are_tables(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    store.publish(result(tmp_path))
    assert store.query("SELECT * FROM rigs").num_rows == 0
    store.add_rig(replace(RIG, extra={**RIG.extra, "calibration": rig_document()["calibration"]}))
    store.keep_verification(verification(-3, "fail"), "")
    store.keep_verification(verification(-2), "")
    (row,) = store.query("SELECT * FROM rigs").to_pylist()
    assert (row["rig_id"], row["board_certificate"], row["last_verdict"]) == ("rig-a", "B-77", "pass")
    assert row["last_verified_at"] == CAPTURED - timedelta(days=2)
    assert row["verification_due_at"] == CAPTURED + timedelta(days=28)
    joined = "SELECT s.scene_id, v.measure, v.verdict FROM scenes s JOIN verifications v USING (rig_id, rig_hash)"
    assert {row["verdict"] for row in store.query(joined).to_pylist()} == {"pass", "fail"}


def test_a_rig_is_told_of_when_it_is_soon_due(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    assert list(rigs_due(store, CAPTURED)) == []
    store.publish(result(tmp_path))
    store.keep_verification(verification(-2), "")  # due after 28 days
    assert list(rigs_due(store, CAPTURED + timedelta(days=20))) == []
    (event,) = rigs_due(store, CAPTURED + timedelta(days=22))
    assert event.data == {"rig_id": "rig-a", "due": "verification", "due_at": "2026-12-18T08:15:00Z"}
    jsonschema.validate(
        json.loads(event.document), json.loads((files("storage.export") / "event.schema.json").read_text("utf-8"))
    )
    (same,) = rigs_due(store, CAPTURED + timedelta(days=29))
    assert same.id == event.id
    assert list(rigs_due(store, CAPTURED + timedelta(days=31))) == []  # nobody scans with it any more


def test_a_verification_that_was_changed_or_removed_is_found(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    first = store.keep_verification(verification(days=-2), "<p>first</p>")
    last = store.keep_verification(verification(), "<p>last</p>")
    store.publish(result(tmp_path))
    assert maintenance.check(store.layout).problems == ()
    assert maintenance.check_fast(store.layout).problems == ()
    text = first.read_text()
    replaced(first, text.replace("0.003", "0.001"))
    for check in (maintenance.check, maintenance.check_fast):
        [problem] = check(store.layout).problems
        assert problem == f"{first}: found another content than was kept, expected it as {last} names it"
    replaced(first, text)
    replaced(first.with_suffix(".html"), "<p>better</p>")
    [problem] = maintenance.check_fast(store.layout).problems
    assert problem.startswith(f"{first.with_suffix('.html')}: found another content")
    replaced(first.with_suffix(".html"), "<p>first</p>")
    last.unlink()
    [problem] = maintenance.check(store.layout).problems  # only the run that rests on it knows the last one
    assert problem.startswith(f"{last}: found no such file, expected the verification that {store.layout.bundles}")


def test_a_verification_of_an_earlier_version_names_nothing_and_is_no_problem(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    store.publish(result(tmp_path))
    kept = store.keep_verification(verification(), "<p>report</p>")
    document = json.loads(kept.read_text())
    del document["earlier"], document["report_sha256"]
    replaced(kept, json.dumps(document))
    assert maintenance.check(store.layout).problems == ()


def replaced(path: Path, text: str) -> None:
    path.unlink()
    path.write_text(text)
