"""Kernels compiled ahead by a second process: the list is true, and nobody waits for it in vain."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from flows import compiling
from metrology.kernel_cache import is_compiled
from metrology.phase.exposures import StepTables

_QUICK = "metrology.seams.finding.segments:_longest_run"
_IN_A_NEW_CACHE = """
from flows import compiling
from metrology.kernel_cache import is_compiled
lines = [line for line in compiling.listed() if line[0] == {name!r}]
kernel = compiling.kernel_of({name!r})
print(compiling.missing(lines), is_compiled(kernel))
compiling.listed = lambda: [*lines, ("metrology.jit:no_such_kernel", [])]
compiling.compile_listed()
print(compiling.missing(lines), is_compiled(kernel))
"""
# With cameras that see the middle of its panel alone, and a dent there: all that is listed is called, from a third
# of the pixels.
_DEMO = """
import json, sys
from dataclasses import replace
from pathlib import Path
from tests.support.kernel_calls import record_kernel_calls
called = record_kernel_calls()
from flows import demo
from flows.compiling import text_of
from simulator.defects import Dent
whole = demo.shipped_spec("demo")
design = replace(whole.rig.design, camera_width=900, camera_height=800)
panel = replace(whole.panel, dents=(Dent("D1", -20.0, 0.0, 0.4, (24.0, 20.0)),))
part = replace(whole, panel=panel, rig=replace(whole.rig, design=design), camera=replace(whole.camera, samples=4))
demo.shipped_spec = lambda _: part
demo.run_demo(Path(sys.argv[1]) / "demo", keep=False)
lines = [[name, [text_of(kind) for kind in types]] for name, types in called]
(Path(sys.argv[1]) / "called.json").write_text(json.dumps(lines))
"""


def test_every_line_names_a_kernel_and_types() -> None:
    lines = compiling.listed()
    assert len(lines) > 40
    for name, signature in lines:
        assert hasattr(compiling.kernel_of(name), "compile") or os.environ.get("NUMBA_DISABLE_JIT")
        assert [compiling.text_of(compiling.type_of(text)) for text in signature] == signature


def test_types_are_those_of_arguments() -> None:
    grey = np.zeros((3, 4), np.uint8)
    grey.flags.writeable = False
    arguments: list[Any] = [np.zeros((2, 3, 4), np.float32)[:, ::2], grey, np.uint64(3), 1.5, True, (1, 2), (1, 2.0)]
    tables = np.zeros(3, np.int64), *(np.zeros(3, np.float32) for _ in StepTables._fields[1:])
    arguments.append(StepTables(*tables))
    for value in arguments:
        kind = numba.typeof(value)
        assert compiling.type_of(json.loads(json.dumps(compiling.text_of(kind)))) == kind


def test_the_helper_compiles_what_is_listed_and_leaves_what_is_not_there(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_DISABLE_JIT": "0"}
    work = _IN_A_NEW_CACHE.format(name=_QUICK)
    done = subprocess.run([sys.executable, "-c", work], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["1 False", "0 True"]


@pytest.mark.parametrize(("lacking", "processors", "helps"), [(50, 2, True), (50, 1, False), (0, 2, False)])
def test_a_helper_starts_where_it_is_of_use(
    lacking: int, processors: int, helps: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[Any] = []

    class Helper:
        def __init__(self, command: list[str], **_where: int) -> None:
            started.append(self)
            self.ended = False

        def terminate(self) -> None:
            self.ended = True

        def wait(self) -> None:
            assert self.ended

    monkeypatch.setattr(compiling, "cores", lambda: processors)
    monkeypatch.setattr(compiling, "missing", lambda _: lacking)
    monkeypatch.setattr(compiling.subprocess, "Popen", Helper)
    with compiling.kernels_beside():
        assert len(started) == helps
    assert all(helper.ended for helper in started)


def test_what_is_never_compiled_is_not_missing() -> None:
    assert is_compiled(lambda: None)


@pytest.mark.slow
def test_the_list_has_all_that_the_demonstration_calls(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-c", _DEMO, str(tmp_path)], capture_output=True, check=True)
    called = json.loads((tmp_path / "called.json").read_text(encoding="utf-8"))
    listed = [list(line) for line in compiling.listed()]
    assert [line for line in called if line not in listed] == []
    assert [line for line in listed if line not in called] == []
