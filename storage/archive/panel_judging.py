"""An assembled panel judged again by another specification: from its stored values, nothing is measured anew."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from metrology.assembly.coverage import gaps_said
from metrology.assembly.verdict import judgement
from metrology.errors import StoreError
from metrology.kinds import KINDS, RIVET, Kind
from metrology.panel import PanelLayout
from metrology.results import Feature, PanelKey
from metrology.tolerance import as_measured, judge
from storage.archive.bundle import MANIFEST
from storage.archive.panel_bundle import REMEMBERED, SIDES, PanelDocument, judgement_rows, key_columns
from storage.archive.rows import result_of
from storage.archive.schema import (
    PANEL_COVERAGE,
    PANEL_OF_KIND,
    PANEL_TABLES,
    PANEL_VERDICTS,
    PANELS,
)
from storage.archive.store import Store
from storage.documents import read_json
from storage.panel_picture import PICTURES, listed_files
from storage.panel_spec import PanelSpecification

Row = dict[str, Any]


def stored_rows(store: Store, key: PanelKey, table: str) -> list[Row]:
    """A panel's rows of a table."""
    rows: list[Row] = store.query(f"FROM {table} WHERE scene_id = ?", [key.panel_id]).to_pylist()
    return rows


def judged_again(store: Store, key: PanelKey, spec: PanelSpecification) -> PanelDocument:
    """A stored panel under another specification; its former verdicts stay in `panel_verdicts`."""
    rows: dict[str, Sequence[Row]] = {table.name: stored_rows(store, key, table.name) for table in PANEL_TABLES}
    if not rows[PANELS.name]:
        raise StoreError(
            f"{store.root}: found no assembled panel {key}, expected one: 'flushline panel assemble' first"
        )
    [panel] = rows[PANELS.name]
    _refuse_other_pattern(key, rows[PANEL_COVERAGE.name], spec)
    features: dict[str, Sequence[Feature]] = {}
    for kind in KINDS:
        table = PANEL_OF_KIND[kind.name].name
        judged = judge(kind, [measured_row(kind, row, spec) for row in rows[table]], spec.limits)
        features[kind.name] = judged
        rows[table] = [_with(row, feature) for row, feature in zip(rows[table], judged, strict=True)]
    gaps = gaps_said([(row["feature_id"], row["state"]) for row in rows[PANEL_COVERAGE.name]])
    gaps += [f"in {panel['n_parts']} parts"] if panel["n_parts"] > 1 else []
    gaps += [f"{panel['n_left_out']} scans left out"] if panel["n_left_out"] else []
    result = judgement(features, spec.limits, spec.rules, spec.layout, panel["area_cm2"] * 100, gaps)
    warnings = [text for text in panel["warnings"] if not text.startswith("judged by")]
    panel |= {"warnings": warnings, "status": "warnings" if warnings else "ok"}
    panel |= {"verdict": result.verdict, "verdict_reason": result.reason, "panel_spec": str(spec)}
    columns = key_columns(key, panel["captured_at"])
    rows |= judgement_rows(columns, result, str(spec), rows[PANEL_VERDICTS.name])
    bundle = store.root / panel["bundle_path"]
    store.bundles.bring(bundle)
    manifest = read_json(bundle / MANIFEST, StoreError)
    pictures = manifest.get(PICTURES, [])
    files = {name: (bundle / name).read_bytes() for name in listed_files(pictures)}
    return PanelDocument(
        key, panel["captured_at"], rows, spec.document, manifest["scenes"], tuple(warnings),
        manifest["versions"], manifest.get(REMEMBERED, {}), manifest.get(SIDES, {}), pictures, files,
    )  # fmt: skip


def measured_row(kind: Kind, row: Mapping[str, Any], spec: PanelSpecification) -> Feature:
    """A stored feature, not judged, in the zone that the specification puts it in."""
    feature = as_measured(kind, result_of(kind.row_type, row))
    zone = _zone(kind, row, spec.layout)
    return replace(feature, zone=zone) if zone else feature


def _zone(kind: Kind, row: Mapping[str, Any], layout: PanelLayout) -> str | None:
    """The zone that the specification puts a feature in; None where it does not name it."""
    name = row[kind.id_columns[0]]
    if kind is RIVET:
        return next((rivet.zone for rivet in layout.rivets if rivet.rivet_id == name), None)
    if kind.is_course:
        return next((seam.zone_at(row[kind.id_columns[1]]) for seam in layout.seams if seam.seam_id == name), None)
    return None


def _with(row: Row, feature: Feature) -> Row:
    """A stored row with what a judgement may change."""
    changed = {name: getattr(feature, name) for name in ("zone", "severity", "decision", "reason")}
    values = {name: getattr(feature, name) for name in row if name not in changed and hasattr(feature, name)}
    return {**row, **values, **changed}


def _refuse_other_pattern(key: PanelKey, coverage: Sequence[Row], spec: PanelSpecification) -> None:
    had = {row["feature_id"].split("@")[0] for row in coverage}
    wanted = {rivet.rivet_id for rivet in spec.layout.rivets} | {seam.seam_id for seam in spec.layout.seams}
    if had != wanted:
        raise StoreError(
            f"{key}: found a pattern of {len(wanted)} features in {spec}, expected the {len(had)} that the panel was "
            "put together by: 'flushline panel assemble' puts it together by the new one"
        )
