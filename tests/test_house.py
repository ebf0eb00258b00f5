"""How the house is built: what may import what, nothing in a circle, no function and no file too long to be read."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MAY_IMPORT = {
    "metrology": set[str](),
    "storage": {"metrology"},
    "simulator": {"metrology"},
    "tasks": {"metrology", "storage"},
    "dashboard": {"metrology", "storage"},
    "flows": {"metrology", "storage", "simulator", "tasks", "dashboard"},
}
"""The rooms of docs/index.md."""
LONGEST_FUNCTION, LONGEST_FILE = 80, 400


@cache
def house() -> dict[str, ast.Module]:
    """Every module of the rooms, by its name."""
    paths = [path for room in MAY_IMPORT for path in sorted((ROOT / room).rglob("*.py"))]
    return {".".join(path.relative_to(ROOT).with_suffix("").parts): ast.parse(path.read_text()) for path in paths}


def imported(name: str) -> Iterator[str]:
    """The modules of the house that a module imports, wherever in it; a package's face is no module of its own."""
    for node in ast.walk(house()[name]):
        if isinstance(node, ast.Import):
            asked = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            asked = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        else:
            continue
        yield from (module for module in asked if module in house() and module != name)


@pytest.mark.parametrize("room", MAY_IMPORT)
def test_no_arrow_runs_back_up(room: str) -> None:
    names = [name for name in house() if name.split(".")[0] == room]
    used = {(name, other) for name in names for other in imported(name) if other.split(".")[0] != room}
    assert [pair for pair in sorted(used) if pair[1].split(".")[0] not in MAY_IMPORT[room]] == []


def test_no_files_import_each_other() -> None:
    try:
        TopologicalSorter({name: set(imported(name)) for name in house()}).prepare()
    except CycleError as circle:
        pytest.fail(" -> ".join(circle.args[1]))


def test_functions_and_files_can_be_read() -> None:
    long = [
        f"{name}: {node.name}"
        for name, tree in house().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and (node.end_lineno or 0) - node.lineno + 1 > LONGEST_FUNCTION
    ]
    files = [path for room in MAY_IMPORT for path in (ROOT / room).rglob("*.py")]
    long += [str(path) for path in files if len(path.read_text().splitlines()) > LONGEST_FILE]
    assert long == []


FOR_PROGRAMS = {"storage.archive.decisions: sign_off", "flows.compiling: compile_listed"}
"""What others may call and the house does not, and what a process of its own is told to call by text."""


def test_nothing_is_there_for_tests_alone() -> None:
    defined, used = [], set[str]()
    for name, tree in house().items():
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                defined += [(name, node.name)] if not node.decorator_list or isinstance(node, ast.ClassDef) else []
            elif isinstance(node, ast.Assign | ast.AnnAssign):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                defined += [(name, target.id) for target in targets if isinstance(target, ast.Name)]
        for node in ast.walk(tree):
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
                used.add(node.id)
            elif isinstance(node, ast.Attribute):
                used.add(node.attr)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                used.add(node.value.rpartition(":")[2])  # "module:name", loaded where it is used
    unused = {f"{module}: {name}" for module, name in defined if name not in used and not name.startswith("__")}
    assert unused - FOR_PROGRAMS == set()


def test_usual_arrays_are_named_in_one_place() -> None:
    own = [
        f"{file.relative_to(ROOT)}: {name}"
        for file in sorted(ROOT.glob("*/**/*.py"))
        if file != ROOT / "metrology/arrays.py" and ".venv" not in file.parts
        for name in ("Array", "Mask")
        if re.search(rf"^{name} = NDArray", file.read_text(encoding="utf-8"), re.MULTILINE)
    ]
    assert own == []
