"""What the report of an assembled panel is made of, fetched from a store."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from metrology.assembly.picture import Stitched
from metrology.errors import StoreError
from metrology.kinds import KINDS
from metrology.results import PanelKey
from metrology.tolerance import PanelSpec
from storage.archive import Store
from storage.archive.bundle import MANIFEST
from storage.archive.schema import (
    PANEL_CHANGES,
    PANEL_COVERAGE,
    PANEL_FINDINGS,
    PANEL_OF_KIND,
    PANEL_RULES,
    PANEL_STATIONS,
    PANEL_VERDICTS,
    PANELS,
)
from storage.archive.work import Standing, open_work, standings
from storage.documents import read_json
from storage.panel_picture import stored_pictures
from storage.panel_spec import judged_by, locations_of
from storage.review import Entry, ReviewLog

if TYPE_CHECKING:
    import duckdb

Row = Mapping[str, Any]


@dataclass(frozen=True)
class AssembledRecord:
    """An assembled panel."""

    panel: Row
    """Its row of the table panels."""
    of_kind: Mapping[str, tuple[Row, ...]]
    """Its rows of the tables of features, by the names of the kinds."""
    rules: tuple[Row, ...]
    findings: tuple[Row, ...]
    coverage: tuple[Row, ...]
    stations: tuple[Row, ...]
    verdicts: tuple[Row, ...]
    scenes: Mapping[str, Row]
    """The rows of `scenes` of the scans in it that the archive still has, by their ids."""
    newer: tuple[str, ...]
    """Stations of which there is another scan by now than the one in the panel."""
    limits: PanelSpec | None
    """That it was judged by; None where they cannot be read."""
    standings: Mapping[str, tuple[Standing, ...]] = field(default_factory=dict)
    """How the findings of each scan stand."""
    work: tuple[Entry, ...] = ()
    """Dispositions of its scans, earlier ones too, whose work is still open."""
    sign_offs: Mapping[str, Entry] = field(default_factory=dict)
    review_head: str = ""
    pictures: Mapping[int, Stitched] = field(default_factory=dict)
    """By the number of the part; none of runs of versions that made none."""
    locations: Mapping[str, str] = field(default_factory=dict)
    """Where features are on the aircraft, by their names."""
    changes: tuple[Row, ...] = ()
    """rules, findings, coverage, stations, verdicts, changes: its rows of these tables."""


def is_assembled(store: Store, key: PanelKey) -> bool:
    """Whether the archive has an assembly of a panel."""
    return bool(store.query(f"SELECT 1 FROM {PANELS.name} WHERE scene_id = ?", [key.panel_id]).num_rows)


def assembled_record(store: Store, key: PanelKey) -> AssembledRecord:
    """The newest assembly of a panel."""
    with contextlib.closing(store.connect()) as connection:
        return _record(connection, store, key)


def _record(connection: duckdb.DuckDBPyConnection, store: Store, key: PanelKey) -> AssembledRecord:
    def rows(table: str, *order: str) -> tuple[Row, ...]:
        by = f" ORDER BY {', '.join(order)}" if order else ""
        return _rows(connection, f"FROM {table} WHERE scene_id = ?{by}", key.panel_id)

    found = rows(PANELS.name)
    if not found:
        raise StoreError(
            f"{store.root}: found no assembled panel {key}, expected one: 'flushline panel assemble' first"
        )
    [panel] = found
    of_panel, names = "aircraft_serial = ? AND panel = ?", (key.aircraft_serial, key.panel)
    newest = _rows(connection, f"FROM latest_scenes WHERE {of_panel} ORDER BY station", *names)
    scans = _rows(connection, f"SELECT scene_id FROM scenes WHERE {of_panel}", *names)
    stations = rows(PANEL_STATIONS.name, "station")
    used = {row["station_scene_id"] for row in stations}
    bundle = store.root / panel["bundle_path"]
    store.bundles.bring(bundle, tables_only=True)
    manifest = bundle / MANIFEST
    document = read_json(manifest, StoreError)
    review = ReviewLog(store.root).of_scenes([str(row["scene_id"]) for row in scans])
    work = open_work(connection, review)
    return AssembledRecord(
        panel,
        {kind.name: rows(PANEL_OF_KIND[kind.name].name, *kind.id_columns) for kind in KINDS},
        rows(PANEL_RULES.name, "rule_id"),
        rows(PANEL_FINDINGS.name),
        rows(PANEL_COVERAGE.name, "feature_id"),
        stations,
        rows(PANEL_VERDICTS.name, "judged_at"),
        {row["scene_id"]: row for row in newest if row["scene_id"] in used},
        tuple(row["station"] for row in newest if row["scene_id"] not in used),
        judged_by(document, manifest),
        {scene: standings(connection, review, scene) for scene in sorted(used)},
        tuple({entry.number: entry for entry in work.values()}.values()),
        {scene: entry for scene, entry in review.sign_offs().items() if scene in used},
        str(ReviewLog(store.root).head()),
        stored_pictures(store.file, f"{panel['bundle_path']}/{MANIFEST}"),
        locations_of(document.get("panel_spec") or {}),
        rows(PANEL_CHANGES.name, "feature_kind", "feature_id", "change"),
    )  # fmt: skip


def _rows(connection: duckdb.DuckDBPyConnection, sql: str, *parameters: str) -> tuple[Row, ...]:
    return tuple(connection.sql(sql, params=list(parameters)).to_arrow_table().to_pylist())
