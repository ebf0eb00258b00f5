"""What changed between assemblies of a panel, from the runs that the store has of it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from metrology.assembly.changes import Snapshot, changes
from metrology.assembly.rows import ChangeRow
from metrology.assembly.verdict import findings
from metrology.errors import SpecError, StoreError
from metrology.kinds import KINDS
from metrology.results import PanelKey
from metrology.tolerance import judge
from storage.archive.bundle import MANIFEST
from storage.archive.panel_bundle import PanelDocument, key_columns, plain_row
from storage.archive.panel_history import frames_of
from storage.archive.panel_judging import measured_row
from storage.archive.schema import PANEL_CHANGES, PANEL_OF_KIND, PANEL_STATIONS
from storage.archive.store import Store
from storage.documents import read_json
from storage.panel_picture import PICTURES, read_pictures
from storage.panel_spec import PanelSpecification, panel_spec_from

Row = Mapping[str, Any]
_SHIFT = timedelta(hours=4)  # scans farther apart are of different shifts


@dataclass(frozen=True)
class PanelRun:
    """A run of a panel's assembly, or one in the making."""

    run_id: str
    captured_at: datetime
    scenes: frozenset[str]
    manifest: Row
    rows: Callable[[str], Sequence[Row]]
    """The rows of a table."""
    read: Callable[[str], bytes]
    """The content of one of its files."""

    @property
    def spec(self) -> PanelSpecification:
        """What it was judged by."""
        return panel_spec_from(self.manifest["panel_spec"], Path(self.run_id))


def runs_of_panel(store: Store, key: PanelKey) -> list[PanelRun]:
    """The newest run of each set of scans that was put together, the oldest first."""
    found: dict[frozenset[str], PanelRun] = {}
    for run in store.bundles.runs_of(store.layout.scene_folder(key.panel_id)):
        each = _stored(store, run)
        found.pop(each.scenes, None)
        found[each.scenes] = each
    return sorted(found.values(), key=lambda run: (run.captured_at, run.run_id))


def earlier_shifts(now: PanelRun, runs: Sequence[PanelRun]) -> list[PanelRun]:
    """Runs of other scans before one, the newest of each shift, oldest first.

    Stations that are put together as they come leave many runs a shift, which differ by a station or two. Where all
    runs are of one shift, these are all there is to compare with.
    """
    earlier = [run for run in runs if run.scenes != now.scenes and run.captured_at <= now.captured_at]
    kept = [now]
    for run in reversed(earlier):
        if kept[-1].captured_at - run.captured_at >= _SHIFT:
            kept.append(run)
    return kept[:0:-1] or earlier


def _stored(store: Store, run: Path) -> PanelRun:
    store.bundles.bring_file(run / MANIFEST)
    manifest = read_json(run / MANIFEST, StoreError)

    def content(name: str) -> Path:
        store.bundles.bring_file(run / name)
        return run / name

    def rows(table: str) -> Sequence[Row]:
        found: Sequence[Row] = (
            pq.read_table(content(f"{table}.parquet")).to_pylist() if table in manifest["rows"] else []
        )
        return found

    at = datetime.fromisoformat(manifest["captured_at"]).astimezone(UTC)
    return PanelRun(
        run.name, at, frozenset(manifest["scenes"]), manifest, rows, lambda name: content(name).read_bytes()
    )


def with_changes(store: Store, document: PanelDocument) -> PanelDocument:
    """A panel as it is to be stored, compared with the last assembly of an earlier shift."""
    manifest = {"panel_spec": document.panel_spec, PICTURES: document.pictures}
    now = PanelRun(
        "", document.captured_at, frozenset(document.scenes), manifest, document.rows.__getitem__,
        document.files.__getitem__,
    )  # fmt: skip
    found = _compared_with_last(now, earlier_shifts(now, runs_of_panel(store, document.key)))
    key = key_columns(document.key, document.captured_at)
    return replace(document, rows={**document.rows, PANEL_CHANGES.name: [key | plain_row(row) for row in found]})


def _compared_with_last(now: PanelRun, earlier: Sequence[PanelRun]) -> list[ChangeRow]:
    """Against the last one that can be read: a damaged one is no reason not to store what is new."""
    for before in reversed(earlier):
        with contextlib.suppress(StoreError, SpecError, OSError, pa.ArrowException):
            return compared(now, before)
    return []


def compared(now: PanelRun, before: PanelRun) -> list[ChangeRow]:
    """What became of the findings of one run in a later one, both judged by the later one's limits."""
    spec = now.spec
    found = changes(_snapshot(now, spec), _snapshot(before, spec), spec.limits)
    return [replace(row, before_run_id=before.run_id, before_captured_at=before.captured_at) for row in found]


def _snapshot(run: PanelRun, spec: PanelSpecification) -> Snapshot:
    frames = frames_of(run.rows(PANEL_STATIONS.name), run.manifest)
    features, judged = {}, {}
    for kind in KINDS:
        rows = run.rows(PANEL_OF_KIND[kind.name].name)
        judged[kind.name] = judge(kind, [measured_row(kind, row, spec) for row in rows], spec.limits)
        features[kind.name] = list(zip([row["part"] for row in rows], judged[kind.name], strict=True))
    pictures = cache(lambda: read_pictures(run.manifest.get(PICTURES) or [], run.read))  # few questions need them

    def shows(frame: str, x: float, y: float) -> bool:
        return any(frames.get(part) == frame and picture.shows(x, y) for part, picture in pictures().items())

    return Snapshot(frames, features, findings(judged, spec.limits), shows)
