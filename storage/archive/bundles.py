"""Where the bundles of a store lie: in its folder `bundles`, or on object storage.

A store on object storage has its index, rigs and panels in its folder as any other; there, `bundles` holds each run's
tables, from which the index is made, and what somebody looked at since. Whatever is missing is fetched.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path

from metrology.errors import StoreError
from storage.archive.bundle import MANIFEST, PATTERN, read_manifest
from storage.archive.files import make_folders, sync
from storage.archive.layout import Layout
from storage.archive.remote import Remote
from storage.documents import read_json

_WALKING_THREADS = 4  # a thread that waits for the disk lets another one go on


class Bundles:
    """The bundles of a store."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout

    @cached_property
    def target(self) -> str | None:
        """The URI of the bundles; None where they lie in the store's folder."""
        if not self.layout.marker.exists():
            return None
        found = read_json(self.layout.marker, StoreError).get("bundles")
        return str(found) if found else None

    def runs(self) -> list[Path]:
        """Every complete run of every scene, oldest first within a scene."""
        if self.target:
            return [self.layout.root / run for run in self._remote.runs()]
        return self._here(_has_manifest)

    def named(self) -> list[Path]:
        """Every run by its folder's name, complete or not: a third of the time of `runs`, which looks into each."""
        return self.runs() if self.target else self._here()

    def runs_of(self, scene: Path) -> list[Path]:
        """Complete runs of the scene with this folder, oldest first."""
        if self.target:
            return [self.layout.root / run for run in self._remote.runs(self.layout.relative(scene))]
        return sorted(manifest.parent for manifest in scene.glob(f"*/{MANIFEST}"))

    def incomplete(self) -> list[Path]:
        """Folders in place of a run that have no manifest."""
        return self._here(lambda run: not _has_manifest(run))

    def whatever_is_there(self) -> set[Path]:
        """Every run, complete or not."""
        return {*self._here(), *(self.runs() if self.target else ())}

    def arrived(self, run: Path, staged: Path) -> bool:
        """Whether a run that has no place here lies on object storage already; then it gets its place here, too."""
        if not (self.target and self._remote.has(self.layout.relative(run))):
            return False
        if staged.is_dir():
            self._settle_here(staged, run)
        else:
            self.bring(run, tables_only=True)
        return True

    def settle(self, staged: Path, run: Path) -> None:
        """Give a written run its place."""
        if self.target:
            self._remote.put(staged, self.layout.relative(run))
        self._settle_here(staged, run)

    def bring(self, run: Path, tables_only: bool = False) -> None:
        """Fetch what of a run is not in the store's folder."""
        if not self.target:
            return
        self.bring_file(run / MANIFEST)
        manifest = read_manifest(run)
        for name in manifest.table_files if tables_only else sorted(manifest.files):
            self.bring_file(run / name)

    @contextmanager
    def as_stored(self, run: Path) -> Iterator[Path]:
        """A run as it lies in the store; from object storage it is fetched anew."""
        if not self.target:
            yield run
            return
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / run.parent.name / run.name
            for name in self._remote.names(self.layout.relative(run)):
                self._remote.fetch(self.layout.relative(run), name, copy / name)
            yield copy

    def bring_file(self, path: Path) -> None:
        """Fetch a file of a run where it is not in the store's folder."""
        if self.target and not path.exists():
            try:
                self._remote.fetch(self.layout.relative(path.parent), path.name, path)
            except OSError as problem:
                wanted = self.layout.relative(path)
                raise StoreError(f"{self.target}: found {problem}, expected {wanted} there") from None

    def remove_there(self, run: Path) -> None:
        """Remove a run, or what there is of it, from object storage."""
        if self.target:
            self._remote.remove(self.layout.relative(run))

    def _here(self, wanted: Callable[[str], bool] = lambda run: True) -> list[Path]:
        """Every run's folder that is wanted, oldest first within a scene."""
        folder = str(self.layout.bundles)
        aircraft = sorted(filter(os.path.isdir, _below(folder, 1))) if os.path.isdir(folder) else []

        def runs_of(one: str) -> list[Path]:
            return [Path(run) for run in sorted(_below(one, 3)) if wanted(run)]

        with ThreadPoolExecutor(_WALKING_THREADS) as threads:
            return [run for runs in threads.map(runs_of, aircraft) for run in runs]

    @cached_property
    def _remote(self) -> Remote:
        return Remote(str(self.target))

    def _settle_here(self, staged: Path, run: Path) -> None:
        if self.target:
            kept = {MANIFEST, PATTERN, *read_manifest(staged).table_files}
            for path in staged.iterdir():
                if path.name not in kept:
                    path.unlink()
        make_folders(run.parent, self.layout.root)
        staged.rename(run)
        sync(run.parent)


def _has_manifest(run: str) -> bool:
    return os.path.isfile(f"{run}/{MANIFEST}")


def _below(folder: str, levels: int) -> Iterator[str]:
    """What lies some levels below a folder; a store may have a million of them."""
    with os.scandir(folder) as entries:
        visible = [entry for entry in entries if not entry.name.startswith(".")]
    for entry in visible:
        if levels == 1:
            yield entry.path
        elif entry.is_dir():  # mostly known from the listing itself
            yield from _below(entry.path, levels - 1)
