"""Findings: rivets and seam stations of the newest scans, as the pages list them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from typing import Any

import pandas as pd

from dashboard.data import Archive
from dashboard.palette import OPEN_DECISIONS
from storage.archive.views import RANK_SQL
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
_PARTS = {
    "rivet": (
        "rivets",
        "rivet_id AS feature_id, height_mean_mm AS value_mm, height_u95_mm AS u95_mm, tilt_deg, "
        "NULL::DOUBLE AS width_mm",
    ),
    "seam station": (
        "seam_stations",
        f"{STATION_ID} AS feature_id, step_mm AS value_mm, step_u95_mm AS u95_mm, NULL::DOUBLE AS tilt_deg, width_mm",
    ),
}
_ORDER = f"{RANK_SQL}, severity = 'red' DESC NULLS LAST, abs(value_mm) DESC NULLS LAST, scene_id, feature_id"


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
    decision, reason, run_id, panel_spec, software_version, disposition, who, decided_at, signed_by, and total: how many
    there are without the limit.
    """
    candidates, parameters = _candidates(wanted)
    return archive.rows_with_review(
        f"WITH c AS MATERIALIZED ({candidates}), top AS (SELECT * FROM c ORDER BY {_ORDER} LIMIT {int(most)}) "
        "SELECT top.*, s.run_id, s.panel_spec, s.software_version, (SELECT count(*) FROM c) AS total "
        f"FROM top JOIN scenes s USING (scene_id) ORDER BY {_ORDER}",
        parameters,
    )


def _candidates(wanted: Wanted) -> tuple[str, list[Any]]:
    """All findings that are wanted."""
    condition, selected = wanted.selection.where()
    decisions = list(wanted.decisions) or [""]
    bad = f"decision IN ({', '.join('?' * len(decisions))})"
    # The selection stands in both tables: in this one it lets DuckDB pass over most rows.
    near, near_selected = replace(wanted.selection, rigs=()).where()
    key = "aircraft_serial, panel, station, captured_at, scene_id"
    parts = [
        f"SELECT {key}, '{kind}' AS feature_kind, {columns}, severity, decision, reason FROM {table} "
        f"WHERE {bad} AND {near}"
        for kind, (table, columns) in _PARTS.items()
        if kind in wanted.kinds
    ] or [
        f"SELECT {key}, 'rivet' AS feature_kind, {_PARTS['rivet'][1]}, severity, decision, reason FROM rivets LIMIT 0"
    ]
    state = {
        "open": "WHERE d.disposition IS NULL AND g.signed_by IS NULL",
        "decided": "WHERE d.disposition IS NOT NULL OR g.signed_by IS NOT NULL",
    }.get(wanted.state, "")
    sql = (
        f"SELECT f.*, d.disposition, d.who, d.decided_at, g.signed_by FROM ({' UNION ALL '.join(parts)}) f "
        f"SEMI JOIN (SELECT scene_id FROM latest_scenes WHERE {condition}) s USING (scene_id) "
        "LEFT JOIN reviewed d USING (scene_id, feature_kind, feature_id) LEFT JOIN signed g USING (scene_id) "
        f"{state}"
    )
    return sql, [*(decisions + near_selected) * (len(wanted.kinds)), *selected]


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
