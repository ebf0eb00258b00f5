"""Taking a scan with cameras and a screen that are not there."""

from __future__ import annotations

import errno
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from flows.capture import acquire
from flows.capture.acquire import Order, capture
from flows.capture.devices import CaptureError
from flows.cli import main
from metrology.errors import SceneError
from metrology.exposure_choice import best_exposures
from metrology.fringe import FringeCode
from metrology.results import SceneKey
from storage.rig import save_rig
from storage.scene import load_scene
from tests.support.fake_rig import FULL_MS, FakeRig
from tests.support.rendered_fringes import small_rig

CODE = FringeCode("x", 4, (7, 6, 5))
KEY = SceneKey("MSN-1", "P1", "S1", datetime(2026, 11, 20, 8, tzinfo=UTC))


def order(*exposures_ms: float) -> Order:
    return Order(KEY, small_rig(), CODE, exposures_ms)


def test_patterns_are_shown_in_order_and_make_a_scene(tmp_path: Path) -> None:
    fake = FakeRig(small_rig())
    capture(tmp_path / "scene", order(0.8 * FULL_MS, 0.4 * FULL_MS), fake, fake, lambda _: None)
    wanted = [np.rint(255 * line) for line in CODE.patterns(320, 1)[:, 0]]
    np.testing.assert_array_equal(fake.shown, wanted + wanted)
    scene = load_scene(tmp_path / "scene")
    assert scene.key == KEY
    assert scene.exposures[0] == pytest.approx(2 * scene.exposures[1])
    assert scene.frames("right").shape == (2, 12, 240, 320)


def test_the_exposure_is_found_from_either_side(tmp_path: Path) -> None:
    for start_ms in (0.2, 400.0):
        fake = FakeRig(small_rig())
        taken = Order(KEY, small_rig(), CODE, start_ms=start_ms)
        (found,) = capture(tmp_path / f"from{start_ms}", taken, fake, fake, lambda _: None)
        assert found == pytest.approx(0.87 * FULL_MS, rel=0.05)  # of 0.9, noise and the dark level left aside


def test_a_skin_of_many_brightnesses_gets_a_bracket() -> None:
    white = np.geomspace(0.02, 0.9, 4000)
    found = best_exposures(white, np.zeros(4000), 10.0)
    assert found[0] == pytest.approx(10.0, rel=0.02)
    assert len(found) == 3
    assert 1.5 < found[1] / found[0] <= 4.0
    assert found[2] / found[1] == pytest.approx(found[1] / found[0])
    assert best_exposures(np.full(100, 0.005), np.zeros(100), 10.0) == ()


@pytest.mark.parametrize("fault", ["drop", "lose", "stale"])
def test_a_lost_picture_is_noticed_and_taken_again(fault: str, tmp_path: Path) -> None:
    said: list[str] = []
    fake = FakeRig(small_rig(), {5: fault})
    capture(tmp_path / "scene", order(0.8 * FULL_MS), fake, fake, said.append)
    assert any("pattern 6 of 12 is taken again" in line for line in said)
    assert len(fake.shown) == 13
    assert (tmp_path / "scene" / "scene.json").is_file()


def test_a_camera_that_gives_nothing_any_more_ends_the_capture(tmp_path: Path) -> None:
    fake = FakeRig(small_rig(), dict.fromkeys(range(5, 20), "drop"))
    with pytest.raises(CaptureError, match=r"pattern 6 of 12: left camera: found no picture .* tried 3 times"):
        capture(tmp_path / "scene", order(0.8 * FULL_MS), fake, fake, lambda _: None)
    assert list(tmp_path.iterdir()) == []


def test_a_picture_of_another_pattern_is_noticed(tmp_path: Path) -> None:
    fake = FakeRig(small_rig(), {5: "swap"})
    with pytest.raises(SceneError, match=r"c6_s1|found"):
        capture(tmp_path / "scene", order(0.8 * FULL_MS), fake, fake, lambda _: None)
    assert list(tmp_path.iterdir()) == []


def test_cancelled_half_way_nothing_is_left(tmp_path: Path) -> None:
    fake = FakeRig(small_rig(), {7: "cancel"})
    with pytest.raises(KeyboardInterrupt):
        capture(tmp_path / "scene", order(0.8 * FULL_MS), fake, fake, lambda _: None)
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_one_line_and_nothing_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write, written = acquire.write_scene, []

    def fills(folder: Path, *arguments: object, **named: object) -> None:
        write(folder, *arguments, **named)  # type: ignore[arg-type]
        (folder / "scene.json").unlink()
        written.append(folder)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(acquire, "write_scene", fills)
    fake = FakeRig(small_rig())
    with pytest.raises(CaptureError, match=r"No space left on device.*nothing was kept"):
        capture(tmp_path / "scene", order(0.8 * FULL_MS), fake, fake, lambda _: None)
    assert written
    assert list(tmp_path.iterdir()) == []


def test_the_command_says_what_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_rig(small_rig(), tmp_path / "rig.json")
    names = ("--aircraft", "A1", "--panel", "P1", "--station", "S1", "--left", "1", "--right", "2")
    for cameras, said in (("webcam:0", "found 'webcam'"), ("harvester:none.cti", "harvest")):
        command = ("capture", "--rig", str(tmp_path / "rig.json"), "--out", str(tmp_path / "scene"), *names)
        assert main([*command, "--cameras", cameras]) == 2
        assert said in capsys.readouterr().err
