"""Runs' rows on their way from bundles into an index: looked at before they are let in.

The rows of each run have to be its own, as many as its manifest says, and in columns that the index has. Many runs are
read at once; where something is wrong, halves of them are tried, until the run is found that it is wrong with.
"""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version as installed_version
from pathlib import Path

import duckdb

from metrology.errors import StoreError
from storage.archive import bookkeeping
from storage.archive.bundle import BundleModel
from storage.archive.layout import Layout

Runs = Mapping[Path, BundleModel]
_KEY = ("aircraft_serial", "panel", "station", "captured_at", "scene_id")
_FILE = "bundle_file"


@dataclass
class Outcome:
    """What became of runs that were to be loaded.

    Attributes
    ----------
    loaded : dict
        Digests of the rows, by run.
    refused : dict
        What is wrong, by run; one line each.
    """

    loaded: dict[Path, int] = field(default_factory=dict)
    refused: dict[Path, str] = field(default_factory=dict)

    def add(self, other: Outcome) -> None:
        """Take another outcome in."""
        self.loaded |= other.loaded
        self.refused |= other.refused


class Loader:
    """Puts runs into an index in place of those of their scenes.

    Parameters
    ----------
    connection : duckdb.DuckDBPyConnection
        The index.
    layout : Layout
    """

    def __init__(self, connection: duckdb.DuckDBPyConnection, layout: Layout) -> None:
        self.connection, self.layout = connection, layout
        self.columns = bookkeeping.additions(connection)

    def load(self, runs: Runs, keep: bool = True) -> Outcome:
        """Load runs of different scenes, all rows of a run or none.

        Parameters
        ----------
        keep : bool
            False looks at the rows only.
        """
        outcome = Outcome()
        self._load(dict(runs), keep, outcome)
        return outcome

    def _load(self, runs: dict[Path, BundleModel], keep: bool, outcome: Outcome) -> None:
        if not runs:
            return
        self.connection.execute("BEGIN")
        try:
            self._arrive(runs)
            digests = self._digests()
            if keep:
                self._settle([manifest.scene_id for manifest in runs.values()])
            self.connection.execute("COMMIT")
        except (duckdb.Error, StoreError) as problem:
            with contextlib.suppress(duckdb.Error):
                self.connection.execute("ROLLBACK")
            refuse_full_disk(self.layout.index, problem)
            if len(runs) > 1:
                items = list(runs.items())
                self._load(dict(items[: len(items) // 2]), keep, outcome)
                self._load(dict(items[len(items) // 2 :]), keep, outcome)
            else:
                [(run, manifest)] = runs.items()
                outcome.refused[run] = _said(run, manifest, problem)
        except BaseException:
            with contextlib.suppress(duckdb.Error):
                self.connection.execute("ROLLBACK")
            raise
        else:
            outcome.loaded |= {run: digests[manifest.scene_id] for run, manifest in runs.items()}

    def _arrive(self, runs: Runs) -> None:
        """Read the rows into tables of their own, and refuse what is not as it should be."""
        self._state(runs)
        for table in self.columns:
            self.connection.execute(
                f"CREATE OR REPLACE TEMP TABLE arrived_{table} AS "
                f"SELECT *, NULL::VARCHAR AS {_FILE} FROM {table} LIMIT 0"
            )
            files = [str(run / f"{table}.parquet") for run, manifest in runs.items() if table in manifest.rows]
            if files:
                # The folders of a bundle are named by aircraft and panel, but not in Hive's way.
                self.connection.execute(
                    f"INSERT INTO arrived_{table} BY NAME SELECT * FROM read_parquet(?, hive_partitioning = false, "
                    f"union_by_name = true, filename = '{_FILE}')",
                    [files],
                )
            self._check(table, runs)

    def _state(self, runs: Runs) -> None:
        """Keep what the manifests say beside what will arrive."""
        for run, manifest in runs.items():
            if run != self.layout.scene(manifest.key) / manifest.run_id:
                raise StoreError(
                    f"{run}: found run {manifest.run_id} of {manifest.scene_id}, expected it in its own folder"
                )
            if unknown := sorted(manifest.rows.keys() - self.columns.keys()):
                version = manifest.versions.get("flushline", "unknown")
                raise StoreError(
                    f"{run}: found table {unknown[0]} of version {version}, expected one of "
                    f"{', '.join(sorted(self.columns))}"
                )
        names = ("run", "place", "run_id", *_KEY)
        rows = [
            (str(run), self.layout.relative(run), m.run_id, *(getattr(m, name) for name in _KEY))
            for run, m in runs.items()
        ]
        columns = ", ".join(
            f"unnest(?{'::TIMESTAMPTZ[]' if n == 'captured_at' else '::VARCHAR[]'}) AS {n}" for n in names
        )
        self.connection.execute(
            f"CREATE OR REPLACE TEMP TABLE stated AS SELECT {columns}",
            [list(column) for column in zip(*rows, strict=True)],
        )

    def _check(self, table: str, runs: Runs) -> None:
        """Refuse rows of another scene, another count than the manifest's, and paths that lead out of the bundle."""
        paths = [name for group in self.columns[table] for name in group if name.endswith("_path")]
        leading_out = [
            f"(a.{name} <> s.place AND NOT starts_with(a.{name}, s.place || '/')) OR contains(a.{name}, '..')"
            for name in paths
        ]
        names = (*_KEY, "run_id") if table == "scenes" else _KEY
        own = " AND ".join(f"a.{name} IS NOT DISTINCT FROM s.{name}" for name in names)
        counted = self.connection.execute(
            f"SELECT s.run, count(a.{_FILE}), count(a.{_FILE}) FILTER ({own}), "
            f"count(a.{_FILE}) FILTER ({' OR '.join(leading_out) or 'false'}) "
            f"FROM stated s LEFT JOIN arrived_{table} a ON a.{_FILE} = s.run || '/{table}.parquet' GROUP BY s.run"
        ).fetchall()
        for name, rows, fitting, outside in counted:
            manifest = runs[Path(name)]
            file, expected = f"{name}/{table}.parquet", 1 if table == "scenes" else manifest.rows.get(table, 0)
            if rows != expected:
                raise StoreError(f"{file}: found {rows} rows, expected {expected}")
            if fitting != rows:
                raise StoreError(f"{file}: found rows of another scene or run, expected those of {manifest.scene_id}")
            if outside:
                raise StoreError(f"{file}: found a path that leads out of the bundle, expected one inside it")

    def _digests(self) -> dict[str, int]:
        return dict(self.connection.execute(self._digests_sql).fetchall())

    @property
    def _digests_sql(self) -> str:
        return bookkeeping.digests_sql(self.columns, lambda table: f"arrived_{table}")

    def _settle(self, scenes: Sequence[str]) -> None:
        """Put what arrived in place of the scenes' former rows."""
        held = self.connection.execute("SELECT count(*) FROM scenes WHERE scene_id IN (SELECT unnest(?))", [scenes])
        if held.fetchall() != [(0,)]:
            for table in (*self.columns, bookkeeping.RUNS.name):
                self.connection.execute(f"DELETE FROM {table} WHERE scene_id IN (SELECT unnest(?))", [scenes])
        for table in self.columns:
            self.connection.execute(
                f"INSERT INTO {table} BY NAME SELECT * EXCLUDE ({_FILE}) FROM arrived_{table} ORDER BY rowid"
            )
        self.connection.execute(
            f"INSERT INTO {bookkeeping.RUNS.name} SELECT scene_id, run_id, digest FROM arrived_scenes "
            f"JOIN ({self._digests_sql}) USING (scene_id)"
        )


def _said(run: Path, manifest: BundleModel, problem: Exception) -> str:
    """What is wrong with a run, in one line."""
    if isinstance(problem, StoreError):
        return str(problem)
    version = manifest.versions.get("flushline", "unknown")
    return (
        f"{run}: found {str(problem).splitlines()[0]} (the run is of version {version}), expected rows that the "
        f"tables of version {installed_version('flushline')} take"
    )


def refuse_full_disk(path: Path, problem: Exception) -> None:
    """DuckDB says in words of its own what is an OSError elsewhere."""
    if os.strerror(errno.ENOSPC) in str(problem):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path)) from problem
