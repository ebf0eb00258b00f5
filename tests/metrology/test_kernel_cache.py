"""Where kernels are kept when neither the program's folder nor the home can be written, and for how long."""

from __future__ import annotations

import importlib
import os
import shutil
import stat
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numba
import numpy as np
import pytest

from metrology.jit import cached, kernel


@pytest.fixture
def compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[object], object]:
    """Numba where only the folder that is given to it can be written."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")

    def compile_(function: object) -> object:
        if not numba.config.CACHE_DIR:  # type: ignore[attr-defined]
            raise RuntimeError("cannot cache function 'f': no locator available for file 'f.py'")
        return function

    return compile_


def test_kernels_go_into_a_folder_of_this_user(
    compiler: Callable[[object], object], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cached(compiler, len) is len
    folder = Path(os.environ["NUMBA_CACHE_DIR"])
    assert folder == tmp_path / f"flushline-kernels-{os.getuid()}"
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert capsys.readouterr().err.count("kernels are compiled into") == 1
    assert cached(compiler, abs) is abs
    assert capsys.readouterr().err == ""  # said once


def test_a_folder_that_others_can_write_is_not_trusted(compiler: Callable[[object], object], tmp_path: Path) -> None:
    theirs = tmp_path / f"flushline-kernels-{os.getuid()}"
    theirs.mkdir()
    theirs.chmod(0o777)
    cached(compiler, len)
    assert os.environ["NUMBA_CACHE_DIR"] != str(theirs)
    assert Path(os.environ["NUMBA_CACHE_DIR"]).parent == tmp_path


def test_other_problems_are_not_hidden() -> None:
    def fail(_: object) -> object:
        raise RuntimeError("no such target")

    with pytest.raises(RuntimeError, match="no such target"):
        cached(fail, len)


def test_processes_compile_a_kernel_once(tmp_path: Path) -> None:
    entry = "import numba, sys\nfrom metrology.jit import kernel\n"
    (tmp_path / "lender.py").write_text(entry + "@kernel\ndef inner(x):\n    return x + 1\n")
    (tmp_path / "borrower.py").write_text(
        entry + "from lender import inner\n@kernel\ndef outer(x):\n    return inner(2 * x)\n"
        "print(outer(1.5), *(sum(f.stats.cache_misses.values()) for f in (inner, outer)))\n"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, str(tmp_path / "borrower.py")]
    both = [subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    said = [process.communicate(timeout=120)[0].split() for process in both]
    assert [words[0] for words in said] == ["4.0", "4.0"]
    assert [sum(map(int, counts)) for counts in zip(*(words[1:] for words in said), strict=True)] == [1, 1]


def test_what_was_loaded_is_compiled_into_what_calls_it(tmp_path: Path) -> None:
    """Loading a kernel reads its machine code alone; a caller that is compiled later needs more of it."""
    (tmp_path / "lender.py").write_text(
        "from metrology.jit import kernel\n@kernel\ndef inner(x):\n    return x + 1\nprint(inner(1.5))\n"
    )
    (tmp_path / "borrower.py").write_text(
        "from metrology.jit import kernel\nfrom lender import inner\n[code] = inner.overloads.values()\n"
        "print(code.library._shared_module)\n@kernel\ndef outer(x):\n    return inner(2 * x)\nprint(outer(1.5))\n"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": os.pathsep.join(sys.path)}
    for name, said in (("lender", ["2.5"]), ("borrower", ["2.5", "None", "4.0"])):
        command = [sys.executable, str(tmp_path / f"{name}.py")]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        assert done.stdout.split() == said


def test_numba_saves_kernels_as_supposed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    def twice(x: float) -> float:
        return 2 * x

    assert cached(numba.njit(cache=True), twice)(1.5) == 3.0
    names = [path.suffix for path in tmp_path.rglob("*") if path.is_file()]
    assert sorted(names) == [".lock", ".nbc", ".nbi"]


@pytest.mark.parametrize("lent", ["from metrology.jit import kernel", "from numba import njit as kernel"])
def test_a_kernel_goes_out_of_date_with_what_it_takes_from_other_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lent: str
) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.syspath_prepend(str(tmp_path))
    entry = "from metrology.jit import kernel\nfrom lender import LENT, inner\n"
    (tmp_path / "borrower.py").write_text(entry + "@kernel\ndef outer(x):\n    return inner(x) + LENT\n")

    def result(factor: str, constant: str) -> float:
        lender = f"{lent}\nLENT = {constant}\n@kernel\ndef inner(x):\n    return {factor} * x\n"
        (tmp_path / "lender.py").write_text(lender)
        for name in ("borrower", "lender"):
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        shutil.rmtree(tmp_path / "__pycache__", ignore_errors=True)
        return float(importlib.import_module("borrower").outer(1.0))

    assert result("2.0", "10.0") == 12.0
    assert result("3.00", "10.0") == 13.0
    assert result("3.00", "20.0") == 23.0


def test_a_kernel_does_not_depend_on_what_was_loaded_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Copies of a called kernel that others can see are replaced by whichever of that name a process met first."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    def summed(x: np.ndarray) -> float:
        total = 0.0
        for value in x:
            total += value
        return total

    inner = kernel(summed)

    def twice(x: np.ndarray) -> float:
        return 2 * inner(x)

    outer = kernel(twice)
    assert outer(np.arange(4.0)) == 12.0
    [compiled] = outer.overloads.values()
    code = compiled.library.get_llvm_str()
    assert "define linkonce_odr" not in code
    assert compiled.fndesc.mangled_name in code
