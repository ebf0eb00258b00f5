"""A store keeps every version of a specification and the first pattern of each station."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from metrology.errors import SpecError, StoreError
from metrology.panel import NominalRivet, PanelLayout, Placement
from storage.archive import Store
from storage.panel_spec import DEFAULT_SPEC

SPEC = 'format = "flushline-panel/1"\npanel = "LH-F12"\nrevision = "{}"\n'


def layout(x: float) -> PanelLayout:
    return PanelLayout((NominalRivet("R01", (x, 0.0, 0.0)),), (), {"S3": Placement(np.eye(3), np.zeros(3))})


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "store")
    store.prepare()
    return store


def given(tmp_path: Path, revision: str) -> Path:
    path = tmp_path / f"{revision}.toml"
    path.write_text(SPEC.format(revision))
    return path


def test_the_newest_version_is_in_force_and_older_ones_stay(store: Store, tmp_path: Path) -> None:
    assert store.panels.in_force("LH-F12") is None
    for revision in ("A", "B", "B", "A"):
        store.panels.add(given(tmp_path, revision))
    assert [v.path.read_text() for v in store.panels.versions("LH-F12")] == [SPEC.format(r) for r in "ABA"]
    assert store.panels.in_force("LH-F12").limits.revision == "A"
    assert store.panels.names() == ["LH-F12"]
    store.check_usable()


def test_the_example_cannot_be_put_in_force(store: Store) -> None:
    with pytest.raises(SpecError, match="example"):
        store.panels.add(DEFAULT_SPEC)


def test_of_patterns_enrolled_at_the_same_time_one_stays(store: Store) -> None:
    with ThreadPoolExecutor(8) as threads:
        kept = list(
            threads.map(lambda x: store.panels.enrol(layout(x), "LH-F12", "S3", f"scan {x}"), map(float, range(8)))
        )
    assert sum(kept) == 1
    assert store.panels.pattern("LH-F12", "S3").rivets[0].position[0] == kept.index(True)
    assert store.panels.stations("LH-F12") == ["S3"]
    assert store.panels.pattern("LH-F12", "S4") is None


def test_a_replaced_pattern_is_kept_aside(store: Store) -> None:
    for x in range(3):
        assert store.panels.enrol(layout(x), "LH-F12", "S3", "scan", replace=True)
    assert store.panels.pattern("LH-F12", "S3").rivets[0].position[0] == 2
    assert len(list(store.panels.pattern_path("LH-F12", "S3").parent.glob("S3.replaced-*"))) == 2
    assert store.panels.stations("LH-F12") == ["S3"]


@pytest.mark.parametrize("name", ["../x", ".hidden", "a/b", ""])
def test_names_cannot_leave_the_store(store: Store, name: str) -> None:
    with pytest.raises(StoreError):
        store.panels.enrol(layout(0), name, "S3", "scan")
    with pytest.raises(StoreError):
        store.panels.pattern("LH-F12", name)
