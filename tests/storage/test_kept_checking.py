"""Rigs and patterns that the store lends to later scans: one that was edited by hand is named."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metrology.panel import NominalRivet, PanelLayout, Placement
from storage.archive import Store, maintenance
from storage.rig import load_rig
from tests.support.results import copied, small_key, small_result


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """A scene with its rig; do not write to it."""
    store = Store(tmp_path_factory.mktemp("published") / "store")
    result = small_result(small_key("S1"))
    store.publish(result)
    store.add_rig(result.reconstruction.rig)
    return store


@pytest.fixture
def store(published: Store, tmp_path: Path) -> Store:
    """A copy of it to write to."""
    return copied(published, tmp_path)


def edited(path: Path, old: str, new: str) -> None:
    """As an editor does it: another file takes the name."""
    text = path.read_text()
    assert old in text
    other = path.with_name("edited")
    other.write_text(text.replace(old, new, 1))
    os.replace(other, path)


def test_a_stored_rig_is_that_of_its_runs(store: Store) -> None:
    assert maintenance.check(store.layout).problems == ()
    (path,) = store.layout.rigs.glob("*.json")
    document = json.loads(path.read_text())
    document["cameras"]["right"]["t"][0] *= 1.001
    path.chmod(0o644)
    path.write_text(json.dumps(document))
    load_rig(path)  # nothing else is wrong with it
    (problem,) = maintenance.check(store.layout).problems
    assert problem.startswith(f"{path}: found other values than every run with rig {path.stem}")


def test_a_rig_that_no_run_was_made_with_is_nobodys_problem(store: Store) -> None:
    (path,) = store.layout.rigs.glob("*.json")
    document = {**json.loads(path.read_text()), "id": "another"}
    path.with_name("another.json").write_text(json.dumps(document))
    assert maintenance.check(store.layout).problems == ()


@pytest.mark.parametrize("by_a_person", [False, True])
def test_a_pattern_is_as_it_was_enrolled(store: Store, by_a_person: bool) -> None:
    """A run's own pattern, and one that a person enrolled anew."""
    layout = PanelLayout((NominalRivet("R1", (0.0, 0.0, 0.0), 8.0),), (), {"S1": Placement(np.eye(3), np.zeros(3))})
    if by_a_person:
        store.panels.enrol(layout, "LH-F12", "S1", small_key("S1").scene_id)
    else:
        store.publish(replace(small_result(small_key("S1"), height_mm=0.2), pattern=layout))
    path = store.panels.pattern_path("LH-F12", "S1")
    assert maintenance.check(store.layout).problems == ()
    edited(path, "diameter_mm = 8", "diameter_mm = 7")
    (problem,) = maintenance.check(store.layout).problems
    assert problem.startswith(f"{path}: found other content than was enrolled")
