"""Queries that people type: run beside the pages, with limits on rows, bytes and time."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from dashboard.sql_worker import TRUNCATED
from metrology.errors import UsageError

MOST_ROWS = 10_000
MOST_BYTES = 50 << 20
MOST_SECONDS = 20.0
_MOST_SQL = 20_000


@dataclass(frozen=True)
class Answer:
    """Rows of a query; `truncated` where there were more than were fetched."""

    rows: pd.DataFrame
    truncated: bool


def run_query(root: Path, sql: str, rows: int = MOST_ROWS, seconds: float = MOST_SECONDS) -> Answer:
    """Run a query that a person typed; every problem is a UsageError in one line."""
    import pyarrow as pa

    if not sql.strip():
        raise UsageError("query: found no text, expected a SELECT")
    if len(sql) > _MOST_SQL:
        raise UsageError(f"query: found {len(sql)} characters, expected at most {_MOST_SQL}")
    request = json.dumps({"store": str(Path(root).resolve()), "sql": sql, "rows": rows, "bytes": MOST_BYTES})
    scratch = tempfile.mkdtemp(prefix="flushline-query-")
    try:
        done = subprocess.run(
            [sys.executable, "-m", "dashboard.sql_worker"],
            input=request.encode(errors="replace"),
            capture_output=True,
            timeout=seconds,
            env=_environment(scratch),
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise UsageError(f"query: found it still running after {seconds:g} s, expected an answer by then") from None
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    if done.returncode:
        said = " ".join(done.stderr.decode(errors="replace").split())
        raise UsageError(f"query: {said[-600:] or 'found it stopped: too much memory or disk, expected less'}")
    table = pa.ipc.open_stream(done.stdout).read_all()
    return Answer(table.to_pandas(), (table.schema.metadata or {}).get(TRUNCATED) == b"1")


def _environment(scratch: str) -> dict[str, str]:
    """Only what Python needs: nothing of the server's environment is in reach of a query."""
    kept = {name: value for name, value in os.environ.items() if name in ("PATH", "LANG", "LD_LIBRARY_PATH", "HOME")}
    return {**kept, "PYTHONPATH": str(Path(__file__).parents[1]), "TMPDIR": scratch}
