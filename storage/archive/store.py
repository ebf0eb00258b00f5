"""The store as everyone else uses it: publish a result, query the tables, fetch a scene's cloud and pictures."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from metrology.errors import RigError, StoreError
from storage.archive.files import hold, locked, make_folders, sync, write_durably
from storage.archive.layout import STORE_FORMAT, Layout, new_run_id
from storage.documents import read_json

if TYPE_CHECKING:
    import duckdb
    import pyarrow as pa

    from metrology.inspection import InspectionResult
    from metrology.rig import Rig
    from storage.archive.panels import Panels
    from storage.cloud import StoredCloud


@dataclass(frozen=True)
class ScenePaths:
    """Files of a scene's current run.

    Attributes
    ----------
    bundle : Path
        The run's folder, with its manifest, rig and tables.
    cloud, overlay, preview : Path
    """

    bundle: Path
    cloud: Path
    overlay: Path
    preview: Path


class Store:
    """A folder that keeps every result by aircraft and panel.

    Opening a store touches nothing; it is made by the first result that is published into it.

    Parameters
    ----------
    root : Path
    """

    def __init__(self, root: Path) -> None:
        self.layout = Layout(Path(root))

    @property
    def root(self) -> Path:
        """The store's folder."""
        return self.layout.root

    @property
    def panels(self) -> Panels:
        """Panel specifications and enrolled patterns."""
        from storage.archive.panels import Panels

        return Panels(self.layout.panels)

    def check_usable(self) -> None:
        """Refuse a folder that holds something else than a store, before any work is done for it."""
        root = self.root
        if root.exists() and not root.is_dir():
            raise StoreError(f"{root}: found a file, expected a store's folder")
        if self.layout.marker.exists():
            found = read_json(self.layout.marker, StoreError).get("format")
            if found != STORE_FORMAT:
                raise StoreError(f"{self.layout.marker}: found format {found!r}, expected {STORE_FORMAT!r}")
        elif root.is_dir() and any(root.iterdir()):
            raise StoreError(f"{root}: found a folder with other things in it, expected a store or an empty folder")

    def existing(self) -> Layout:
        """Where things lie in a store that is there; refused where there is none."""
        if not self.root.is_dir():
            raise StoreError(f"{self.root}: found no such folder, expected a store")
        if not self.layout.marker.exists():
            raise StoreError(f"{self.root}: found no {self.layout.marker.name}, expected a store")
        return self.layout

    def publish(self, result: InspectionResult) -> str:
        """Store a result: its bundle first, then the index, then the published index.

        Whoever reads sees the scene's former rows or the new ones, all of them, whatever happens here.

        Returns
        -------
        str
            The run's id.
        """
        from storage.archive.bundle import write_bundle

        try:
            self.prepare()
            scene = self.layout.scene(result.key)
            with self._staging(scene) as (run_id, staging):
                final = scene / run_id
                write_bundle(staging, run_id, self.layout.relative(final), result)
                make_folders(scene, self.root)
                staging.rename(final)
                sync(scene)
        except OSError as problem:
            raise StoreError(f"{_disk_problem(self.root, problem)}; the store is as it was") from problem
        try:
            self.recover()
        except (OSError, StoreError) as problem:
            text = _disk_problem(self.root, problem) if isinstance(problem, OSError) else str(problem)
            raise StoreError(
                f"{text}; the result is kept in {final} and will enter the tables with the next one, "
                "or by 'flushline archive rebuild'"
            ) from problem
        return run_id

    def recover(self) -> int:
        """Take up what writers left: index complete bundles, remove dead staging; returns how many runs were indexed.

        Every writer ends with this, so one that waited for the lock often finds its bundle indexed by another.
        """
        from storage.archive import index, snapshot
        from storage.archive.bundle import check_bundle

        with locked(self.layout.lock):
            finished: list[tuple[Path, Path]] = []
            for marker in sorted(self.layout.staging.glob("*.json")):
                run = self._pending_run(marker)
                if run is not None and run.is_dir():
                    finished.append((marker, run))
                elif (descriptor := hold(marker)) is not None:  # its writer is dead
                    shutil.rmtree(marker.with_suffix(""), ignore_errors=True)
                    marker.unlink(missing_ok=True)
                    os.close(descriptor)
            if not finished:
                return 0
            with index.writing(self.layout) as connection:
                for _, run in finished:
                    with contextlib.suppress(StoreError):  # damaged on disk: `archive check` names it
                        index.replace_run(connection, run, check_bundle(run, only_tables=True))
            snapshot.publish(self.layout)
            for marker, _ in finished:
                marker.unlink(missing_ok=True)
            return len(finished)

    def connect(self) -> duckdb.DuckDBPyConnection:
        """A read-only connection to the newest published index that cannot reach other files."""
        from storage.archive import snapshot

        return snapshot.connect(self.existing())

    def query(self, sql: str, parameters: Sequence[object] = ()) -> pa.Table:
        """Rows that a SQL query returns; it can neither write nor reach other files.

        Parameters
        ----------
        sql : str
            With ``?`` where a parameter goes.
        parameters : sequence
        """
        import duckdb

        with contextlib.closing(self.connect()) as connection:
            try:
                rows = connection.sql(sql, params=list(parameters) or None)
                if rows is None:
                    raise StoreError("query: found a statement without a result, expected a SELECT")
                return rows.to_arrow_table()
            except duckdb.Error as problem:
                raise StoreError(f"query: {' '.join(str(problem).split())}") from None

    def paths(self, scene_id: str) -> ScenePaths:
        """Where the files of a scene's current run lie."""
        with contextlib.closing(self.connect()) as connection:
            row = connection.execute(
                "SELECT bundle_path, cloud_path, overlay_path, preview_path FROM scenes WHERE scene_id = ?", [scene_id]
            ).fetchone()
        if row is None:
            raise StoreError(f"{self.root}: found no scene {scene_id!r}, expected a scene_id of the table scenes")
        return ScenePaths(*(self.root / path for path in row))

    def load_cloud(self, scene_id: str) -> StoredCloud:
        """The organised cloud of a scene's current run."""
        from storage.cloud import read_cloud

        return read_cloud(self.paths(scene_id).cloud)

    def holds(self, scene_id: str, config_hash: str, rig_hash: str) -> bool:
        """Whether the scene's current run was made with these settings and this rig."""
        if not self.layout.archive.exists():
            return False
        with contextlib.closing(self.connect()) as connection:
            row = connection.execute(
                "SELECT 1 FROM scenes WHERE scene_id = ? AND config_hash = ? AND rig_hash = ?",
                [scene_id, config_hash, rig_hash],
            ).fetchone()
        return row is not None

    def has_rig(self, rig_id: str) -> bool:
        """Whether the store's `rigs` folder holds the calibration."""
        return (self.layout.rigs / f"{rig_id}.json").is_file()

    def find_rig(self, rig_id: str) -> Rig:
        """The calibration that a scene names, from the store's `rigs` folder."""
        from storage.rig import load_rig

        path = self.layout.rigs / f"{rig_id}.json"
        if not self.has_rig(rig_id):
            raise RigError(
                f"{self.layout.rigs}: found no rig {rig_id!r}, expected {path.name} there or a file given with --rig"
            )
        return load_rig(path)

    def add_rig(self, rig: Rig) -> bool:
        """Keep a calibration for scenes that name it; one that is already there stays. Returns whether it is new."""
        from storage.rig import save_rig

        path = self.layout.rigs / f"{rig.id}.json"
        if path.exists():
            return False
        self.prepare()
        save_rig(rig, path)
        return True

    def prepare(self) -> None:
        """Make what every store has."""
        self.check_usable()
        self.root.mkdir(parents=True, exist_ok=True)
        for folder in (self.layout.bundles, self.layout.rigs, self.layout.staging, self.layout.index):
            folder.mkdir(exist_ok=True)
        if not self.layout.marker.exists():
            write_durably(self.layout.marker, json.dumps({"format": STORE_FORMAT}).encode())

    @contextlib.contextmanager
    def _staging(self, scene: Path) -> Iterator[tuple[str, Path]]:
        """A run's id and an empty folder to write it into, with a marker that says where it will lie.

        The marker is locked as long as its writer lives; it stays after success until the run is in the index.
        """
        with locked(self.layout.lock):  # so that nobody sees the marker before it is locked
            run_id = new_run_id(scene)
            marker, folder = self.layout.staging / f"{run_id}.json", self.layout.staging / run_id
            write_durably(marker, json.dumps({"run": self.layout.relative(scene / run_id)}).encode())
            descriptor = hold(marker)
            folder.mkdir()
        try:
            yield run_id, folder
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            if not (scene / run_id).exists():
                marker.unlink(missing_ok=True)
            raise
        finally:
            if descriptor is not None:
                os.close(descriptor)

    def _pending_run(self, marker: Path) -> Path | None:
        """Where the run of a staging marker will lie; None for a marker that its writer did not finish."""
        try:
            return self.root / str(json.loads(marker.read_text())["run"])
        except (OSError, ValueError, KeyError):
            return None


def _disk_problem(root: Path, problem: OSError) -> str:
    if problem.errno == errno.ENOSPC:
        return f"{root}: found the disk full, expected room for a result"
    return f'{problem.filename or root}: found "{problem.strerror}", expected a store that can be written'
