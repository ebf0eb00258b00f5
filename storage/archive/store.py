"""The store as everyone else uses it: publish a result, query the tables, fetch a scene's cloud and pictures."""

from __future__ import annotations

import contextlib
import json
import logging
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from metrology.errors import RigError, StoreError
from storage.archive.files import disk_trouble, locked, write_first
from storage.archive.layout import STORE_FORMAT, Layout, ScenePaths
from storage.archive.statements import check_one_statement, query_problem
from storage.documents import read_json
from storage.models import leads_inside

if TYPE_CHECKING:
    import duckdb
    import pyarrow as pa

    from metrology.inspection import InspectionResult
    from metrology.results import SceneKey
    from metrology.rig import Rig
    from storage.archive.bundles import Bundles
    from storage.archive.known import KnownScene
    from storage.archive.panel_bundle import PanelDocument
    from storage.archive.panels import Panels
    from storage.archive.staging import StagedRun
    from storage.cloud import StoredCloud
    from storage.evidence.verifications import VerificationModel, Verifications

_log = logging.getLogger("flushline.archive")


class Store:
    """A folder that keeps every result by aircraft and panel.

    Opening a store touches nothing; it is made by the first result that is published into it.
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

    @property
    def verifications(self) -> Verifications:
        """Verifications of rigs."""
        from storage.evidence.verifications import Verifications

        return Verifications(self.layout)

    @property
    def bundles(self) -> Bundles:
        """Where bundles lie."""
        from storage.archive.bundles import Bundles

        return Bundles(self.layout)

    def create(self, bundles: str | None = None, reviews: str | None = None) -> None:
        """Make an empty store.

        Parameters
        ----------
        bundles : str, optional
            Where its bundles shall lie: a URI such as ``s3://bucket/prefix``; by default in the store's folder.
        reviews : str, optional
            PostgreSQL database of what people decide, as a URL without a password; by default SQLite in the store's
            folder.
        """
        from storage.archive.remote import Remote
        from storage.review_database import check_url

        self.check_usable()
        if self.layout.marker.exists():
            raise StoreError(f"{self.root}: found a store, expected a new folder")
        if bundles:
            Remote(bundles).runs()  # refused where it cannot be reached
        if reviews:
            check_url(reviews)
        self.root.mkdir(parents=True, exist_ok=True)
        document = {"format": STORE_FORMAT} | ({"bundles": bundles} if bundles else {})
        document |= {"reviews": reviews} if reviews else {}
        write_first(self.layout.marker, json.dumps(document).encode())
        self.prepare()

    def check_usable(self) -> None:
        """Refuse a folder that holds something else than a store, before any work is done for it."""
        root = self.root
        if root.exists() and not root.is_dir():
            raise StoreError(f"{root}: found a file, expected a store's folder")
        above = next(folder for folder in root.absolute().parents if folder.exists())
        if not above.is_dir():
            raise StoreError(f"{above}: found a file, expected a folder for the store {root.name}")
        if self.layout.marker.exists():
            found = read_json(self.layout.marker, StoreError).get("format")
            if found != STORE_FORMAT:
                raise StoreError(f"{self.layout.marker}: found format {found!r}, expected {STORE_FORMAT!r}")
        elif root.is_dir() and self._holds_other_things():
            raise StoreError(f"{root}: found a folder with other things in it, expected a store or an empty folder")

    def existing(self) -> Layout:
        """Where things lie in a store that is there; refused where there is none, or one of another format."""
        if not self.root.exists():
            raise StoreError(f"{self.root}: found no such folder, expected a store")
        if self.root.is_dir() and not self.layout.marker.exists():
            raise StoreError(f"{self.root}: found no {self.layout.marker.name}, expected a store")
        self.check_usable()
        return self.layout

    def publish(self, result: InspectionResult) -> str:
        """Store a result: its bundle first, then the index, then the published index.

        Whoever reads sees the scene's former rows or the new ones, all of them, whatever happens here. A scene that is
        signed off is refused.

        Returns
        -------
        str
            The run's id.

        Raises
        ------
        PatternTaken
            Where the result enrols its station's pattern, but another scan's is there by now.
        SceneError
            Where another scan is stored under the same key.
        """
        from storage.archive.bundle import write_bundle
        from storage.archive.signed import refuse_signed_off

        key = result.key
        self.check_usable()
        refuse_signed_off(self.root, key.scene_id)
        pattern = self.panels.pattern_path(key.panel, key.station)
        digest = result.reconstruction.frames_digest
        verification = self.verifications.last(result.reconstruction.rig.id)

        def write(run: StagedRun, place: str, head: str | None) -> None:
            write_bundle(run.folder, run.run_id, place, result, run.first_stored_at, head, verification)

        run = self._store(self.layout.scene(key), pattern, write, digest)
        taken, refused = self._entered(run)
        refuse_signed_off(self.root, key.scene_id, run.run_id)  # signed off meanwhile
        self._check_entered(run, taken, refused)
        return run.run_id

    def publish_panel(self, document: PanelDocument) -> str:
        """Store an assembled panel, as `publish` does a scene; its newest run is shown. Returns the run's id."""
        from storage.archive.panel_bundle import write_panel_bundle

        def write(run: StagedRun, place: str, head: str | None) -> None:
            write_panel_bundle(run.folder, run.run_id, place, document, head)

        key = document.key
        # No panel run enrols a pattern: the path only says where one of this name would be.
        pattern = self.panels.pattern_path(key.panel, "assembled")
        run = self._store(self.layout.scene_folder(key.panel_id), pattern, write)
        self._check_entered(run, *self._entered(run))
        return run.run_id

    def _store(
        self, folder: Path, pattern: Path, write: Callable[[StagedRun, str, str | None], None],
        digest: str | None = None,
    ) -> StagedRun:  # fmt: skip
        """Write a run of what has this folder, and give it its place."""
        from storage.archive.anchors import head_to_name
        from storage.archive.staging import settle, staged_run

        with disk_trouble(self.root, "the store is as it was"):
            self.prepare()
            with staged_run(self.layout, folder, pattern, digest) as run:
                write(run, self.layout.relative(run.final), head_to_name(self.root))
                settle(self.layout, run, pattern)
        return run

    def _entered(self, run: StagedRun) -> tuple[set[Path], dict[Path, str]]:
        later = "will enter the tables with the next one, or by 'flushline archive rebuild'"
        with disk_trouble(self.root, f"the result is kept in {run.final} and {later}"):
            return self._take_up()

    def _check_entered(self, run: StagedRun, taken: set[Path], refused: Mapping[Path, str]) -> None:
        if run.final in refused:
            raise StoreError(f"{refused[run.final]}; the result is kept there, but is not in the tables")
        if run.final not in taken:
            self._check_shown(run.final)  # another writer took it up

    def recover(self) -> int:
        """Take up what writers left: index complete bundles, remove dead staging; returns how many runs were indexed.

        Every writer ends with this, so one that waited for the lock often finds its bundle indexed by another. A run
        that the index cannot take is left out, and said in one line.
        """
        with disk_trouble(self.root, "complete runs will enter the tables when there is"):
            taken, _ = self._take_up()
            return len(taken)

    def _take_up(self) -> tuple[set[Path], dict[Path, str]]:
        """Runs that entered the tables that readers see, and what is wrong with others."""
        from storage.archive import generations
        from storage.archive.staging import pending

        with locked(self.layout.lock):
            runs = pending(self.layout)
            if not runs:
                return set(), {}
            refused = generations.publish(self.layout, list(runs.values()))
            for marker in runs:
                marker.unlink(missing_ok=True)
        for problem in refused.values():
            _log.warning("%s; it is left out of the tables", problem)
        return set(runs.values()) - refused.keys(), refused

    def _check_shown(self, run: Path) -> None:
        """Refuse to call a run published that readers do not see, nor a newer one in its place."""
        from storage.archive import bookkeeping, snapshot

        with contextlib.closing(snapshot.connect(self.layout)) as connection:
            shown = bookkeeping.shown_runs(connection, [run.parent.name]).get(run.parent.name)
        if shown is None or shown < run.name:
            raise StoreError(
                f"{self.layout.archive}: found {f'run {shown}' if shown else 'no run'} of {run.parent.name}, expected "
                f"{run.name}; the result is kept in {run}, and 'flushline archive check' says what is wrong"
            )

    def connect(self, spill: Path | None = None) -> duckdb.DuckDBPyConnection:
        """A read-only connection to the newest published index that cannot reach other files.

        An index that lacks tables, columns or views of this version is brought up to date first; where that may not
        be done, what it lacks is NULL.

        Parameters
        ----------
        spill : Path, optional
            Folder for what does not fit in memory, given by a process that may write nowhere else; see
            `snapshot.connect`.
        """
        from storage.archive import bookkeeping, older, snapshot

        layout = self.existing()
        connection = snapshot.connect(layout, spill)
        if bookkeeping.is_known(connection):
            return connection
        if spill or not os.access(layout.lock, os.W_OK):
            older.cover(connection)
            return connection
        from storage.archive import generations

        connection.close()
        with disk_trouble(self.root, "the index is as it was"), locked(layout.lock):
            for problem in generations.publish(layout, []).values():
                _log.warning("%s; it is left out of the tables", problem)
        return snapshot.connect(layout)

    def query(self, sql: str, parameters: Sequence[object] = ()) -> pa.Table:
        """Rows that a SQL query returns; it can neither write nor reach other files.

        Parameters
        ----------
        sql : str
            With ``?`` where a parameter goes.
        """
        import duckdb

        from storage.archive.tables_beside import register_tables

        with contextlib.closing(self.connect()) as connection:
            register_tables(connection, self.root, sql)
            try:
                check_one_statement(connection, sql)
                rows = connection.sql(sql, params=list(parameters) or None)
                if rows is None:
                    raise StoreError("query: found a statement without a result, expected a SELECT")
                return rows.to_arrow_table()
            except duckdb.Error as problem:
                raise StoreError(f"query: {query_problem(problem)}") from None

    def paths(self, scene_id: str) -> ScenePaths:
        """Where the files of a scene's current run lie; from object storage they are fetched."""
        with contextlib.closing(self.connect()) as connection:
            row = connection.execute(
                "SELECT bundle_path, cloud_path, overlay_path, preview_path FROM scenes WHERE scene_id = ?", [scene_id]
            ).fetchone()
        if row is None:
            raise StoreError(f"{self.root}: found no scene {scene_id!r}, expected a scene_id of the table scenes")
        paths = ScenePaths(*(self._inside(path) for path in row))
        self.bundles.bring(paths.bundle)
        return paths

    def file(self, relative: str) -> Path:
        """A file of a bundle by the path that the tables have for it; from object storage it is fetched."""
        self.bundles.bring_file(path := self._inside(relative))
        return path

    def _inside(self, relative: str) -> Path:
        """A path of the tables, which has to be one of the bundles."""
        path = self.root / relative
        if not leads_inside(relative) or not path.is_relative_to(self.layout.bundles):
            raise StoreError(f"{self.root}: found path {relative!r} in the tables, expected one of a bundle")
        return path

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

    def known(self, key: SceneKey) -> KnownScene | None:
        """What is known of a scene; None where it has no run."""
        from storage.archive.known import known_scene

        return known_scene(self.layout, self.layout.scene(key))

    def scenes_of_frames(self, frames_digest: str | None, but: SceneKey) -> tuple[str, ...]:
        """Ids of other scenes than one that have the same frames."""
        from storage.archive.copies import scenes_of_frames

        return scenes_of_frames(self.layout, frames_digest, but.scene_id)

    def known_scenes(self) -> dict[str, KnownScene]:
        """Every scene of the published index, by its id."""
        from storage.archive.known import known_scenes

        return known_scenes(self.layout)

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
        with disk_trouble(self.root, f"rig {rig.id!r} is not kept"):
            self.prepare()
            save_rig(rig, path)
        return True

    def keep_verification(self, model: VerificationModel, report: str) -> Path:
        """Keep a verification of a rig for good, with its report (HTML); returns its file."""
        with disk_trouble(self.root, "the verification is not kept"):
            self.prepare()
            return self.verifications.keep(model, report)

    def prepare(self) -> None:
        """Make what every store has."""
        self.check_usable()
        self.root.mkdir(parents=True, exist_ok=True)
        if not self.layout.marker.exists():
            write_first(self.layout.marker, json.dumps({"format": STORE_FORMAT}).encode())
        for folder in (self.layout.bundles, self.layout.rigs, self.layout.staging, self.layout.index):
            folder.mkdir(exist_ok=True)

    def _holds_other_things(self) -> bool:
        """Whether the folder has something in it and is no store, not even one that another process makes just now."""
        found = any(not entry.name.startswith(".") for entry in self.root.iterdir())
        return found and not self.layout.marker.exists()
