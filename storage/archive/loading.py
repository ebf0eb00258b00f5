"""Runs' rows on their way from bundles into an index: looked at before they are let in.

The rows of each run have to be its own, as many as its manifest says, and in columns that the index has. Many runs are
read at once; where something is wrong, halves of them are tried, until the run is found that it is wrong with.
"""

from __future__ import annotations

import contextlib
import errno
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib.metadata import version as installed_version
from pathlib import Path

import duckdb

from metrology.errors import StoreError
from storage.archive import bookkeeping
from storage.archive.bundle import BundleModel
from storage.archive.layout import Layout
from storage.models import leads_inside

Runs = Mapping[Path, BundleModel]
_Group = tuple[str, str, int, int, dict[str, object]]
"""Rows of a table and file that are alike in what has to fit their run: how many, their digest, and those values."""
_KEY = ("aircraft_serial", "panel", "station", "captured_at", "scene_id")
_FILE = "bundle_file"
_ARRIVED = "arrived_"


@dataclass
class Outcome:
    """What became of runs that were to be loaded."""

    loaded: dict[Path, int] = field(default_factory=dict)
    """Digests of the rows, by run."""
    refused: dict[Path, str] = field(default_factory=dict)
    """What is wrong, by run; one line each."""

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
    held : collection of str
        Scenes that the index has.
    """

    def __init__(self, connection: duckdb.DuckDBPyConnection, layout: Layout, held: Iterable[str] = ()) -> None:
        self.connection, self.layout, self.held = connection, layout, set(held)
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
            digests = self._entered(runs) if keep and len(runs) == 1 else self._arrived(runs)
            if keep and len(runs) > 1:
                self._settle(runs)
            if keep:
                self._note(runs, digests)
            self.connection.execute("COMMIT")
        except (duckdb.Error, StoreError) as problem:
            self._roll_back()
            refuse_full_disk(self.layout.index, problem)
            if len(runs) > 1:
                items = list(runs.items())
                self._load(dict(items[: len(items) // 2]), keep, outcome)
                self._load(dict(items[len(items) // 2 :]), keep, outcome)
            else:
                [(run, manifest)] = runs.items()
                outcome.refused[run] = _said(run, manifest, problem)
        except BaseException:
            self._roll_back()
            raise
        else:
            outcome.loaded |= digests
            self.held |= {manifest.scene_id for manifest in runs.values()}

    def _roll_back(self) -> None:
        with contextlib.suppress(duckdb.Error):
            self.connection.execute("ROLLBACK")

    def _check_tables(self, runs: Runs) -> None:
        for run, manifest in runs.items():
            _check_place(run, manifest, self.layout)
            if unknown := sorted(manifest.rows.keys() - self.columns.keys()):
                version = manifest.versions.get("flushline", "unknown")
                known = ", ".join(sorted(self.columns))
                raise StoreError(f"{run}: found table {unknown[0]} of version {version}, expected one of {known}")

    def _entered(self, runs: Runs) -> dict[Path, int]:
        """Put one run's rows into the tables and look at them as they enter; returns the digest.

        Where there is one run only, this takes half the time of looking at rows first.
        """
        self._check_tables(runs)
        self._remove_former(runs)
        return self._checked(runs, (group for run, manifest in runs.items() for group in self._enter(run, manifest)))

    def _enter(self, run: Path, manifest: BundleModel) -> Iterator[_Group]:
        for table in manifest.rows:
            file = str(run / f"{table}.parquet")
            names = (*_KEY, *self._more(table))
            entered = self.connection.execute(
                f"INSERT INTO {table} BY NAME SELECT * FROM read_parquet(?, hive_partitioning = false) "
                f"RETURNING {bookkeeping.row_hash(table, self.columns[table])}, {', '.join(names)}",
                [file],
            ).fetchall()
            counts, digests = Counter[tuple[object, ...]](), Counter[tuple[object, ...]]()
            for digest, *values in entered:
                counts[tuple(values)] += 1
                digests[tuple(values)] += digest
            for found, rows in counts.items():
                yield table, file, rows, digests[found], dict(zip(names, found, strict=True))

    def _arrived(self, runs: Runs) -> dict[Path, int]:
        """Read the rows into tables of their own, and refuse what is not as it should be; returns their digests."""
        self._check_tables(runs)
        for table in self.columns:
            self.connection.execute(
                f"CREATE OR REPLACE TEMP TABLE {_ARRIVED}{table} AS "
                f"SELECT *, NULL::VARCHAR AS {_FILE} FROM {table} LIMIT 0"
            )
            if files := [str(run / f"{table}.parquet") for run, manifest in runs.items() if table in manifest.rows]:
                # The folders of a bundle are named by aircraft and panel, but not in Hive's way.
                self.connection.execute(
                    f"INSERT INTO {_ARRIVED}{table} BY NAME SELECT * FROM read_parquet(?, hive_partitioning = false, "
                    f"union_by_name = true, filename = '{_FILE}')",
                    [files],
                )
        found = self.connection.execute(self._counting).fetchall()
        return self._checked(
            runs, ((*first, dict(zip(_KEY, values, strict=True)) | (more or {})) for *first, values, more in found)
        )

    def _checked(self, runs: Runs, groups: Iterable[_Group]) -> dict[Path, int]:
        """Refuse rows of another scene, another count than the manifest's, and paths that lead out of the bundle.

        Returns
        -------
        dict
            Digest of each run's rows.
        """
        counted, digests = Counter[tuple[Path, str]](), dict.fromkeys(runs, 0)
        for table, file, rows, digest, values in groups:
            run = Path(file).parent
            counted[run, table] += rows
            digests[run] += digest
            _check_values(file, runs[run], values, self.layout)
        for run, manifest in runs.items():
            for table, stated in manifest.rows.items():
                expected = 1 if table == manifest.head_table else stated
                if counted[run, table] != expected:
                    raise StoreError(
                        f"{run / f'{table}.parquet'}: found {counted[run, table]} rows, expected {expected}"
                    )
        return digests

    @property
    def _counting(self) -> str:
        """Rows of each table and file, by what has to be the same in all of them."""
        parts = []
        for table, groups in self.columns.items():
            pairs = ", ".join(f"'{name}': {name}" for name in self._more(table))
            parts.append(
                f"SELECT '{table}', {_FILE}, count(*), sum({bookkeeping.row_hash(table, groups)})::HUGEINT, "
                f"row({', '.join(_KEY)}), {f'MAP {{{pairs}}}' if pairs else 'NULL'} AS more "
                f"FROM {_ARRIVED}{table} GROUP BY ALL"
            )
        return " UNION ALL ".join(parts)

    def _more(self, table: str) -> list[str]:
        """Columns whose values have to fit the run, besides those that name the scene."""
        names = [name for group in self.columns[table] for name in group]
        return [name for name in names if name.endswith("_path") or (name == "run_id" and table in bookkeeping.HEADS)]

    def _remove_former(self, runs: Runs) -> None:
        """Remove the rows of the scenes' former runs."""
        scenes = [manifest.scene_id for manifest in runs.values()]
        among = "scene_id = $1[1]" if len(scenes) == 1 else "scene_id IN (SELECT unnest($1))"
        if not self.held.isdisjoint(scenes):
            for table in (*self.columns, bookkeeping.RUNS.name):
                self.connection.execute(f"DELETE FROM {table} WHERE {among}", [scenes])

    def _settle(self, runs: Runs) -> None:
        """Put what arrived in place of the scenes' former rows."""
        self._remove_former(runs)
        for table in self.columns:
            self.connection.execute(f"INSERT INTO {table} BY NAME SELECT * EXCLUDE ({_FILE}) FROM {_ARRIVED}{table}")

    def _note(self, runs: Runs, digests: Mapping[Path, int]) -> None:
        """Say whose rows the index has now."""
        self.connection.execute(
            f"INSERT INTO {bookkeeping.RUNS.name} SELECT unnest($1), unnest($2), unnest($3::HUGEINT[])",
            [
                [manifest.scene_id for manifest in runs.values()],
                [manifest.run_id for manifest in runs.values()],
                [digests[run] for run in runs],
            ],
        )


def _check_place(run: Path, manifest: BundleModel, layout: Layout) -> None:
    if run != layout.scene_folder(manifest.named) / manifest.run_id:
        raise StoreError(f"{run}: found run {manifest.run_id} of {manifest.scene_id}, expected it in its own folder")


def _check_values(file: str, manifest: BundleModel, values: Mapping[str, object], layout: Layout) -> None:
    """Refuse rows that name another scene or run than the manifest does, or files outside the bundle."""
    named = _KEY if manifest.station else [name for name in _KEY if name != "station"]
    for name in (*named, *(["run_id"] if "run_id" in values else [])):
        if values[name] != getattr(manifest, name):
            raise StoreError(f"{file}: found rows with {name} {values[name]}, expected {getattr(manifest, name)}")
    place = layout.relative(layout.scene_folder(manifest.named) / manifest.run_id)
    for name, path in values.items():
        if name.endswith("_path") and path is not None:
            text = str(path)
            if not (leads_inside(text) and (text == place or text.startswith(f"{place}/"))):
                raise StoreError(f"{file}: found {name} {text!r}, expected one inside {place}")


def _said(run: Path, manifest: BundleModel, problem: Exception) -> str:
    """What is wrong with a run, in one line."""
    if isinstance(problem, StoreError):
        return str(problem)
    version = manifest.versions.get("flushline", "unknown")
    found = str(problem).splitlines()[0].replace(_ARRIVED, "")
    return (
        f"{run}: found {found} (the run is of version {version}), expected rows that the "
        f"tables of version {installed_version('flushline')} take"
    )


def refuse_full_disk(path: Path, problem: Exception) -> None:
    """DuckDB says in words of its own what is an OSError elsewhere."""
    if os.strerror(errno.ENOSPC) in str(problem):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path)) from problem
