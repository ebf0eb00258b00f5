"""From a specification to a rig, by the commands a user types: simulate a capture, calibrate, compare with truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flows.cli import main
from storage.rig import load_rig

SPEC = """
format = "flushline-simulation/1"
seed = 3

[scene]
aircraft_serial = "SIM-0001"
panel = "P1"
station = "S1"
captured_at = "2026-11-20T08:00:00Z"

[rig]
id = "rig-1"
seed = 4
[rig.design]
camera_width = 406
camera_height = 308
camera_focal_px = 910.0
projector_width = 640
projector_height = 400
projector_focal_px = 1275.0

[fringe]
axis = "x"
steps = 4
counts = [35, 32, 29]

[camera]
samples = 4

[calibration]
show = "fringes"
poses = 6

[calibration.board]
kind = "chessboard"
cols = 13
rows = 9
"""


@pytest.mark.slow
def test_a_simulated_capture_gives_the_rig_that_made_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "spec.toml").write_text(SPEC)
    assert main(["simulate", str(tmp_path / "spec.toml"), "--out", str(tmp_path)]) == 0
    assert f"calibration capture: {tmp_path / 'calibration'}" in capsys.readouterr().out
    assert main(["calibrate", str(tmp_path / "calibration"), "--out", str(tmp_path / "found.json")]) == 0
    assert "6 of 6 poses" in capsys.readouterr().out

    found, truth = load_rig(tmp_path / "found.json"), load_rig(tmp_path / "rig.json")
    assert found.id == "rig-1"
    rms = found.extra["calibration"]["reprojection_rms_px"]
    assert max(rms.values()) < 0.03
    # Where a true point lands in each device, through the rig that was found.
    v, u = np.mgrid[40:280:40, 40:380:40]
    points = truth.left.rays(np.stack([u, v], -1)) * 720
    seen = found.left.rays(truth.left.project(points)) * 720
    for device in ("right", "projector"):
        off = getattr(found, device).project(seen) - getattr(truth, device).project(points)
        assert np.sqrt(np.mean(np.sum(off**2, axis=-1))) < 0.15


def test_a_wrong_calibration_table_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "spec.toml").write_text(SPEC.replace('"fringes"', '"stripes"'))
    assert main(["simulate", str(tmp_path / "spec.toml"), "--out", str(tmp_path)]) == 2
    assert "calibration.show: found 'stripes'" in capsys.readouterr().err
