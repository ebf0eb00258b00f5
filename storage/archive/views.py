"""Views that people ask for; they live in the index beside the tables."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import timedelta

from metrology.kinds import KINDS, Kind
from metrology.verdicts import DECISIONS, IN_ORDER, OUTSIDE, gravity

# A scan cannot be newer than the moment it was first stored; a camera's clock may be a little ahead.
CLOCK_SLACK = timedelta(minutes=5)
AHEAD = f"(captured_at > coalesce(first_stored_at, processed_at) + INTERVAL {int(CLOCK_SLACK.total_seconds())} SECOND)"
"""Whether a scan claims to have been taken after it was stored: its camera's clock was wrong."""
TAKEN_AT = f"CASE WHEN {AHEAD} THEN coalesce(first_stored_at, processed_at) ELSE captured_at END"
"""When a scan was taken, at the latest: where its time lies ahead, when it was first stored."""
NEWEST_FIRST = f"{AHEAD}, captured_at DESC"
"""The order in which scans are looked for: one whose time lies ahead counts only where there is no other."""
NEWEST_TIME = f"coalesce(max(captured_at) FILTER (NOT {AHEAD}), max(captured_at))"
"""When the newest scan was taken, by the same rule."""

KEY = "aircraft_serial, panel, station, captured_at, scene_id"


def _one_of(decisions: Iterable[str]) -> str:
    return f"decision IN ({', '.join(map(repr, decisions))})"


RANK_SQL = f"CASE decision {' '.join(f'WHEN {d!r} THEN {gravity(d)}' for d in DECISIONS)} ELSE {len(DECISIONS)} END"
"""Rank of a row's decision, from grave to harmless."""
OUTSIDE_SQL = _one_of(OUTSIDE)
"""Whether a row's value lies beyond a limit."""
_IN_ORDER_SQL = _one_of(IN_ORDER)


@dataclass(frozen=True)
class View:
    """A view, its meaning and its query."""

    name: str
    comment: str
    query: str

    @property
    def create_sql(self) -> str:
        """CREATE OR REPLACE VIEW with its comment."""
        comment = self.comment.replace("'", "''")
        return f"CREATE OR REPLACE VIEW {self.name} AS {self.query};\nCOMMENT ON VIEW {self.name} IS '{comment}'"


def _latest(kind: Kind) -> View:
    return View(
        f"latest_{kind.table}",
        f"The {kind.many} of the newest scan of each station",
        f"SELECT {kind.table}.* FROM {kind.table} SEMI JOIN latest_scenes USING (scene_id)",
    )


def _worst(kind: Kind) -> View:
    values = [column for quantity in kind.quantities for column in (quantity.column, quantity.u95_column)]
    first = kind.quantities[0]
    return View(
        f"worst_{kind.table}",
        f"{kind.many.capitalize()} of the newest scans that do not pass, the gravest first, then by {first.name}",
        f"SELECT {', '.join([KEY, *kind.id_columns, *values])}, severity, decision, reason, u_px, v_px "
        f"FROM latest_{kind.table} WHERE NOT {_IN_ORDER_SQL} "
        f"ORDER BY {RANK_SQL}, abs({first.column}) DESC NULLS LAST",
    )


def _along(kind: Kind) -> View:
    """What is measured at positions along something, summed up for each of these."""
    name, position = kind.id_columns
    counted = next(count.column for count in kind.counts if count.of == "rows")
    columns = [f"count(*) AS {counted}", f"max({position}) AS length_mm"]
    for quantity in kind.quantities:
        value, (stem, _, unit) = quantity.column, quantity.column.rpartition("_")
        columns += [
            f"{f}({value}) AS {stem}_{said}_{unit}" for f, said in (("min", "min"), ("max", "max"), ("avg", "mean"))
        ]
        columns += [f"quantile_cont(abs({value}), 0.95) AS {stem}_abs_p95_{unit}"] if quantity.signed else []
    columns += [f"count(*) FILTER (decision = '{d}') AS n_{d.replace(' ', '_')}" for d in ("fail", "not measured")]
    return View(
        f"{kind.subject}_summary",
        f"One row per {kind.subject} of each scene: {' and '.join(q.name for q in kind.quantities)} over its length",
        f"SELECT {KEY}, {name}, {', '.join(columns)} FROM {kind.table} GROUP BY {KEY}, {name}",
    )


def _of_panel(kind: Kind) -> str:
    """One row per panel of each aircraft with the numbers of a kind."""
    counted = f"count(*) AS n_{kind.table}", f"count(*) FILTER ({OUTSIDE_SQL}) AS n_{kind.table}_failing"
    columns = ", ".join((*counted, *kind.per_panel))
    return f"of_{kind.table} AS (SELECT aircraft_serial, panel, {columns} FROM latest_{kind.table} GROUP BY ALL)"


_PANEL_SUMMARY = View(
    "panel_summary",
    "One row per panel of each aircraft, from the newest scan of each of its stations",
    f"WITH s AS (SELECT aircraft_serial, panel, count(*) AS n_scenes, {NEWEST_TIME} AS last_captured_at, "
    "count(*) FILTER (status <> 'ok') AS n_scenes_with_warnings, "
    "count(*) FILTER (rig_verdict = 'unjudged') AS n_scenes_rig_unjudged FROM latest_scenes GROUP BY ALL), "
    f"{', '.join(_of_panel(kind) for kind in KINDS)} SELECT * FROM s "
    + " ".join(f"LEFT JOIN of_{kind.table} USING (aircraft_serial, panel)" for kind in KINDS),
)


VIEWS = (
    View(
        "latest_scenes",
        "The newest scan of each station of each panel; one whose time lies ahead only where there is no other",
        "SELECT * FROM scenes QUALIFY row_number() OVER "
        f"(PARTITION BY aircraft_serial, panel, station ORDER BY {NEWEST_FIRST}) = 1",
    ),
    *(_latest(kind) for kind in KINDS),
    *(_worst(kind) for kind in KINDS),
    *(_along(kind) for kind in KINDS if len(kind.id_columns) > 1),
    _PANEL_SUMMARY,
)
