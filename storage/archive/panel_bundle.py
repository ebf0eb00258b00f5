"""The bundle of an assembled panel: what one run of its assembly left, as immutable as a scene's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from metrology.assembly.result import PanelResult
from metrology.kinds import KINDS, Count, Kind
from storage.archive.bundle import PANEL_FORMAT, as_tables, document_hash, seal
from storage.archive.schema import (
    PANEL_COVERAGE,
    PANEL_DIFFERENCES,
    PANEL_FINDINGS,
    PANEL_OF_KIND,
    PANEL_RULES,
    PANEL_STATIONS,
    PANEL_TABLES,
    PANELS,
)
from storage.documents import utc_text

Row = dict[str, Any]


def write_panel_bundle(
    folder: Path, run_id: str, final_path: str, result: PanelResult, review_head: str | None = None
) -> None:
    """Write and sync a panel run's files into an empty folder; manifest.json comes last."""
    tables = as_tables(PANEL_TABLES, panel_rows(result, run_id, final_path))
    for name, table in tables.items():
        pq.write_table(table, folder / f"{name}.parquet", compression="zstd")
    scenes = {key.scene_id: run for key, run in result.runs.items()}
    manifest = {
        "format": PANEL_FORMAT,
        "run_id": run_id,
        "aircraft_serial": result.key.aircraft_serial,
        "panel": result.key.panel,
        "captured_at": utc_text(result.captured_at),
        "scene_id": result.key.panel_id,
        "config_hash": document_hash({"panel_spec": result.panel_spec, "scenes": scenes}),
        "review_head": review_head,
        "panel_spec": result.panel_spec,
        "scenes": scenes,
        "versions": result.versions,
        "warnings": list(result.warnings),
        "rows": {name: table.num_rows for name, table in tables.items()},
    }
    seal(folder, manifest)


def panel_rows(result: PanelResult, run_id: str, bundle_path: str) -> dict[str, Sequence[Row]]:
    """A panel's rows of every table."""
    key: Row = {
        **asdict(result.key),
        "captured_at": result.captured_at,
        "scene_id": result.key.panel_id,
        "station": None,
    }
    rows: dict[str, Sequence[Row]] = {PANELS.name: [key | _panel_row(result, run_id, bundle_path)]}
    for kind in KINDS:
        names = {column.name for column in PANEL_OF_KIND[kind.name].columns}
        found = zip(result.features[kind.name], result.feature_columns(kind.name), strict=True)
        rows[PANEL_OF_KIND[kind.name].name] = [key | _of_feature(feature.row, names) | more for feature, more in found]
    rows[PANEL_STATIONS.name] = [key | _plain_row(row) for row in result.station_rows()]
    rows[PANEL_DIFFERENCES.name] = [key | _plain_row(row) for row in result.difference_rows()]
    rows[PANEL_COVERAGE.name] = [key | _plain_row(row) for row in result.coverage.rows]
    rows[PANEL_RULES.name] = [key | _plain_row(row) for row in result.judgement.rules]
    rows[PANEL_FINDINGS.name] = [key | _plain_row(row) for row in result.judgement.findings]
    return rows


def _of_feature(row: Any, names: set[str]) -> Row:
    return {name: getattr(row, name) for name in names if hasattr(row, name)}


def _plain_row(row: Any) -> Row:
    return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(row).items()}


def _panel_row(result: PanelResult, run_id: str, bundle_path: str) -> Row:
    stations, differences = result.station_rows(), result.difference_rows()
    states = [row.state for row in result.coverage.rows]
    return {
        "run_id": run_id,
        "processed_at": datetime.now(UTC),
        "software_version": result.versions.get("flushline"),
        "panel_spec": result.spec_name,
        "status": "warnings" if result.warnings else "ok",
        "warnings": list(result.warnings),
        "n_scenes": sum(row.part is not None for row in stations),
        "n_left_out": sum(row.part is None for row in stations),
        "n_parts": len(result.assembly.parts),
        "scenes": [row.station_scene_id for row in stations if row.part is not None],
        "place_u95_mm": max((row.place_u95_mm for row in stations if row.place_u95_mm is not None), default=None),
        "n_repeated": len(differences),
        "n_beyond": sum(row.beyond for row in differences),
        "verdict": result.judgement.verdict,
        "verdict_reason": result.judgement.reason,
        "area_cm2": result.coverage.area_mm2 / 100,
        "n_expected": len(states) or None,
        "n_not_measured": states.count("not measured") if states else None,
        "n_not_seen": states.count("not seen") if states else None,
        "next_station": result.coverage.next_station,
        **{count.column: _counted(kind, count, result) for kind in KINDS for count in kind.counts},
        "bundle_path": bundle_path,
    }


def _counted(kind: Kind, count: Count, result: PanelResult) -> int:
    rows = [feature.row for feature in result.features[kind.name]]
    if count.of == "names":
        return len(kind.names(rows))
    return len(rows) if count.of == "rows" else sum(row.is_found for row in rows)
