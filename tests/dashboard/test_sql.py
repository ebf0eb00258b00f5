"""The query page's runner: it answers, and whatever is typed it neither writes, nor reads files, nor stalls."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from dashboard.sql_runner import run_query
from metrology.errors import UsageError
from storage.review import Feature, ReviewLog, ShownFinding


def test_rows_and_the_row_limit(filled: Path) -> None:
    answer = run_query(filled, "SELECT rivet_id, height_mean_mm FROM rivets ORDER BY 1", rows=10)
    assert len(answer.rows) == 10
    assert answer.truncated
    assert not run_query(filled, "SELECT 1 AS one").truncated
    assert "rivets" in set(run_query(filled, "SHOW TABLES").rows["name"])


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
    with pytest.raises(UsageError):
        run_query(filled, sql, seconds=2.5)
    assert time.monotonic() - started < 6


@pytest.mark.parametrize("sql", ["SELECT repeat('a', 2000000000)", "SELECT repeat('abc', 30000000) FROM range(9)"])
def test_a_result_that_is_too_large_is_refused(sql: str, filled: Path) -> None:
    with pytest.raises(UsageError):
        run_query(filled, sql, seconds=10)
