"""Another scanner's cloud by commands alone: a scene is made of it, inspected, and its heads are measured."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from flows.cli import main
from storage.archive import Store
from storage.rig import save_rig
from tests.support.cloud_files import HEADS, levels, riveted, write_ply


def run(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cloud's files: organised, with its picture, its depths, and without an order."""
    folder, found = tmp_path_factory.mktemp("cloud"), riveted(correlated_px=1.0)
    write_ply(folder / "cloud.ply", found.points)
    cv2.imwrite(str(folder / "picture.png"), levels(found))
    np.save(folder / "depth.npy", found.points[..., 2])
    save_rig(replace(found.rig, right=None), folder / "rig.json")
    mixed = np.random.default_rng(0).permutation(found.points.shape[0] * found.points.shape[1])
    write_ply(folder / "mixed.ply", found.points.reshape(-1, 3)[mixed], levels(found).ravel()[mixed])
    return folder


def heights(store: Path) -> list[tuple[float, float]]:
    """Height and its U95 of every rivet, row by row from the lower left."""
    rows = Store(store).query("SELECT y_mm, x_mm, height_mean_mm, height_u95_mm FROM latest_rivets").to_pylist()
    rows.sort(key=lambda row: (-round(row["y_mm"] / 30), row["x_mm"]))  # the heads' y runs up
    return [(row["height_mean_mm"], row["height_u95_mm"]) for row in rows]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("cloud.ply", "--picture", "picture.png"), "in its own frame"),
        (("depth.npy", "--picture", "picture.png", "--rig", "rig.json"), "overlay: through the rig's projector"),
        (("mixed.ply",), "the points have no order"),
    ],
    ids=["organised", "depth map", "unordered"],
)
def test_heads_are_measured_in_a_cloud(
    arguments: tuple[str, ...], said: str, exported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(exported)
    scene, store = tmp_path / "scene", tmp_path / "store"
    assert run("scene", "from-cloud", *arguments, "--out", scene) == 0
    assert said in capsys.readouterr().out
    assert run("inspect", scene, "--store", store) == 0
    found = heights(store)
    assert len(found) == len(HEADS)
    assert [height for height, _ in found] == pytest.approx([head.height for head in HEADS], abs=0.01)
    assert all(abs(height - head.height) < 1.5 * u95 < 0.05 for (height, u95), head in zip(found, HEADS, strict=True))
    (row,) = Store(store).query("SELECT warnings, rig_verdict, frames_digest FROM scenes").to_pylist()
    assert row["rig_verdict"] == "ok"
    assert row["frames_digest"]
    assert any("one camera" in warning for warning in row["warnings"])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("cloud.ply",), "expected an organised cloud with --picture"),
        (("cloud.ply", "--picture", "small.png"), "expected an organised cloud with --picture"),
        (("cloud.ply", "--picture", "small.png", "--grid", "640", "480"), "found 64×48 pixels, expected 640×480"),
        (("cloud.ply", "--picture", "picture.png", "--unit", "0.001"), "--unit says"),
        (("depth.npy", "--picture", "picture.png"), "expected --intrinsics or --rig"),
        (("none.ply",), "found no such file"),
    ],
)
def test_a_cloud_that_lacks_something_is_one_line(
    arguments: tuple[str, ...], said: str, exported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(exported)
    cv2.imwrite("small.png", np.zeros((48, 64), np.uint8))
    assert run("scene", "from-cloud", *arguments, "--out", tmp_path / "scene") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
    assert not (tmp_path / "scene" / "scene.json").exists()


def test_a_scene_that_is_there_already_is_kept(
    exported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(exported)
    command = ("scene", "from-cloud", "cloud.ply", "--picture", "picture.png", "--out", tmp_path / "scene")
    assert run(*command, "--station", "S1") == 0
    manifest = tmp_path / "scene" / "scene.json"
    before = manifest.read_bytes()
    capsys.readouterr()
    assert run(*command, "--station", "S2") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "found a scene there already" in line
    assert manifest.read_bytes() == before
    assert run(*command, "--station", "S2", "--replace") == 0
    assert json.loads(manifest.read_text())["station"] == "S2"


def test_an_inbox_takes_a_cloud_scene_with_its_own_rig(
    exported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    inbox, store = tmp_path / "inbox", tmp_path / "store"
    cloud = ("scene", "from-cloud", exported / "cloud.ply", "--picture", exported / "picture.png")
    assert run(*cloud, "--out", inbox / "a") == 0
    (inbox / "quarantine").mkdir()
    command = ("run", "--inbox", inbox, "--store", store, "--settle", "0", "--workers", "1")
    assert run(*command) == 0
    assert "1 inspected" in capsys.readouterr().out.replace("inspected: 1", "1 inspected")
    assert run(*command) == 0
    said = json.loads((inbox / "a" / "scene.json").read_text())
    assert said["source"]["file"] == "cloud.ply"
