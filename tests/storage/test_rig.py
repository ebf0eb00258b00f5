"""Rig files: nothing is lost on the way through, and what is wrong is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Barrier
from typing import Any

import numpy as np
import pytest

from metrology.errors import RigError
from metrology.rig import Rig
from storage.rig import load_rig, rig_document, rig_from_document, save_rig


def test_a_rig_survives_the_file_with_its_extra_keys(tmp_path: Path, rig: Rig) -> None:
    save_rig(rig, tmp_path / "rig.json")
    again = load_rig(tmp_path / "rig.json")
    assert rig_document(again) == rig_document(rig)
    assert again.extra == rig.extra
    assert np.array_equal(again.right.t, rig.right.t)
    document = json.loads((tmp_path / "rig.json").read_text())
    assert document["cameras"]["left"]["serial"] == "C-17"


def test_a_rig_without_a_projector_stays_one(tmp_path: Path, rig: Rig) -> None:
    save_rig(replace(rig, projector=None), tmp_path / "rig.json")
    assert "projector" not in json.loads((tmp_path / "rig.json").read_text())
    again = load_rig(tmp_path / "rig.json")
    assert again.projector is None
    assert list(again.devices) == ["left", "right"]
    with pytest.raises(RigError, match="no calibrated projector"):
        again.with_projector()


def test_many_write_the_same_rig_at_once(tmp_path: Path, rig: Rig) -> None:
    path = tmp_path / "rig.json"
    start = Barrier(8)

    def write() -> None:
        start.wait()
        for _ in range(20):
            save_rig(rig, path)

    with ThreadPoolExecutor(8) as pool:
        for written in [pool.submit(write) for _ in range(8)]:
            written.result()
    assert rig_document(load_rig(path)) == rig_document(rig)
    assert [file.name for file in tmp_path.iterdir()] == ["rig.json"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.update(units="m"), "units: found \"m\", expected 'mm'"),
        (lambda d: d.update(id="../rig"), "letters, digits"),
        (lambda d: d.update(calibrated_at="20261102073000"), 'calibrated_at: found "20261102073000", expected an ISO'),
        (lambda d: d.update(calibrated_at=1793604600), "time with its zone as text"),
        (lambda d: d.update(calibrated_at="2026-11-02"), "time with its zone"),
        (lambda d: d["cameras"].pop("left"), "no key 'cameras.left'"),
        (lambda d: d["cameras"]["left"]["K"].pop(), "cameras.left.K"),
        (lambda d: d["cameras"]["left"]["K"][0].__setitem__(0, float("nan")), "NaN"),
        (
            lambda d: d["cameras"]["right"].update(R=[[2, 0, 0], [0, 1, 0], [0, 0, 1]]),
            "right: R: found a matrix that is",
        ),
        (lambda d: d["cameras"]["right"].update(t=[0, 0, 0]), "no baseline"),
        (lambda d: d["cameras"]["left"].update(t=[1, 0, 0]), "expected identity"),
        (lambda d: d["projector"].update(distortion=[0.1, 0.2]), "projector: distortion: found 2 terms"),
        (lambda d: d["projector"].update(width=0), "projector.width"),
    ],
)
def test_a_wrong_rig_is_named(tmp_path: Path, rig: Rig, change: Callable[[dict[str, Any]], None], said: str) -> None:
    document = rig_document(rig)
    change(document)
    (tmp_path / "rig.json").write_text(json.dumps(document))
    with pytest.raises(RigError) as caught:
        load_rig(tmp_path / "rig.json")
    assert said in str(caught.value)
    assert "rig.json" in str(caught.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d["cameras"]["left"].update(K=np.array(d["cameras"]["left"]["K"]).T.tolist()), "left: K: "),
        (lambda d: d["cameras"]["right"].update(t=[-0.05, 0.0, 0.0]), "right: found its centre 0.05 mm"),
        (lambda d: d["projector"]["K"][0].__setitem__(1, 0.4), "projector: K: found a skew of 0.4 px"),
        (
            lambda d: d["cameras"]["left"].update(distortion_model="equidistant"),
            "distortion_model: found 'equidistant'",
        ),
        (lambda d: d.update(camera_model="opencv_fisheye"), "camera_model: found 'opencv_fisheye'"),
    ],
)
def test_a_rig_that_cannot_be_is_refused_to_measure_with(
    tmp_path: Path, rig: Rig, change: Callable[[dict[str, Any]], None], said: str
) -> None:
    document = rig_document(rig)
    change(document)
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(document))
    with pytest.raises(RigError) as caught:
        load_rig(path)
    assert str(caught.value).startswith(f"{path}: {said}")
    assert "\n" not in str(caught.value)
    # What was measured with it stays to be seen.
    shown = rig_from_document(document, path)
    assert shown.id == rig.id
    with pytest.raises(RigError):
        save_rig(shown, tmp_path / "again.json")
    assert not (tmp_path / "again.json").exists()


def test_makers_and_pinhole_models_are_no_other_lens(tmp_path: Path, rig: Rig) -> None:
    document = rig_document(rig)
    document["cameras"]["left"] |= {"sensor_model": "OmniVision OV9281", "distortion_model": "plumb_bob"}
    (tmp_path / "rig.json").write_text(json.dumps(document))
    assert load_rig(tmp_path / "rig.json").id == rig.id


@pytest.mark.parametrize("name", ["rig.json", "rig-11.json", "rig-12.json"])
def test_the_reference_rigs_are_real_ones(shared: Path, name: str) -> None:
    load_rig(shared / "scenes" / name)
