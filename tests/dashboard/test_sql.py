"""The query page's runner: it answers, and whatever is typed it neither writes, nor reads files, nor stalls."""

from __future__ import annotations

import contextlib
import hashlib
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from dashboard import sql_runner
from dashboard.confinement import write_only_in
from dashboard.sql_runner import AT_ONCE, run_query
from metrology.errors import UsageError
from storage.archive import Store, tables_beside
from storage.archive.beside import TABLES_BESIDE
from storage.review import Feature, ReviewLog, ShownFinding


def test_rows_and_the_row_limit(filled: Path) -> None:
    answer = run_query(filled, "SELECT rivet_id, height_mean_mm FROM rivets ORDER BY 1", rows=10)
    assert len(answer.rows) == 10
    assert answer.truncated
    assert not run_query(filled, "SELECT 1 AS one").truncated
    assert "rivets" in set(run_query(filled, "SHOW TABLES").rows["name"])


def test_tables_beside_the_index_have_the_columns_that_are_described(filled: Path) -> None:
    named = {name for names in (tables_beside._DECISIONS, tables_beside._RIGS, tables_beside._LIMITS) for name in names}
    assert {table.name for table in TABLES_BESIDE} == named
    for table in TABLES_BESIDE:
        found = Store(filled).query(f"FROM {table.name} LIMIT 0")
        assert found.column_names == [column.name for column in table.columns]


def test_dispositions_can_be_joined(writable: Path) -> None:
    ReviewLog(writable).dispose("x", [ShownFinding("scene", "run", Feature("rivet", "R04"))], "scrap", "why")
    assert run_query(writable, "SELECT disposition, comment FROM dispositions").rows.iloc[0].tolist() == [
        "scrap",
        "why",
    ]


@pytest.mark.parametrize(
    "sql",
    [
        "DROP TABLE rivets",
        "COPY (SELECT 1) TO '/tmp/flushline-was-here.csv'",
        "SELECT * FROM read_text('/etc/passwd')",
        "ATTACH '/tmp/other.duckdb'",
        "INSTALL httpfs",
        "SET enable_external_access = true",
        "SELECT 1; DROP VIEW worst_rivets",
        "SELEC",
        "",
        "x" * 30_000,
    ],
)
def test_what_is_refused_is_one_line(sql: str, filled: Path) -> None:
    with pytest.raises(UsageError) as problem:
        run_query(filled, sql)
    assert "\n" not in str(problem.value)
    assert "Traceback" not in str(problem.value)


@pytest.mark.parametrize(
    "sql",
    [
        "SELECT count(*) FROM range(1000000000) a, range(1000000000) b",
        "SELECT max(md5(repeat(i::VARCHAR, 1000))) FROM range(1000000000) t(i)",
    ],
)
def test_an_endless_query_is_stopped(sql: str, filled: Path) -> None:
    started = time.monotonic()
    with pytest.raises(UsageError, match=r"still running after 2\.5 s"):
        run_query(filled, sql, seconds=2.5)
    assert time.monotonic() - started < 60  # it would take years


@pytest.mark.parametrize("sql", ["SELECT repeat('a', 2000000000)", "SELECT repeat('abc', 30000000) FROM range(9)"])
def test_a_result_that_is_too_large_is_refused(sql: str, filled: Path) -> None:
    with pytest.raises(UsageError):
        run_query(filled, sql, seconds=10)


def listing(root: Path) -> dict[str, str]:
    """Every file below a folder, with its digest."""
    return {
        str(path.relative_to(root)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(root.rglob("*"))
        if path.is_file()
    }


WRITES = [
    "COPY (SELECT from_base64('AAAA')) TO '{}' (FORMAT blob)",
    "COPY (SELECT 1) TO '{}' (FORMAT csv, USE_TMP_FILE false)",
    "COPY (SELECT 1) TO '{}' (FORMAT parquet)",
    "EXPLAIN ANALYZE COPY (SELECT 1) TO '{}' (FORMAT csv, USE_TMP_FILE true)",
]


@pytest.mark.parametrize("sql", WRITES)
def test_a_query_cannot_write_beside_the_index(sql: str, writable: Path) -> None:
    index = Path(os.path.realpath(writable / "archive.duckdb"))
    index.chmod(0o644)
    before = listing(writable)
    for companion in ("", ".wal"):
        with pytest.raises(UsageError):
            run_query(writable, sql.format(f"{index}{companion}"))
    assert listing(writable) == before


def test_without_the_kernels_help_duckdb_gives_up_the_file_system(
    writable: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    # The same as on a kernel without Landlock: the worker finds none.
    site = tmp_path / "site"
    site.mkdir()
    (site / "sitecustomize.py").write_text(
        "import dashboard.confinement as c\nc.write_only_in = lambda folder: False\n"
    )
    environment = sql_runner._environment
    monkeypatch.setattr(
        sql_runner,
        "_environment",
        lambda scratch: environment(scratch) | {"PYTHONPATH": f"{site}:{environment(scratch)['PYTHONPATH']}"},
    )
    before = listing(writable)
    index = os.path.realpath(writable / "archive.duckdb")
    with pytest.raises(UsageError, match="files, which it may not"):
        run_query(writable, f"COPY (SELECT 1) TO '{index}.wal' (FORMAT csv)")
    assert listing(writable) == before
    assert run_query(writable, "SELECT count(*) AS n FROM rivets").rows["n"][0] > 0


@pytest.mark.slow
def test_a_large_sort_spills_into_its_own_folder(filled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if not _has_landlock():
        pytest.skip("this kernel has no Landlock: sorting on disk is refused there")
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr(sql_runner.tempfile, "mkdtemp", lambda prefix: str(scratch))
    # 1 GB of text to sort within 1 GB of memory: some goes on disk, where 1 GB is allowed.
    text = "SELECT repeat(md5(i::VARCHAR), 40) AS m FROM range(800000) t(i)"
    sql = f"SELECT max(n) AS n, max(m) AS m FROM (SELECT m, row_number() OVER (ORDER BY m) AS n FROM ({text}))"
    spilled = 0
    with ThreadPoolExecutor(1) as pool:
        answer = pool.submit(run_query, filled, sql, seconds=300)
        while not answer.done():
            with contextlib.suppress(OSError):
                spilled = max(spilled, sum(path.stat().st_size for path in scratch.rglob("*") if path.is_file()))
            time.sleep(0.02)
    assert answer.result().rows["n"][0] == 800_000
    assert spilled > 10 << 20


def _has_landlock() -> bool:
    code = "import sys, tempfile, pathlib\nfrom dashboard.confinement import write_only_in\n"
    code += "sys.exit(0 if write_only_in(pathlib.Path(tempfile.mkdtemp())) else 1)"
    return subprocess.run([sys.executable, "-c", code], cwd=Path(__file__).parents[2], check=False).returncode == 0


def test_a_confined_process_writes_in_its_folder_only(tmp_path: Path) -> None:
    if not _has_landlock():
        pytest.skip("this kernel has no Landlock")
    inside, outside = tmp_path / "inside", tmp_path / "outside"
    inside.mkdir()
    outside.write_text("as it was")
    process = os.fork()
    if process == 0:
        done = write_only_in(inside)
        (inside / "mine").write_text("x")
        failed = 0
        for attempt in (
            lambda: outside.write_text("changed"),
            lambda: outside.unlink(),
            lambda: outside.rename(inside / "moved"),
            lambda: os.truncate(outside, 0),
            lambda: (tmp_path / "new").mkdir(),
        ):
            try:
                attempt()
            except OSError:
                failed += 1
        os._exit(0 if done and failed == 5 and outside.read_text() == "as it was" else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 0


def test_a_query_ends_with_its_server(filled: Path) -> None:
    code = (
        "import sys\nfrom dashboard.sql_runner import run_query\n"
        "run_query(sys.argv[1], 'SELECT count(*) FROM range(1000000000) a, range(1000000000) b', seconds=60)"
    )
    server = subprocess.Popen([sys.executable, "-c", code, str(filled)], cwd=Path(__file__).parents[2])
    worker = None
    end = time.monotonic() + 30
    while worker is None and time.monotonic() < end:
        children = Path(f"/proc/{server.pid}/task/{server.pid}/children").read_text().split()
        worker = next((int(child) for child in children if _runs_a_query(int(child))), None)
        time.sleep(0.05)
    assert worker is not None
    server.send_signal(signal.SIGKILL)
    server.wait()
    while time.monotonic() < end and _runs_a_query(worker):
        time.sleep(0.05)
    assert not _runs_a_query(worker)


def _runs_a_query(process: int) -> bool:
    try:
        started = b"sql_worker" in Path(f"/proc/{process}/cmdline").read_bytes()
        return started and "_duckdb." in Path(f"/proc/{process}/maps").read_text()
    except OSError:
        return False


def test_further_queries_wait_for_their_turn(filled: Path) -> None:
    waited: list[str] = []

    def ask() -> None:  # starting a process takes long enough that all ask at once
        run_query(filled, "SELECT 1", seconds=300, on_wait=lambda: waited.append("waited"))

    threads = [threading.Thread(target=ask) for _ in range(AT_ONCE + 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert waited == ["waited"]


def test_whoever_waits_too_long_is_told(filled: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sql_runner, "_turns", threading.BoundedSemaphore(1))
    with sql_runner._turn(1, lambda: None), pytest.raises(UsageError, match="try again"):
        run_query(filled, "SELECT 1", seconds=0.2)


@pytest.mark.parametrize(
    "sql",
    [
        "SELECT DATE '290000-01-01' AS d",
        "SELECT TIMESTAMPTZ '290000-01-01 00:00:00' AS t",
        "SELECT union_value(n := 1)::UNION(n INTEGER, s VARCHAR) AS u",
        "SELECT error(repeat('x', 100000))",
    ],
)
def test_values_that_no_page_can_show_are_refused_in_one_line(sql: str, filled: Path) -> None:
    with pytest.raises(UsageError) as problem:
        run_query(filled, sql)
    assert "\n" not in str(problem.value)
    assert len(str(problem.value)) < 10_000


def test_odd_values_are_shown(filled: Path) -> None:
    rows = run_query(filled, "SELECT MAP {'a': 1} AS m, INTERVAL 3 MONTH AS i, [1, 2] AS l, {'x': 1} AS s").rows
    assert len(rows.to_csv()) > 10
