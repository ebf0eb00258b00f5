"""Calibration captures: what the manifest says is what is loaded, and what is wrong is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metrology.errors import CalibrationError
from storage.calibration import load_capture, write_capture
from storage.frames import write_frame
from tasks.calibration import certificate_warnings

DOTS = {
    "type": "asymmetric_circles",
    "cols": 13,
    "rows": 16,
    "spacing_px": 48.0,
    "origin_px": [40.0, 40.0],
    "diameter_px": 24.0,
    "marker_diameter_px": 36.0,
    "markers": [[7, 6], [7, 7], [9, 6]],
}
BOARD = {"type": "asymmetric_circles", "cols": 7, "rows": 11, "spacing_mm": 15.0, "dot_diameter_mm": 8.0}


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    """Two poses; the first with dots, the second with fringes in both axes."""
    rng = np.random.default_rng(0)

    def frame(name: str) -> str:
        write_frame(tmp_path / name, rng.integers(0, 255, (48, 64), np.uint8))
        return name

    def pose(index: int, camera: str) -> dict[str, Any]:
        name = f"pose{index}_{camera}"
        common = {"white": frame(f"{name}_white.png"), "dark": frame(f"{name}_dark.png")}
        if index == 0:
            return common | {"dots": frame(f"{name}_dots.png")}
        return common | {"fringes": {axis: [frame(f"{name}_{axis}{i}.png") for i in range(6)] for axis in ("x", "y")}}

    document = {
        "format": "flushline-calibration/1",
        "units": "mm",
        "captured_at": "2026-11-02T07:05:00Z",
        "board": BOARD,
        "projector": {
            "width": 1280,
            "height": 800,
            "dots": DOTS,
            "fringe": {axis: {"steps": 3, "counts": [7, 6]} for axis in ("x", "y")},
        },
        "poses": [{camera: pose(index, camera) for camera in ("left", "right")} for index in (0, 1)],
    }
    (tmp_path / "calibration.json").write_text(json.dumps(document))
    return tmp_path


def test_dots_and_fringes_are_loaded(capture: Path) -> None:
    loaded = load_capture(capture)
    assert len(loaded) == 2
    assert loaded.board.cols == 7
    assert loaded.dots is not None
    assert loaded.dots.is_marker.sum() == 3
    first, second = loaded.images(0, "left"), loaded.images(1, "right")
    assert first.dots is not None
    assert first.fringes == {}
    assert second.dots is None
    assert second.fringes["y"].shape == (6, 48, 64)
    assert load_capture(capture / "calibration.json").board == loaded.board


def test_the_boards_certificate_is_read_and_its_due_date_watched(capture: Path) -> None:
    document = json.loads((capture / "calibration.json").read_text())

    def warned(due: str) -> list[str]:
        document["board"] = {**BOARD, "certificate": {"number": "B-77", "due_at": due}}
        (capture / "calibration.json").write_text(json.dumps(document))
        return certificate_warnings(load_capture(capture).model)

    assert warned("2026-11-03T00:00:00Z") == []
    assert "B-77, due 2026-11-01 did not hold any more on 2026-11-02" in warned("2026-11-01T00:00:00Z")[0]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d["board"].update(type="triangles"), "board.type"),
        (lambda d: d["board"].update(dot_diameter_mm=99.0), "dot diameter: found 99.0 mm"),
        (lambda d: d["projector"].pop("dots"), "no projector.dots"),
        (lambda d: d["projector"].pop("fringe"), "no projector.fringe"),
        (lambda d: d["poses"][1]["left"]["fringes"]["x"].pop(), "found 5 frames in poses.1.left.fringes.x, expected 6"),
        (lambda d: d["poses"][0]["left"].update(white="none.png"), "none.png: found no such file"),
        (lambda d: d["poses"][0]["left"].update(white="../x.png"), "expected one inside the folder"),
        (lambda d: d.update(poses=[]), "poses"),
        (lambda d: d["projector"]["dots"].update(markers=[[0, 0]]), "projected dots: found markers"),
    ],
)
def test_a_wrong_capture_is_named(capture: Path, change: Callable[[dict[str, Any]], None], said: str) -> None:
    manifest = capture / "calibration.json"
    document = json.loads(manifest.read_text())
    change(document)
    manifest.write_text(json.dumps(document))
    with pytest.raises(CalibrationError) as caught:
        load_capture(capture)
    assert said in str(caught.value)
    assert str(capture) in str(caught.value)


def test_what_is_written_is_loaded(tmp_path: Path, capture: Path) -> None:
    model = load_capture(capture)
    pictures = {
        camera: {"white": images.white, "dark": images.dark}
        | {f"fringes_{axis}": stack for axis, stack in images.fringes.items()}
        for camera, images in ((camera, model.images(1, camera)) for camera in ("left", "right"))
    }
    projector = json.loads((capture / "calibration.json").read_text())["projector"]
    taken = datetime(2026, 11, 2, 7, 5, tzinfo=UTC)
    write_capture(tmp_path / "again", "rig-1", taken, BOARD, projector, [pictures])
    again = load_capture(tmp_path / "again")
    assert again.board == model.board
    assert again.codes == model.codes
    assert again.dots == model.dots
    for camera in ("left", "right"):
        found, expected = again.images(0, camera), model.images(1, camera)
        np.testing.assert_array_equal(found.white, expected.white)
        np.testing.assert_array_equal(found.fringes["y"], expected.fringes["y"])


def test_the_reference_capture_loads(shared: Path) -> None:
    loaded = load_capture(shared / "scenes" / "calibration")
    assert len(loaded) == 9
    assert loaded.images(8, "right").white.shape == (1234, 1624)
