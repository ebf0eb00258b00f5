"""Views that people ask for; they live in the index beside the tables."""

from __future__ import annotations

from dataclasses import dataclass

KEY = "aircraft_serial, panel, station, captured_at, scene_id"
# From grave to harmless.
_RANK = (
    "CASE decision WHEN 'fail' THEN 0 WHEN 'conditional fail' THEN 1 WHEN 'not measured' THEN 2 "
    "WHEN 'conditional pass' THEN 3 WHEN 'pass' THEN 4 ELSE 5 END"
)


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
        "The newest scan of each station of each panel",
        "SELECT * FROM scenes QUALIFY row_number() OVER "
        "(PARTITION BY aircraft_serial, panel, station ORDER BY captured_at DESC) = 1",
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
        f"u_px, v_px FROM latest_rivets WHERE decision NOT IN ('pass', 'no limit') "
        f"ORDER BY {_RANK}, abs(height_mean_mm) DESC NULLS LAST",
    ),
    View(
        "worst_seam_stations",
        "Seam positions of the newest scans that do not pass, the gravest first, then by step",
        f"SELECT {KEY}, seam_id, s_mm, step_mm, step_u95_mm, width_mm, width_u95_mm, severity, decision, reason, "
        f"u_px, v_px FROM latest_seam_stations WHERE decision NOT IN ('pass', 'no limit') "
        f"ORDER BY {_RANK}, abs(step_mm) DESC NULLS LAST",
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
        "WITH s AS (SELECT aircraft_serial, panel, count(*) AS n_scenes, max(captured_at) AS last_captured_at, "
        "count(*) FILTER (status <> 'ok') AS n_scenes_with_warnings FROM latest_scenes GROUP BY ALL), "
        "r AS (SELECT aircraft_serial, panel, count(*) AS n_rivets, "
        "count(*) FILTER (decision IN ('fail', 'conditional fail')) AS n_rivets_failing, "
        "count(*) FILTER (decision = 'not measured') AS n_rivets_not_measured, "
        "max(abs(height_mean_mm)) AS height_worst_mm, avg(height_mean_mm) AS height_mean_mm "
        "FROM latest_rivets GROUP BY ALL), "
        "t AS (SELECT aircraft_serial, panel, count(*) AS n_seam_stations, "
        "count(*) FILTER (decision IN ('fail', 'conditional fail')) AS n_seam_stations_failing, "
        "max(abs(step_mm)) AS step_worst_mm, max(width_mm) AS width_worst_mm FROM latest_seam_stations GROUP BY ALL) "
        "SELECT * FROM s LEFT JOIN r USING (aircraft_serial, panel) LEFT JOIN t USING (aircraft_serial, panel)",
    ),
)
