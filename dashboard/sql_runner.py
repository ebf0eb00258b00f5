"""Queries that people type: run beside the pages, with limits on rows, bytes and time."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from dashboard.sql_worker import TRUNCATED
from metrology.errors import UsageError

if TYPE_CHECKING:
    import pyarrow as pa

MOST_ROWS = 10_000
MOST_BYTES = 50 << 20
MOST_SECONDS = 20.0
AT_ONCE = 2
"""Queries that run side by side; a query takes a processor and up to 4 GB."""
_STARTING_SECONDS = 60.0
"""What a process may take at most until its query runs: loading DuckDB and opening the archive on a busy machine."""
_MOST_SQL = 20_000
_MOST_SAID = 8000
_turns = threading.BoundedSemaphore(AT_ONCE)


@dataclass(frozen=True)
class Answer:
    """Rows of a query; `truncated` where there were more than were fetched."""

    rows: pd.DataFrame
    truncated: bool


def run_query(
    root: Path,
    sql: str,
    rows: int = MOST_ROWS,
    seconds: float = MOST_SECONDS,
    on_wait: Callable[[], None] = lambda: None,
) -> Answer:
    """Run a query that a person typed; every problem is a UsageError in one line.

    Parameters
    ----------
    root : Path
        The store's folder.
    rows : int
        Rows to fetch at most.
    seconds : float
        What the query may take, its turn and its process's start not counted; as long again it waits for its turn.
    on_wait : callable
        Called where other people's queries have to end first.
    """
    if not sql.strip():
        raise UsageError("query: found no text, expected a SELECT")
    if len(sql) > _MOST_SQL:
        raise UsageError(f"query: found {len(sql)} characters, expected at most {_MOST_SQL}")
    with _turn(seconds, on_wait):
        table = _ask(root, sql, rows, seconds)
    try:
        answer = Answer(table.to_pandas(), (table.schema.metadata or {}).get(TRUNCATED) == b"1")
        answer.rows.to_csv()  # pandas holds times that it cannot write, such as those of the year 290000
    except Exception as problem:  # pyarrow and pandas raise kinds of their own for values beyond their types
        said = " ".join(str(problem).split())[:_MOST_SAID]
        raise UsageError(
            f"query: found values that a page cannot show ({said}), expected plain ones; cast them to VARCHAR"
        ) from None
    return answer


@contextmanager
def _turn(seconds: float, on_wait: Callable[[], None]) -> Iterator[None]:
    """Let a few queries run at once; further ones wait."""
    if not _turns.acquire(blocking=False):
        on_wait()
        if not _turns.acquire(timeout=seconds):
            raise UsageError(
                f"query: found {AT_ONCE} queries of others still running after {seconds:g} s, expected a free turn; "
                "try again"
            )
    try:
        yield
    finally:
        _turns.release()


def _ask(root: Path, sql: str, rows: int, seconds: float) -> pa.Table:
    """The answer of a process that runs one query."""
    import pyarrow as pa

    scratch = tempfile.mkdtemp(prefix="flushline-query-")
    request = {
        "store": str(Path(root).resolve()), "sql": sql, "rows": rows, "bytes": MOST_BYTES,
        "seconds": seconds, "scratch": scratch, "server": os.getpid(),
    }  # fmt: skip
    try:
        with tempfile.TemporaryFile() as complaints:
            done = subprocess.run(
                [sys.executable, "-m", "dashboard.sql_worker"],
                input=json.dumps(request).encode(errors="replace"),
                stdout=subprocess.PIPE,
                stderr=complaints,
                timeout=seconds + _STARTING_SECONDS,
                env=_environment(scratch),
                check=False,
            )
            complaints.seek(0)
            said = " ".join(complaints.read(_MOST_SAID).decode(errors="replace").split())
    except subprocess.TimeoutExpired:
        raise _too_slow(seconds) from None
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    if done.returncode == -signal.SIGALRM:
        raise _too_slow(seconds)
    if done.returncode:
        raise UsageError(f"query: {said[-600:] or 'found it stopped: too much memory or disk, expected less'}")
    return pa.ipc.open_stream(done.stdout).read_all()


def _too_slow(seconds: float) -> UsageError:
    return UsageError(f"query: found it still running after {seconds:g} s, expected an answer by then")


def _environment(scratch: str) -> dict[str, str]:
    """Only what Python needs: nothing of the server's environment is in reach of a query."""
    kept = {name: value for name, value in os.environ.items() if name in ("PATH", "LANG", "LD_LIBRARY_PATH", "HOME")}
    return {**kept, "PYTHONPATH": str(Path(__file__).parents[1]), "TMPDIR": scratch}
