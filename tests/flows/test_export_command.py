"""flushline export: an aircraft in one command, whole files or none, one line for what is wrong."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from flows.cli import main
from storage.archive import Store
from storage.export.formats import FORMATS
from tests.support.results import small_key, small_result


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of an aircraft of three panels."""
    store = Store(tmp_path_factory.mktemp("export") / "store")
    for panel in ("P1", "P2", "P3"):
        store.publish(small_result(small_key("S1", "MSN-1", panel)))
    return store.root


def test_an_aircraft_in_every_format(store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    formats = [word for name in FORMATS if name != "panel-ply" for word in ("--format", name)]
    assert main(["export", "--aircraft", "MSN-1", "--store", str(store), *formats, "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out.splitlines()
    assert sorted(said) == sorted(str(path) for path in (tmp_path / "out").iterdir())
    names = {Path(line).name for line in said}
    assert {
        f"MSN-1~{p}{e}" for p in ("P1", "P2", "P3") for e in (".dfq", ".qif", ".xlsx", ".e57", "-as9102.csv")
    } <= names


def test_a_file_uri_gets_the_files(store: Path, tmp_path: Path) -> None:
    arguments = ["export", "--aircraft", "MSN-1", "--panel", "P1", "--store", str(store), "--format", "qif"]
    assert main([*arguments, "--out", f"file://{tmp_path}/there"]) == 0
    assert [path.name for path in (tmp_path / "there").iterdir()] == ["MSN-1~P1.qif"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--aircraft", "MSN-9"], "MSN-9"),
        (["--aircraft", "MSN-1", "--panel", "P9"], "P9"),
        (["no~such~scene"], "no~such~scene"),
        ([], "SCENE_ID"),
        (["x", "--aircraft", "MSN-1"], "SCENE_ID"),
        (["--query", "SELECT 1"], "expected one of xlsx, csv, parquet"),
        (["--query", "SELECT 1", "--name", "../x"], "--name"),
    ],
)
def test_what_is_wrong_is_one_line_and_leaves_nothing(
    store: Path, tmp_path: Path, arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["export", *arguments, "--store", str(store), "--format", "qif", "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not out.exists()


def test_a_missing_package_is_named_with_what_to_install(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr("storage.export.formats.find_spec", lambda name: None if name == "pye57" else found(name))
    arguments = [
        "export",
        "--aircraft",
        "MSN-1",
        "--store",
        str(store),
        "--format",
        "e57",
        "--out",
        str(tmp_path / "out"),
    ]
    assert main(arguments) == 2
    assert "pye57" in (error := capsys.readouterr().err)
    assert "pip install flushline[export]" in error


def test_a_file_in_the_way_is_one_line(store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "out").write_text("x")
    arguments = [
        "export",
        "--aircraft",
        "MSN-1",
        "--store",
        str(store),
        "--format",
        "csv",
        "--out",
        str(tmp_path / "out"),
    ]
    assert main(arguments) == 2
    assert "expected a folder" in capsys.readouterr().err
