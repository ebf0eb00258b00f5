"""Calibrating from the command line: a rig file, a report, and words where a capture is bad."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flows.cli import main
from storage.evidence.rig_facts import rig_facts
from storage.rig import load_rig

POSES = (0, 2, 4, 6, 8)


def capture_of(shared: Path, folder: Path, poses: tuple[int, ...] = POSES) -> dict[str, Any]:
    """A capture with some poses of the reference one; its frames are links."""
    source = shared / "scenes" / "calibration"
    document = json.loads((source / "calibration.json").read_text())
    document["poses"] = [document["poses"][pose] for pose in poses]
    folder.mkdir()
    for pose in document["poses"]:
        for frames in pose.values():
            for name in frames.values():
                (folder / name).symlink_to(source / name)
    (folder / "calibration.json").write_text(json.dumps(document))
    return document


@pytest.mark.slow
def test_a_capture_becomes_a_rig_and_a_report(shared: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = capture_of(shared, tmp_path / "capture")
    document["board"]["certificate"] = {"number": "B-77", "laboratory": "D-K-1", "due_at": "2026-10-01T00:00:00Z"}
    (tmp_path / "capture" / "calibration.json").write_text(json.dumps(document | {"due_at": "2027-05-02T00:00:00Z"}))
    out = tmp_path / "new" / "rig.json"
    assert main(["calibrate", str(tmp_path / "capture"), "--out", str(out), "--id", "rig-test"]) == 0
    said = capsys.readouterr().out
    assert "5 of 5 poses" in said
    assert "warning: few poses" in said
    assert "certificate B-77 of D-K-1, due 2026-10-01 did not hold any more on 2026-11-02" in said

    facts = rig_facts(json.loads(out.read_text()))
    assert str(facts.certificate) == "B-77 of D-K-1, due 2026-10-01"
    assert facts.due_at == datetime(2027, 5, 2, tzinfo=UTC)
    rig, truth = load_rig(out), load_rig(shared / "scenes" / "rig.json")
    assert rig.id == "rig-test"
    assert rig.calibrated_at == "2026-11-02T07:05:00Z"
    rms = rig.extra["calibration"]["reprojection_rms_px"]
    assert max(rms["left"], rms["right"]) < 0.02
    assert rms["projector"] < 0.1
    v, u = np.mgrid[100:1200:150, 100:1600:150]
    points = truth.left.rays(np.stack([u, v], -1)) * 720
    off = rig.projector.project(points) - truth.projector.project(points)
    assert np.sqrt(np.mean(np.sum(off**2, axis=-1))) < 0.25

    report = out.with_suffix(".html").read_text()
    assert "Epipolar residuals" in report
    assert "certificate B-77" in report
    assert "<script src" not in report  # needs no network


def test_a_bad_capture_is_one_line_and_leaves_nothing(
    shared: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = capture_of(shared, tmp_path / "capture", (0, 2))
    document["board"]["cols"] = 6
    (tmp_path / "capture" / "calibration.json").write_text(json.dumps(document))
    out = tmp_path / "rig.json"
    assert main(["calibrate", str(tmp_path / "capture"), "--out", str(out)]) == 2
    complaint = capsys.readouterr().err
    assert complaint.count("error:") == 1
    assert f"{tmp_path / 'capture'}: " in complaint
    assert "in 0 of 2 poses" in complaint
    assert "wrong board size" in complaint
    assert not out.exists()
    assert not out.with_suffix(".html").exists()


def test_a_rig_travels_through_opencvs_file(shared: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = shared / "scenes" / "rig.json"
    there, back = tmp_path / "rig.yml", tmp_path / "back.json"
    assert main(["rig", "export", str(source), "--out", str(there)]) == 0
    assert main(["rig", "import", str(there), "--id", "back", "--out", str(back)]) == 0
    assert load_rig(back).right.t == pytest.approx(load_rig(source).right.t)
    assert main(["rig", "check", str(back), str(tmp_path / "nothing")]) == 2
    assert "nothing" in capsys.readouterr().err
