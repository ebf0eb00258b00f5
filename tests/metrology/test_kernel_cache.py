"""Where kernels are kept, and for how long."""

from __future__ import annotations

import importlib
import os
import shutil
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numba
import numpy as np
import pytest

from metrology import kernel_cache
from metrology.jit import kernel
from metrology.kernel_cache import _home, keep


@pytest.fixture
def homes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[set[Path]]:
    """A user with a home below the test's folder, and the folders below it that cannot be written."""
    locked: set[Path] = set()
    _home.cache_clear()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    can_be_written = kernel_cache._can_be_written
    monkeypatch.setattr(kernel_cache, "_can_be_written", lambda f: Path(f) not in locked and can_be_written(f))
    yield locked
    _home.cache_clear()


_PROGRAM = Path(kernel_cache.__file__).parent / "__pycache__" / "kernels"


def test_kernels_go_into_the_user_s_folder_for_caches(homes: set[Path], tmp_path: Path) -> None:
    assert Path(_home("")) == tmp_path / "home" / "flushline" / "kernels"
    assert Path(_home(str(tmp_path / "given"))) == tmp_path / "given"


def test_else_beside_the_program_else_into_a_temporary_folder_of_this_user(
    homes: set[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    homes.add(tmp_path / "home" / "flushline" / "kernels")
    assert Path(_home("")) == _PROGRAM
    homes.add(_PROGRAM)
    _home.cache_clear()
    assert capsys.readouterr().err == ""
    folder = Path(_home(""))
    assert folder == tmp_path / f"flushline-kernels-{os.getuid()}"
    assert os.environ["NUMBA_CACHE_DIR"] == str(folder)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert capsys.readouterr().err.count("kernels are compiled into") == 1
    assert Path(_home("")) == folder
    assert capsys.readouterr().err == ""  # said once


def test_a_folder_that_others_can_write_is_not_trusted(homes: set[Path], tmp_path: Path) -> None:
    homes |= {tmp_path / "home" / "flushline" / "kernels", _PROGRAM}
    theirs = tmp_path / f"flushline-kernels-{os.getuid()}"
    theirs.mkdir()
    theirs.chmod(0o777)
    folder = Path(_home(""))
    assert folder != theirs
    assert folder.parent == tmp_path


def _misses(program: Path, cache: Path) -> int:
    """How many kernels a program compiles that prints a kernel's result and how often it was not on disk."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, str(program)], env=environment, capture_output=True, text=True, check=True)
    result, misses = done.stdout.split()
    assert result == "2.5"
    return int(misses)


def test_a_second_copy_of_the_program_finds_what_has_not_changed(tmp_path: Path) -> None:
    text = (
        "from metrology.jit import kernel\n@kernel\ndef more(x):\n    return x + 1\n"
        "print(more(1.5), sum(more.stats.cache_misses.values()))\n"
    )
    for copy in ("one", "two"):
        (tmp_path / copy).mkdir()
        (tmp_path / copy / "program.py").write_text(text)
    cache = tmp_path / "cache"
    assert _misses(tmp_path / "one" / "program.py", cache) == 1
    assert _misses(tmp_path / "two" / "program.py", cache) == 0
    (tmp_path / "two" / "program.py").write_text(text.replace("x + 1", "1 + x"))
    assert _misses(tmp_path / "two" / "program.py", cache) == 1
    assert _misses(tmp_path / "one" / "program.py", cache) == 0  # another version's code is not overwritten


def test_code_that_was_damaged_or_cannot_be_kept_is_compiled_again(tmp_path: Path) -> None:
    program, cache = tmp_path / "program.py", tmp_path / "cache"
    program.write_text(
        "from metrology.jit import kernel\n@kernel\ndef more(x):\n    return x + 1\n"
        "print(more(1.5), sum(more.stats.cache_misses.values()))\n"
    )
    assert _misses(program, cache) == 1
    for suffix in (".nbc", ".nbi"):
        [file] = cache.rglob(f"*{suffix}")
        file.write_bytes(file.read_bytes()[:40])
        assert _misses(program, cache) == 1
        assert _misses(program, cache) == 0
    [file] = cache.rglob("*.nbc")
    for left in file.parent.iterdir():
        left.unlink()
    file.parent.rmdir()
    file.parent.write_text("no folder")
    assert _misses(program, cache) == 1


def test_code_that_nothing_has_used_for_long_goes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    def twice(x: float) -> float:
        return 2 * x

    versions = keep(numba.njit()(twice)).stats.cache_path
    old, used = (Path(versions).parent / name for name in ("old", "used"))
    for folder, days in ((old, 91), (used, 89)):
        folder.mkdir(parents=True)
        os.utime(folder, (time.time() - 86400 * days,) * 2)
    assert keep(numba.njit()(twice))(1.5) == 3.0
    assert not old.exists()
    assert used.exists()


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
    path = os.pathsep.join([str(tmp_path), *sys.path])
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": path}
    for name, said in (("lender", ["2.5"]), ("borrower", ["2.5", "None", "4.0"])):
        command = [sys.executable, "-c", f"import {name}"]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        assert done.stdout.split() == said


def test_numba_saves_kernels_as_supposed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    def twice(x: float) -> float:
        return 2 * x

    assert keep(numba.njit()(twice))(1.5) == 3.0
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
