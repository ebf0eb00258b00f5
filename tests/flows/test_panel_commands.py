"""flushline panel, report and overlay --panel on a store of small results."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flows.cli import EXIT_BAD_INPUT, EXIT_DONE, main
from metrology.cloud import PixelFlag
from metrology.kinds import KINDS
from storage.archive import Store
from storage.panel_spec import DEFAULT_SPEC, load_panel_spec
from tests.support.results import small_key, small_result

SPEC = 'format = "flushline-panel/1"\npanel = "LH-F12"\nrevision = "B"\n'


@pytest.fixture
def store(tmp_path: Path) -> str:
    store = Store(tmp_path / "store")
    store.publish(small_result())
    return str(store.root)


def test_a_scene_and_a_panel_are_reported(store: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "out" / "scene.html"
    assert main(["report", small_key().scene_id, "--store", store, "--out", str(page), "--csv"]) == EXIT_DONE
    assert capsys.readouterr().out.splitlines() == [
        str(page), *(str(page.with_name(f"scene-{kind.table}.csv")) for kind in KINDS)
    ]  # fmt: skip
    assert page.with_name("scene-rivets.csv").read_bytes().startswith(b"\xef\xbb\xbfaircraft_serial,")
    panel = tmp_path / "panel.html"
    assert (
        main(["report", "--aircraft", "MSN-1", "--panel", "LH-F12", "--store", store, "--out", str(panel)]) == EXIT_DONE
    )
    assert "Station S3" in panel.read_text(encoding="utf-8")


def test_overlays_of_a_panel(store: str, tmp_path: Path) -> None:
    out = tmp_path / "overlays"
    assert (
        main(["overlay", "--aircraft", "MSN-1", "--panel", "LH-F12", "--store", store, "--out", str(out)]) == EXIT_DONE
    )
    assert sorted(path.name for path in out.iterdir()) == ["S3.png", "S3.svg", "index.html"]


@pytest.mark.parametrize("command", ["report", "overlay"])
def test_half_a_panel_is_no_panel(command: str, store: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for which in ([], ["--panel", "LH-F12"], ["ID", "--aircraft", "MSN-1"]):
        assert main([command, *which, "--store", store, "--out", str(tmp_path / "x")]) == EXIT_BAD_INPUT
        assert "expected a SCENE_ID, or --aircraft SERIAL and --panel PANEL" in capsys.readouterr().err


def test_specifications_are_checked_put_in_force_and_shown(
    store: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["panel", "check", str(DEFAULT_SPEC)]) == EXIT_DONE
    said = capsys.readouterr().out
    assert "(example)" in said
    assert "zone default: height_mm -0.100 … +0.100" in said
    assert main(["panel", "show", "--store", store]) == EXIT_BAD_INPUT
    assert "no panel" in capsys.readouterr().err
    spec = tmp_path / "panel.toml"
    spec.write_text(SPEC)
    assert main(["panel", "add", str(spec), "--store", store]) == EXIT_DONE
    assert main(["panel", "add", str(DEFAULT_SPEC), "--store", store]) == EXIT_BAD_INPUT
    capsys.readouterr()
    assert main(["panel", "show", "LH-F12", "--store", store]) == EXIT_DONE
    assert "version 1: revision B (in force)" in capsys.readouterr().out


def test_a_scene_is_enrolled_once_or_in_place_of_another(
    store: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    enrol = ["panel", "enrol", small_key().scene_id, "--store", store]
    assert main([*enrol, "--out", str(tmp_path / "pattern.toml")]) == EXIT_DONE
    assert len(load_panel_spec(tmp_path / "pattern.toml").layout.rivets) == 3
    assert main(enrol) == EXIT_DONE
    assert main(enrol) == EXIT_BAD_INPUT
    assert "expected none or --replace" in capsys.readouterr().err
    assert main([*enrol, "--replace"]) == EXIT_DONE
    capsys.readouterr()
    assert main(["panel", "show", "--store", store]) == EXIT_DONE
    assert "station S3: 3 rivets, 0 seams enrolled from MSN-1~LH-F12~S3" in capsys.readouterr().out


@pytest.mark.parametrize("doubt", ["unjudged rig", "contradictory fringes"])
def test_a_scene_that_nobody_can_vouch_for_is_not_enrolled(
    doubt: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = small_result()
    if doubt == "unjudged rig":
        result = replace(result, rig_verdict="unjudged")
    else:
        flags = result.reconstruction.flags | np.uint16(PixelFlag.ORDER_RESIDUAL)
        result = replace(result, reconstruction=replace(result.reconstruction, flags=flags))
    store = Store(tmp_path / "store")
    store.publish(result)
    enrol = ["panel", "enrol", small_key().scene_id, "--store", str(store.root)]
    assert main(enrol) == EXIT_BAD_INPUT
    assert "expected a scan that can be vouched for" in capsys.readouterr().err
    assert store.panels.stations("LH-F12") == []
    assert main([*enrol, "--out", str(tmp_path / "pattern.toml")]) == EXIT_DONE
    assert "warning: " in capsys.readouterr().out
