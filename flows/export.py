"""Exports: each scene or panel in each format, into a folder or onto object storage; files are whole or not there."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from metrology.errors import StoreError, UsageError
from storage.archive.files import disk_trouble
from storage.archive.remote import Remote
from storage.archive.store import Store
from storage.export.formats import FORMATS, Decimal, Format, Place, format_named, writer_of
from storage.export.subject import Subject, panel_subject, panels_of, scene_subject


@dataclass(frozen=True)
class Wanted:
    """What to export."""

    scene_id: str | None = None
    aircraft: str | None = None
    panel: str | None = None
    query: str | None = None
    """scene_id, aircraft, panel, query: A scene; an aircraft, or a panel of it; or the rows of a query."""

    def __post_init__(self) -> None:
        ways = [self.scene_id is not None, self.aircraft is not None, self.query is not None]
        if sum(ways) != 1 or (self.panel is not None and self.aircraft is None):
            raise UsageError("export: expected a SCENE_ID, --aircraft SERIAL (and --panel PANEL), or --query SQL")


def subjects(store: Store, wanted: Wanted) -> list[Callable[[], Subject]]:
    """The scene, or the panels, each read when it is asked for."""
    if wanted.scene_id is not None:
        scene_id = wanted.scene_id
        return [lambda: scene_subject(store, scene_id)]
    aircraft = wanted.aircraft or ""
    panels = [wanted.panel] if wanted.panel is not None else panels_of(store, aircraft)
    return [lambda panel=panel: panel_subject(store, aircraft, panel) for panel in panels]  # type: ignore[misc]


def formats_for(names: Sequence[str], wanted: Wanted) -> list[Format]:
    """The formats, refused where one takes no query or lacks its packages."""
    found = [format_named(name) for name in dict.fromkeys(names)]
    for each in found:
        if wanted.query is not None and not each.query:
            known = ", ".join(name for name, known in FORMATS.items() if known.query)
            raise UsageError(f"export: found a query for {each.name}, expected one of {known}")
    return found


def export_subject(subject: Subject, formats: Sequence[Format], store: Store, to: str, decimal: Decimal) -> list[str]:
    """Write a subject in each format; returns where the files lie."""
    with _delivered(to) as (folder, delivered):
        place = Place(folder, subject.name, store, decimal)
        for each in formats:
            writer_of(each.writer)(subject, place)
    return delivered


def export_query(sql: str, name: str, formats: Sequence[Format], store: Store, to: str, decimal: Decimal) -> list[str]:
    """Write the rows of a query in each format; returns where the files lie."""
    rows = store.query(sql)
    with _delivered(to) as (folder, delivered):
        for each in formats:
            writer_of(each.query)(rows, Place(folder, name, store, decimal))
    return delivered


@contextlib.contextmanager
def _delivered(to: str) -> Iterator[tuple[Path, list[str]]]:
    """A folder whose files go to `to` when all are written, and the list of where they then lie."""
    delivered: list[str] = []
    if "://" in to:
        with tempfile.TemporaryDirectory(prefix="flushline-export-") as temporary:
            yield Path(temporary), delivered
            files = sorted(Path(temporary).iterdir())
            try:
                Remote(to).copy_files(files, ".")
            except OSError as problem:
                said = " ".join(str(problem).split())
                raise StoreError(f"{to}: found {said}, expected a place that can be written") from None
            delivered += [f"{to.rstrip('/')}/{path.name}" for path in files]
        return
    folder = Path(to)
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder}: found a file, expected a folder")
    with disk_trouble(folder, "no file was written"):
        folder.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=".partial-", dir=folder))
        try:
            yield partial, delivered
            for path in sorted(partial.iterdir()):
                path.replace(folder / path.name)
                delivered.append(str(folder / path.name))
        finally:
            shutil.rmtree(partial, ignore_errors=True)
