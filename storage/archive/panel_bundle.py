"""The bundle of an assembled panel: what one run of its assembly left, as immutable as a scene's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from metrology.assembly.carried import Names
from metrology.assembly.result import PanelResult
from metrology.assembly.rows import VerdictRow
from metrology.assembly.verdict import Judgement
from metrology.kinds import KINDS, counted
from metrology.results import PanelKey
from storage.archive.bundle import PANEL_FORMAT, as_tables, document_hash, seal
from storage.archive.schema import (
    PANEL_CHANGES,
    PANEL_COVERAGE,
    PANEL_DIFFERENCES,
    PANEL_FINDINGS,
    PANEL_OF_KIND,
    PANEL_RULES,
    PANEL_STATIONS,
    PANEL_TABLES,
    PANEL_VERDICTS,
    PANELS,
)
from storage.documents import utc_text
from storage.panel_picture import PICTURES, encoded

Row = dict[str, Any]
REMEMBERED, SIDES = "remembered", "sides"
"""Where a panel run's manifest has names of earlier assemblies, and the sides of courses."""


@dataclass(frozen=True)
class PanelDocument:
    """A panel as it is stored."""

    key: PanelKey
    captured_at: datetime
    """When the newest of its scans was taken."""
    rows: Mapping[str, Sequence[Row]]
    """Of every table, without what only the run knows."""
    panel_spec: Mapping[str, Any]
    """The specification that it was judged by."""
    scenes: Mapping[str, str]
    """The run of each scan that went in."""
    warnings: tuple[str, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict)
    remembered: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Names of earlier assemblies that nothing in this one has, by kind: part, places and side."""
    sides: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Where side B of each course lies, by kind and name."""
    pictures: Sequence[Mapping[str, Any]] = ()
    """What the manifest says of the stitched pictures."""
    files: Mapping[str, bytes] = field(default_factory=dict)
    """Their files."""


def write_panel_bundle(
    folder: Path, run_id: str, final_path: str, document: PanelDocument, review_head: str | None = None
) -> None:
    """Write and sync a panel run's files into an empty folder; manifest.json comes last."""
    [panel] = document.rows[PANELS.name]
    run = {"run_id": run_id, "processed_at": datetime.now(UTC), "bundle_path": final_path}
    tables = as_tables(PANEL_TABLES, {**document.rows, PANELS.name: [panel | run]})
    for name, table in tables.items():
        pq.write_table(table, folder / f"{name}.parquet", compression="zstd")
    for name, content in document.files.items():
        (folder / name).write_bytes(content)
    manifest = {
        "format": PANEL_FORMAT,
        "run_id": run_id,
        "aircraft_serial": document.key.aircraft_serial,
        "panel": document.key.panel,
        "captured_at": utc_text(document.captured_at),
        "scene_id": document.key.panel_id,
        "config_hash": document_hash({"panel_spec": document.panel_spec, "scenes": document.scenes}),
        "review_head": review_head,
        "panel_spec": document.panel_spec,
        "scenes": document.scenes,
        "versions": document.versions,
        "warnings": list(document.warnings),
        REMEMBERED: document.remembered,
        SIDES: document.sides,
        PICTURES: list(document.pictures),
        "rows": {name: table.num_rows for name, table in tables.items()},
    }
    seal(folder, manifest)


def panel_document(result: PanelResult, earlier: Sequence[Row] = ()) -> PanelDocument:
    """An assembled panel as it is stored.

    Parameters
    ----------
    earlier : sequence of mapping
        The panel's rows of `panel_verdicts` so far; they stay.
    """
    scenes = {key.scene_id: run for key, run in result.runs.items()}
    files, pictures = encoded(result.pictures)
    return PanelDocument(
        result.key, result.captured_at, _panel_rows(result, earlier), result.panel_spec, scenes, result.warnings,
        result.versions, _remembered(result.remembered), result.sides, pictures, files,
    )  # fmt: skip


def _remembered(names: Names) -> dict[str, dict[str, Any]]:
    return {
        kind: {
            name: {"part": known.part, "places": known.places.tolist(), "side": known.side}
            for name, known in of_kind.items()
        }
        for kind, of_kind in names.items()
    }


def key_columns(key: PanelKey, captured_at: datetime) -> Row:
    """What every row of a panel has."""
    return {**asdict(key), "captured_at": captured_at, "scene_id": key.panel_id, "station": None}


def _panel_rows(result: PanelResult, earlier: Sequence[Row]) -> dict[str, Sequence[Row]]:
    key = key_columns(result.key, result.captured_at)
    rows: dict[str, Sequence[Row]] = {PANELS.name: [key | _panel_row(result)]}
    for kind in KINDS:
        names = {column.name for column in PANEL_OF_KIND[kind.name].columns}
        found = zip(result.features[kind.name], result.feature_columns(kind.name), strict=True)
        rows[PANEL_OF_KIND[kind.name].name] = [key | _of_feature(feature.row, names) | more for feature, more in found]
    rows[PANEL_STATIONS.name] = [key | plain_row(row) for row in result.station_rows()]
    rows[PANEL_DIFFERENCES.name] = [key | plain_row(row) for row in result.difference_rows()]
    rows[PANEL_CHANGES.name] = []
    rows[PANEL_COVERAGE.name] = [key | plain_row(row) for row in result.coverage.rows]
    return rows | judgement_rows(key, result.judgement, result.spec_name, earlier)


def judgement_rows(key: Row, judged: Judgement, spec: str, earlier: Sequence[Row]) -> dict[str, Sequence[Row]]:
    """The rows of a judgement; the verdicts before it stay beside it."""
    verdict = VerdictRow(datetime.now(UTC), spec, judged.verdict, judged.reason)
    return {
        PANEL_RULES.name: [key | plain_row(row) for row in judged.rules],
        PANEL_FINDINGS.name: [key | plain_row(row) for row in judged.findings],
        PANEL_VERDICTS.name: [*({**row, **key} for row in earlier), key | plain_row(verdict)],
    }


def _of_feature(row: Any, names: set[str]) -> Row:
    return {name: getattr(row, name) for name in names if hasattr(row, name)}


def plain_row(row: Any) -> Row:
    """A row's dataclass as a mapping."""
    return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(row).items()}


def _panel_row(result: PanelResult) -> Row:
    stations, differences = result.station_rows(), result.difference_rows()
    states = [row.state for row in result.coverage.rows]
    return {
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
        **counted({name: [feature.row for feature in found] for name, found in result.features.items()}),
    }
