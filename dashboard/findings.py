"""Findings: rivets and seam stations of the newest scans, as the pages list them."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any

import pandas as pd

from dashboard.data import Archive
from dashboard.palette import DECISIONS, OPEN_DECISIONS
from storage.review import Feature, FeatureKind

MOST_ROWS = 500
LAST_NIGHT, LAST_WEEK = "last night", "last 7 days"
PERIODS: dict[str, timedelta | None] = {
    "any time": None,
    LAST_NIGHT: timedelta(hours=14),
    LAST_WEEK: timedelta(days=7),
    "last 30 days": timedelta(days=30),
}
STATES = ("open", "decided", "all")

STATION_ID = "seam_id || '@' || printf('%.1f', s_mm)"
_RANK = "CASE decision " + " ".join(f"WHEN '{name}' THEN {i}" for i, name in enumerate(DECISIONS)) + " ELSE 9 END"


@dataclass(frozen=True)
class Selection:
    """Which scenes are meant; empty means all.

    Attributes
    ----------
    aircraft, panels, stations, rigs : tuple of str
    since, until : datetime or None
        Of the scan.
    """

    aircraft: tuple[str, ...] = ()
    panels: tuple[str, ...] = ()
    stations: tuple[str, ...] = ()
    rigs: tuple[str, ...] = ()
    since: datetime | None = None
    until: datetime | None = None

    def where(self) -> tuple[str, list[Any]]:
        """A SQL condition on a table's key columns, and its parameters."""
        conditions, parameters = ["true"], list[Any]()
        for column, wanted in (
            ("aircraft_serial", self.aircraft),
            ("panel", self.panels),
            ("station", self.stations),
            ("rig_id", self.rigs),
        ):
            if wanted:
                conditions.append(f"{column} IN ({', '.join('?' * len(wanted))})")
                parameters += wanted
        for column, moment in (("captured_at >=", self.since), ("captured_at <=", self.until)):
            if moment is not None:
                conditions.append(f"{column} ?")
                parameters.append(moment)
        return " AND ".join(conditions), parameters


def start_of(period: str, newest: datetime | None) -> datetime | None:
    """When a period begins. It counts back from the newest scan, so that it is never empty after a quiet week."""
    span = PERIODS.get(period)
    return newest - span if span and newest is not None else None


@dataclass(frozen=True)
class Wanted:
    """Which findings of a selection are listed.

    Attributes
    ----------
    decisions : tuple of str
    kinds : tuple of "rivet", "seam station"
    state : "open", "decided" or "all"
        Open: neither disposed of nor signed off.
    """

    decisions: tuple[str, ...] = OPEN_DECISIONS
    kinds: tuple[FeatureKind, ...] = ("rivet", "seam station")
    state: str = "open"
    selection: Selection = field(default_factory=Selection)


def findings(archive: Archive, wanted: Wanted, most: int = MOST_ROWS) -> pd.DataFrame:
    """Findings, the gravest first, then by size; at most `most`.

    Columns: the key, feature_kind, feature_id, value_mm and u95_mm (height or step), tilt_deg, width_mm, severity,
    decision, reason, run_id, panel_spec, software_version, disposition, who, decided_at, signed_by.
    """
    sql, parameters = _query(wanted)
    return archive.rows_with_review(
        f"{sql} ORDER BY {_RANK}, severity = 'red' DESC NULLS LAST, abs(value_mm) DESC NULLS LAST, "
        f"scene_id, feature_id LIMIT {int(most)}",
        parameters,
    )


def count_findings(archive: Archive, wanted: Wanted) -> int:
    """How many there are."""
    sql, parameters = _query(wanted)
    return int(archive.rows_with_review(f"SELECT count(*) AS n FROM ({sql})", parameters)["n"][0])


def _query(wanted: Wanted) -> tuple[str, list[Any]]:
    condition, parameters = wanted.selection.where()
    decisions = list(wanted.decisions) or [""]
    marks = ", ".join("?" * len(decisions))
    key = "f.aircraft_serial, f.panel, f.station, f.captured_at, f.scene_id"
    parts = []
    if "rivet" in wanted.kinds:
        parts.append(
            f"SELECT {key}, 'rivet' AS feature_kind, rivet_id AS feature_id, height_mean_mm AS value_mm, "
            "height_u95_mm AS u95_mm, tilt_deg, NULL::DOUBLE AS width_mm, severity, decision, reason "
            f"FROM rivets f WHERE decision IN ({marks})"
        )
    if "seam station" in wanted.kinds:
        parts.append(
            f"SELECT {key}, 'seam station' AS feature_kind, {STATION_ID} AS feature_id, step_mm AS value_mm, "
            "step_u95_mm AS u95_mm, NULL::DOUBLE AS tilt_deg, width_mm, severity, decision, reason "
            f"FROM seam_stations f WHERE decision IN ({marks})"
        )
    if not parts:
        parts.append("SELECT * FROM (SELECT NULL) WHERE false")
    state = {
        "open": "WHERE d.disposition IS NULL AND g.signed_by IS NULL",
        "decided": "WHERE d.disposition IS NOT NULL OR g.signed_by IS NOT NULL",
    }.get(wanted.state, "")
    sql = (
        f"SELECT f.*, s.run_id, s.panel_spec, s.software_version, d.disposition, d.who, d.decided_at, g.signed_by "
        f"FROM ({' UNION ALL '.join(parts)}) f "
        "JOIN (SELECT scene_id, run_id, panel_spec, software_version FROM latest_scenes "
        f"WHERE {condition}) s USING (scene_id) "
        "LEFT JOIN reviewed d USING (scene_id, feature_kind, feature_id) LEFT JOIN signed g USING (scene_id) "
        f"{state}"
    )
    return sql, decisions * len([part for part in parts if "?" in part]) + parameters


def feature_of(row: Any) -> Feature:
    """The feature that a row of `findings` is about."""
    return Feature(row.feature_kind, str(row.feature_id))


def feature_parameter(feature: Feature) -> str:
    """A feature as the URL has it."""
    return f"{'rivet' if feature.kind == 'rivet' else 'station'}:{feature.id}"


def feature_from_parameter(text: str | None) -> Feature | None:
    """The feature that a URL names; None where it names none."""
    kind, _, name = (text or "").partition(":")
    if not name:
        return None
    return {"rivet": Feature("rivet", name), "station": Feature("seam station", name)}.get(kind)
