"""Input files changed at random; benchmarks/fuzz_inputs.py does the same for thousands of changes."""

from __future__ import annotations

from pathlib import Path

from tests.support.fuzzing import fuzz, fuzz_inspect
from tests.support.results import small_key
from tests.support.small_scene import write_small_scene


def test_every_changed_file_is_read_or_refused_in_one_line(tmp_path: Path) -> None:
    assert fuzz(tmp_path, mutations=260, seed=7) == []


def test_every_changed_scene_is_stored_or_refused(tmp_path: Path, rig_file: Path, fake_metrology: list[str]) -> None:
    scene = write_small_scene(tmp_path / "scene", small_key())
    assert fuzz_inspect(tmp_path, scene, rig_file, runs=12, seed=7) == []
