"""Rig files: nothing is lost on the way through, and what is wrong is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier
from typing import Any

import numpy as np
import pytest

from metrology.errors import RigError
from metrology.rig import Rig
from storage.rig import load_rig, rig_document, save_rig


def test_a_rig_survives_the_file_with_its_extra_keys(tmp_path: Path, rig: Rig) -> None:
    save_rig(rig, tmp_path / "rig.json")
    again = load_rig(tmp_path / "rig.json")
    assert rig_document(again) == rig_document(rig)
    assert again.extra == rig.extra
    assert np.array_equal(again.right.t, rig.right.t)
    document = json.loads((tmp_path / "rig.json").read_text())
    assert document["cameras"]["left"]["serial"] == "C-17"


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
        (lambda d: d.pop("projector"), "no key 'projector'"),
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
