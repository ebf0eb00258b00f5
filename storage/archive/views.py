"""Views that people ask for; they live in the index beside the tables."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import timedelta

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


VIEWS = (
    View(
        "latest_scenes",
        "The newest scan of each station of each panel; one whose time lies ahead only where there is no other",
        "SELECT * FROM scenes QUALIFY row_number() OVER "
        f"(PARTITION BY aircraft_serial, panel, station ORDER BY {NEWEST_FIRST}) = 1",
    ),
    View(
        "latest_rivets",
        "The rivets of the newest scan of each station",
        "SELECT rivets.* FROM rivets SEMI JOIN latest_scenes USING (scene_id)",
    ),
    View(
        "latest_seam_stations",
        "The seam positions of the newest scan of each station",
        "SELECT seam_stations.* FROM seam_stations SEMI JOIN latest_scenes USING (scene_id)",
    ),
    View(
        "worst_rivets",
        "Rivets of the newest scans that do not pass, the gravest first, then by distance from flush",
        f"SELECT {KEY}, rivet_id, height_mean_mm, height_u95_mm, tilt_deg, tilt_u95_deg, severity, decision, reason, "
        f"u_px, v_px FROM latest_rivets WHERE NOT {_IN_ORDER_SQL} "
        f"ORDER BY {RANK_SQL}, abs(height_mean_mm) DESC NULLS LAST",
    ),
    View(
        "worst_seam_stations",
        "Seam positions of the newest scans that do not pass, the gravest first, then by step",
        f"SELECT {KEY}, seam_id, s_mm, step_mm, step_u95_mm, width_mm, width_u95_mm, severity, decision, reason, "
        f"u_px, v_px FROM latest_seam_stations WHERE NOT {_IN_ORDER_SQL} "
        f"ORDER BY {RANK_SQL}, abs(step_mm) DESC NULLS LAST",
    ),
    View(
        "seam_summary",
        "One row per seam of each scene: step and width over its length",
        f"SELECT {KEY}, seam_id, count(*) AS n_stations, max(s_mm) AS length_mm, "
        "min(step_mm) AS step_min_mm, max(step_mm) AS step_max_mm, avg(step_mm) AS step_mean_mm, "
        "quantile_cont(abs(step_mm), 0.95) AS step_abs_p95_mm, "
        "min(width_mm) AS width_min_mm, max(width_mm) AS width_max_mm, avg(width_mm) AS width_mean_mm, "
        "count(*) FILTER (decision = 'fail') AS n_fail, count(*) FILTER (decision = 'not measured') AS n_not_measured "
        f"FROM seam_stations GROUP BY {KEY}, seam_id",
    ),
    View(
        "panel_summary",
        "One row per panel of each aircraft, from the newest scan of each of its stations",
        f"WITH s AS (SELECT aircraft_serial, panel, count(*) AS n_scenes, {NEWEST_TIME} AS last_captured_at, "
        "count(*) FILTER (status <> 'ok') AS n_scenes_with_warnings, "
        "count(*) FILTER (rig_verdict = 'unjudged') AS n_scenes_rig_unjudged FROM latest_scenes GROUP BY ALL), "
        "r AS (SELECT aircraft_serial, panel, count(*) AS n_rivets, "
        f"count(*) FILTER ({OUTSIDE_SQL}) AS n_rivets_failing, "
        "count(*) FILTER (decision = 'not measured') AS n_rivets_not_measured, "
        "max(abs(height_mean_mm)) AS height_worst_mm, avg(height_mean_mm) AS height_mean_mm "
        "FROM latest_rivets GROUP BY ALL), "
        "t AS (SELECT aircraft_serial, panel, count(*) AS n_seam_stations, "
        f"count(*) FILTER ({OUTSIDE_SQL}) AS n_seam_stations_failing, "
        "max(abs(step_mm)) AS step_worst_mm, max(width_mm) AS width_worst_mm FROM latest_seam_stations GROUP BY ALL) "
        "SELECT * FROM s LEFT JOIN r USING (aircraft_serial, panel) LEFT JOIN t USING (aircraft_serial, panel)",
    ),
)
