"""Inspections ask for their rig's verification where the settings say so, and are as ever where nothing asks."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

from flows.cli import main
from storage.archive import Store
from storage.archive.bundle import document_hash
from storage.evidence.verifications import ArtefactModel, MeasureModel, ScanModel, VerificationModel
from storage.rig import load_rig, rig_document


def inspect(scenes: list[Path], rig: Path, store: Path, settings: str) -> int:
    (store.parent / "settings.toml").write_text(settings)
    files = ["--rig", str(rig), "--store", str(store), "--settings", str(store.parent / "settings.toml")]
    return main(["inspect", *map(str, scenes), *files])


def keep_failure(store: Store, rig_file: Path) -> None:
    """A verification that failed before the scans."""
    rig = load_rig(rig_file)
    at = datetime(2026, 11, 15, tzinfo=UTC)
    measure = MeasureModel(name="height", of="R1", unit="mm", value=0.05, u95=0.002, limit=0.02, decision="fail")
    model = VerificationModel(
        rig_id=rig.id, rig_hash=document_hash(rig_document(rig)), verified_at=at, processed_at=at,
        software_version="0.1.0", config_hash="c0ffee", artefact=ArtefactModel(id="RP-1", kind="rivet-plate"),
        scans=(ScanModel(name="scan", captured_at=at),), measures=(measure,),
    )  # fmt: skip
    store.keep_verification(model, "")


def warned(store: Store) -> list[str]:
    rows = store.query("SELECT warnings FROM scenes").to_pylist()
    return [text for row in rows for text in row["warnings"] if "verif" in text]


@pytest.mark.usefixtures("fake_metrology")
def test_a_failed_rig_is_warned_of_or_refused(
    scenes: list[Path], rig_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = Store(tmp_path / "store")
    assert inspect(scenes[:1], rig_file, store.root, "") == 0
    assert warned(store) == []
    keep_failure(store, rig_file)
    assert inspect(scenes[:1], rig_file, store.root, "") == 0
    (said,) = warned(store)
    assert "rig rig-a: failed its last verification" in said
    assert "height of R1: +0.0500 ± 0.0020 mm, permitted 0.0200" in said
    capsys.readouterr()
    assert inspect(scenes[1:], rig_file, store.root, "[verification]\nrefuse = true\n") == 2
    assert "found rig rig-a: failed its last verification" in capsys.readouterr().err
    assert store.query("SELECT * FROM scenes").num_rows == 1


@pytest.mark.usefixtures("fake_metrology")
def test_a_verification_is_required_where_the_settings_say_so(
    scenes: list[Path], rig_file: Path, tmp_path: Path
) -> None:
    store = Store(tmp_path / "store")
    assert inspect(scenes[:1], rig_file, store.root, "[verification]\nrequired = true\n") == 0
    assert warned(store) == ["rig rig-a: never verified"]
    assert inspect(scenes[1:], rig_file, store.root, "[verification]\nrequired = true\nrefuse = true\n") == 2
