"""Events: what happened to scenes, panels, rigs and broken scans, as others are told of it (event.schema.json)."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

from storage.archive.store import Store
from storage.documents import utc_text
from storage.export.subject import Subject, panel_subject, scene_subject, stable_uuid

FORMAT = "flushline-event/1"
_IN_USE, _AHEAD = timedelta(days=30), timedelta(days=7)
_DUE = """
SELECT DISTINCT rig_id, what, due_at
FROM (
    SELECT rig_id, rig_hash, 'calibration' AS what, calibration_due_at AS due_at FROM rigs
    UNION ALL SELECT rig_id, rig_hash, 'verification', verification_due_at FROM rigs
) JOIN scenes USING (rig_id, rig_hash)
WHERE captured_at >= ? AND due_at <= ?
ORDER BY due_at, rig_id, what
"""


@dataclass(frozen=True)
class Event:
    """Something that happened."""

    type: str
    """One of the schema's types."""
    id: str
    """The same for the same event, however often it is looked for."""
    at: datetime
    data: dict[str, Any]
    """As the schema has it."""

    @property
    def document(self) -> str:
        """The event as JSON."""
        whole = {"format": FORMAT, "id": self.id, "type": self.type, "at": utc_text(self.at), "data": self.data}
        return json.dumps(whole, ensure_ascii=False, sort_keys=True)


def quarantined(folder: str, scene_id: str | None, reason: str) -> Event:
    """A broken scan that was put aside now."""
    data = {"folder": folder, "scene_id": scene_id, "reason": reason}
    now = datetime.now(UTC)
    return Event("scan.quarantined", str(stable_uuid("quarantined", folder, reason, utc_text(now))), now, data)


def runs_since(store: Store, since: datetime) -> dict[str, tuple[str, str, str]]:
    """Runs stored since a moment: scene, aircraft and panel by the id of the run, oldest first."""
    rows = store.query(
        "SELECT scene_id || '/' || run_id AS run, scene_id, aircraft_serial, panel FROM scenes WHERE processed_at >= ? "
        "ORDER BY processed_at, scene_id",
        [since],
    ).to_pylist()
    return {row["run"]: (row["scene_id"], row["aircraft_serial"], row["panel"]) for row in rows}


def rigs_due(store: Store, now: datetime) -> Iterator[Event]:
    """Rigs of scans of the last 30 days whose calibration or verification is due within a week."""
    if not store.layout.archive.exists():
        return
    for row in store.query(_DUE, [now - _IN_USE, now + _AHEAD]).to_pylist():
        due = utc_text(row["due_at"])
        data = {"rig_id": row["rig_id"], "due": row["what"], "due_at": due}
        yield Event("rig.due", _id("rig.due", row["rig_id"], row["what"], due), row["due_at"], data)


def events_of(store: Store, runs: dict[str, tuple[str, str, str]]) -> Iterator[Event]:
    """What follows from runs: each scene's verdict and doubts about its rig, and then each panel's verdict."""
    for scene_id, _, _ in runs.values():
        yield from _of_scene(scene_subject(store, scene_id))
    for aircraft, panel in dict.fromkeys(found[1:] for found in runs.values()):
        yield _of_panel(panel_subject(store, aircraft, panel))


def _of_scene(subject: Subject) -> Iterator[Event]:
    row = subject.scenes[0].row
    said = {name: row[name] for name in ("aircraft_serial", "panel", "station", "scene_id", "run_id", "rig_id")}
    said |= {"captured_at": utc_text(row["captured_at"]), "warnings": list(row["warnings"] or ())}
    verdict = said | {"decision": subject.decision, "counts": subject.counts}
    yield Event("scene.verdict", _id("scene.verdict", row["scene_id"], row["run_id"]), row["processed_at"], verdict)
    if row["rig_verdict"] == "warning":
        yield Event("rig.doubtful", _id("rig.doubtful", row["scene_id"], row["run_id"]), row["processed_at"], said)


def _of_panel(subject: Subject) -> Event:
    runs = [f"{scene.scene_id}/{scene.row['run_id']}" for scene in subject.scenes]
    data = {
        "aircraft_serial": subject.aircraft_serial,
        "panel": subject.panel,
        "runs": runs,
        "decision": subject.decision,
        "counts": subject.counts,
    }
    newest = max(scene.row["processed_at"] for scene in subject.scenes)
    return Event("panel.verdict", _id("panel.verdict", *runs), newest, data)


def _id(*parts: str) -> str:
    return str(stable_uuid(*parts))
