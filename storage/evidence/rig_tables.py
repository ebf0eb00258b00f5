"""Rigs and their verifications as tables for SQL: `rigs`, one row per calibration; `verifications`, one per measure."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import duckdb
    import pyarrow as pa

    from storage.archive.layout import Layout
    from storage.evidence.verifications import Verification

RIGS_COLUMNS = {
    "rig_id": "the calibration, as scenes name it",
    "rig_hash": "names the content of the rig file, as scenes have it",
    "calibrated_at": "last calibration (UTC)",
    "calibration_due_at": "when the rig is to be calibrated again; NULL where its capture does not say",
    "board_certificate": "certificate of the board that it was calibrated by",
    "board_due_at": "until when that certificate holds",
    "last_verified_at": "when the last verification's scans were taken (UTC); NULL where there is none",
    "last_verification": "its name, as verifications has it",
    "last_verdict": "its verdict",
    "verification_due_at": "when the next one is due",
    "artefact_due_at": "until when the certificate of its artefact holds",
}
VERIFICATIONS_COLUMNS = {
    "verification": "its name: rig, time, number",
    "rig_id": "the calibration",
    "rig_hash": "names the content of the rig file",
    "verified_at": "when its scans were taken (UTC)",
    "due_at": "when the next one is due",
    "artefact": "the artefact",
    "artefact_kind": "plane, spheres, rivet-plate, step-plate, gap-plate or board",
    "certificate": "number of the artefact's certificate",
    "operator": "who scanned",
    "measure": "what was measured",
    "of": "of what",
    "unit": "of value, u95, limit, measured and certified",
    "value": "deviation from the certified value, or error of form",
    "u95": "its expanded uncertainty (95 %)",
    "limit_value": "maximum permissible amount; NULL where nothing is asked",
    "measured": "mean of what was measured",
    "certified": "as the certificate has it",
    "decision": "after ISO 14253-1",
    "verdict": "of the whole verification",
}


def register_rigs(connection: duckdb.DuckDBPyConnection, root: Path, named: Collection[str]) -> None:
    """Make those of the tables that are named known to a connection."""
    from storage.archive.layout import Layout
    from storage.evidence.verifications import Verifications

    layout = Layout(root)
    known = Verifications(layout).all()
    if "rigs" in named:
        connection.register("rigs", rigs(layout, known))
    if "verifications" in named:
        connection.register("verifications", _table(VERIFICATIONS_COLUMNS, [r for v in known for r in _measures(v)]))


def rigs(layout: Layout, known: tuple[Verification, ...]) -> pa.Table:
    """Every calibration of a store, and such as were verified only."""
    from metrology.errors import RigError
    from storage.archive.bundle import document_hash
    from storage.documents import read_json
    from storage.evidence.rig_facts import rig_facts
    from storage.rig import rig_document, rig_from_document

    rows = {}
    for path in sorted(layout.rigs.glob("[!.]*.json")):
        document = rig_document(rig_from_document(read_json(path, RigError), path))
        facts = rig_facts(document)
        key = document["id"], document_hash(document)
        rows[key] = {
            "calibrated_at": facts.calibrated_at,
            "calibration_due_at": facts.due_at,
            "board_certificate": facts.certificate.number if facts.certificate else None,
            "board_due_at": facts.certificate.due_at if facts.certificate else None,
        }
    last = {(v.model.rig_id, v.model.rig_hash): v for v in sorted(known, key=_when)}
    return _table(
        RIGS_COLUMNS,
        [
            {"rig_id": key[0], "rig_hash": key[1], **rows.get(key, {}), **(_last(last[key]) if key in last else {})}
            for key in sorted({*rows, *last})
        ],
    )


def _when(verification: Verification) -> Any:
    return verification.model.verified_at, verification.model.processed_at


def _last(verification: Verification) -> dict[str, Any]:
    model = verification.model
    return {
        "last_verified_at": model.verified_at,
        "last_verification": verification.name,
        "last_verdict": model.verdict,
        "verification_due_at": model.due_at,
        "artefact_due_at": model.artefact.certificate.due_at if model.artefact.certificate else None,
    }


def _measures(verification: Verification) -> list[dict[str, Any]]:
    model = verification.model
    whole = {
        "verification": verification.name,
        "rig_id": model.rig_id,
        "rig_hash": model.rig_hash,
        "verified_at": model.verified_at,
        "due_at": model.due_at,
        "artefact": model.artefact.id,
        "artefact_kind": model.artefact.kind,
        "certificate": model.artefact.certificate.number if model.artefact.certificate else None,
        "operator": model.operator,
        "verdict": model.verdict,
    }
    return [
        whole | measure.model_dump(include={"of", "unit", "value", "u95", "measured", "certified", "decision"})
        | {"measure": measure.name, "limit_value": measure.limit}
        for measure in model.measures
    ]  # fmt: skip


def _table(columns: dict[str, str], rows: list[dict[str, Any]]) -> pa.Table:
    import pyarrow as pa

    def type_of(name: str) -> pa.DataType:
        if name.endswith("_at"):
            return pa.timestamp("us", "UTC")
        return pa.float64() if name in ("value", "u95", "limit_value", "measured", "certified") else pa.string()

    return pa.table({name: pa.array([row.get(name) for row in rows], type_of(name)) for name in columns})
