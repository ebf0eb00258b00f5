"""What the report of an assembled panel is made of, fetched from a store."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from metrology.errors import StoreError
from metrology.kinds import KINDS
from metrology.results import PanelKey
from metrology.tolerance import PanelSpec
from storage.archive import Store
from storage.archive.bundle import MANIFEST
from storage.archive.schema import (
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
from storage.panel_spec import judged_by
from storage.review import Entry, ReviewLog

Row = Mapping[str, Any]


@dataclass(frozen=True)
class AssembledRecord:
    """An assembled panel.

    Attributes
    ----------
    panel : mapping
        Its row of the table panels.
    of_kind : mapping
        Its rows of the tables of features, by the names of the kinds.
    rules, findings, coverage, stations, verdicts : tuple of mapping
        Its rows of these tables.
    scenes : mapping of str to mapping
        The rows of `scenes` of the scans in it that the archive still has, by their ids.
    newer : tuple of str
        Stations of which there is another scan by now than the one in the panel.
    limits : PanelSpec or None
        That it was judged by; None where they cannot be read.
    standings : mapping of str to tuple of Standing
        How the findings of each scan stand.
    work : tuple of Entry
        Dispositions of its scans, earlier ones too, whose work is still open.
    sign_offs : mapping of str to Entry
    review_head : str
    """

    panel: Row
    of_kind: Mapping[str, tuple[Row, ...]]
    rules: tuple[Row, ...]
    findings: tuple[Row, ...]
    coverage: tuple[Row, ...]
    stations: tuple[Row, ...]
    verdicts: tuple[Row, ...]
    scenes: Mapping[str, Row]
    newer: tuple[str, ...]
    limits: PanelSpec | None
    standings: Mapping[str, tuple[Standing, ...]] = field(default_factory=dict)
    work: tuple[Entry, ...] = ()
    sign_offs: Mapping[str, Entry] = field(default_factory=dict)
    review_head: str = ""


def is_assembled(store: Store, key: PanelKey) -> bool:
    """Whether the archive has an assembly of a panel."""
    return bool(store.query(f"SELECT 1 FROM {PANELS.name} WHERE scene_id = ?", [key.panel_id]).num_rows)


def assembled_record(store: Store, key: PanelKey) -> AssembledRecord:
    """The newest assembly of a panel."""
    found = _rows(store, PANELS.name, key)
    if not found:
        raise StoreError(
            f"{store.root}: found no assembled panel {key}, expected one: 'flushline panel assemble' first"
        )
    [panel] = found
    newest: list[Row] = store.query(
        "SELECT * FROM latest_scenes WHERE aircraft_serial = ? AND panel = ? ORDER BY station",
        [key.aircraft_serial, key.panel],
    ).to_pylist()
    stations = _rows(store, PANEL_STATIONS.name, key, "station")
    used = {row["station_scene_id"] for row in stations}
    bundle = store.root / panel["bundle_path"]
    store.bundles.bring(bundle, tables_only=True)
    manifest = bundle / MANIFEST
    review = ReviewLog(store.root).of_scenes(_scans(store, key))
    with contextlib.closing(store.connect()) as connection:
        how_they_stand = {scene: standings(connection, review, scene) for scene in sorted(used)}
        work = open_work(connection, review)
    return AssembledRecord(
        panel,
        {kind.name: _rows(store, PANEL_OF_KIND[kind.name].name, key, *kind.id_columns) for kind in KINDS},
        *(
            _rows(store, table.name, key, *order)
            for table, order in (
                (PANEL_RULES, ("rule_id",)), (PANEL_FINDINGS, ()), (PANEL_COVERAGE, ("feature_id",)),
            )
        ),
        stations,
        _rows(store, PANEL_VERDICTS.name, key, "judged_at"),
        {row["scene_id"]: row for row in newest if row["scene_id"] in used},
        tuple(row["station"] for row in newest if row["scene_id"] not in used),
        judged_by(read_json(manifest, StoreError), manifest),
        how_they_stand,
        tuple({entry.number: entry for entry in work.values()}.values()),
        {scene: entry for scene, entry in review.sign_offs().items() if scene in used},
        str(ReviewLog(store.root).head()),
    )  # fmt: skip


def _scans(store: Store, key: PanelKey) -> list[str]:
    rows = store.query(
        "SELECT scene_id FROM scenes WHERE aircraft_serial = ? AND panel = ?", [key.aircraft_serial, key.panel]
    )
    return [str(value) for value in rows.column(0).to_pylist()]


def _rows(store: Store, table: str, key: PanelKey, *order: str) -> tuple[Row, ...]:
    by = f" ORDER BY {', '.join(order)}" if order else ""
    return tuple(store.query(f"FROM {table} WHERE scene_id = ?{by}", [key.panel_id]).to_pylist())
