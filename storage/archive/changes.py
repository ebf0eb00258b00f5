"""What changed at each place since the scan before: findings that are new, worse, better or cured, and what drifts.

A finding is a feature that does not simply pass, or a stretch of a course as its run names it. A scan is compared with
the one before it of the same aircraft, panel and station; features are the same by their names, positions of a course
by where they lie along it. They are compared by the first quantity of their kind; along a course, where one
specification judged both scans, also by how far the worst quantity lies beyond its limits. A scan whose panel was not
recognised has names of its own, and so has a rivet that is in no pattern (X01): nothing there is compared.
"""

from __future__ import annotations

from metrology.kinds import KINDS, Kind
from storage.archive.views import NEWEST_FIRST, RANK_SQL, TAKEN_AT
from storage.archive.work import ATTENTION

NEW, WORSE, BETTER, SAME, CURED = "new", "worse", "better", "unchanged", "cured"
CHANGES = (NEW, WORSE, SAME, BETTER, CURED)

_SLACK_MM = 5.0  # a course is not found to begin at the same place on every scan
_HALF_STEP_MM = 1.0  # between two positions
WATCHED = 30
"""Scans of a place that a drift is looked for in, the newest ones."""

_KEPT_NAME = """registration IS DISTINCT FROM 'not recognised'
    AND NOT (coalesce(n_unlisted, 0) > 0 AND name LIKE 'X%')"""
_VALUES = ("value_mm", "u95_mm", "decision", "severity", "reason")


def _rows(kind: Kind) -> str:
    """Features of the scans that are compared, a course's with their position.

    The time adds nothing but speed: rows lie about in its order, so most of a table need not be looked at.
    """
    name, *position = kind.id_columns
    first = kind.quantities[0]
    u95 = ", ".join(quantity.u95_column for quantity in kind.quantities)
    beyond = f"beyond_mm, greatest({u95})" if kind.is_course else "NULL::DOUBLE AS beyond_mm, NULL::DOUBLE"
    return (
        f"SELECT now_id, now, '{kind.name}' AS feature_kind, {name} AS name, "
        f"{position[0] if position else '0.0'} AS position, {kind.id_sql} AS feature_id, {first.column} AS value_mm, "
        f"{first.u95_column} AS u95_mm, decision, severity, reason, {RANK_SQL} AS rank, {ATTENTION} AS bad, "
        f"{_KEPT_NAME} AS kept_name, {'stretch' if position else 'NULL::VARCHAR AS stretch'}, "
        f"{beyond} AS beyond_u95_mm, panel_spec "
        f"FROM {kind.table} JOIN scans USING (scene_id, captured_at)"
    )


def changes_sql(since: str) -> str:
    """A query of what the newest scans show, compared with the scans before them.

    Columns: aircraft_serial, panel, station, captured_at, scene_id, feature_kind, feature_id (of a stretch its own),
    name, from_mm, to_mm (0 for what is no course), positions, value_mm, u95_mm, decision, severity, reason, before_id,
    before_mm, before_u95_mm, and change (one of `CHANGES`).

    Parameters
    ----------
    since : str
        A condition on a row of `latest_scenes` with `taken_at`: which of the newest scans are meant.
    """
    worst = ", ".join(f"arg_min({name}, worse_first) AS {name}" for name in _VALUES)
    # Positions beside a finding are of another one, unless there is nothing else.
    beside = f"(o.position < f.from_mm - {_HALF_STEP_MM} OR o.position > f.to_mm + {_HALF_STEP_MM})"
    nearby = f"({beside}, o.rank, -coalesce(abs(o.value_mm), 0))"
    alike = f"NOT {beside} AND o.panel_spec = f.panel_spec"
    return f"""WITH fresh AS (
    SELECT * FROM (SELECT *, {TAKEN_AT} AS taken_at FROM latest_scenes) WHERE {since}
), before AS (
    SELECT f.scene_id AS now_id, s.scene_id, s.captured_at, s.registration, s.n_unlisted, s.panel_spec
    FROM fresh f JOIN scenes s USING (aircraft_serial, panel, station) WHERE s.captured_at < f.captured_at
    QUALIFY row_number() OVER (PARTITION BY f.scene_id ORDER BY s.captured_at DESC) = 1
), scans AS (
    SELECT scene_id AS now_id, scene_id, captured_at, true AS now, registration, n_unlisted, panel_spec FROM fresh
    UNION ALL SELECT now_id, scene_id, captured_at, false, registration, n_unlisted, panel_spec FROM before
), rows AS MATERIALIZED ({" UNION ALL ".join(_rows(kind) for kind in KINDS)}
), found AS (
    SELECT now_id, now, feature_kind, name, coalesce(stretch, feature_id) AS feature_id, min(position) AS from_mm,
        max(position) AS to_mm, count(*) AS positions, min(rank) AS rank, bool_and(kept_name) AS kept_name, {worst},
        any_value(panel_spec) AS panel_spec, max(beyond_mm) AS beyond_mm,
        arg_max(beyond_u95_mm, beyond_mm) AS beyond_u95_mm
    FROM (SELECT *, (rank, -coalesce(abs(value_mm), 0)) AS worse_first FROM rows) r WHERE bad
    GROUP BY now_id, now, feature_kind, name, coalesce(r.stretch, r.feature_id)
), other AS (
    SELECT f.now_id, f.now, f.feature_kind, f.name, f.from_mm, count(o.name) AS seen, bool_or(o.bad) AS bad,
        arg_min(o.rank, {nearby}) AS rank, arg_min(o.value_mm, {nearby}) AS value_mm,
        arg_min(o.u95_mm, {nearby}) AS u95_mm, max(o.beyond_mm) FILTER ({alike}) AS beyond_mm,
        arg_max(o.beyond_u95_mm, o.beyond_mm) FILTER ({alike}) AS beyond_u95_mm
    FROM found f LEFT JOIN rows o ON o.now_id = f.now_id AND o.now <> f.now AND o.feature_kind = f.feature_kind
        AND o.name = f.name AND o.position BETWEEN f.from_mm - {_SLACK_MM} AND f.to_mm + {_SLACK_MM}
        AND o.kept_name AND f.kept_name
    GROUP BY ALL
), compared AS (
    SELECT f.*, o.seen, o.value_mm AS before_mm, o.u95_mm AS before_u95_mm,
        CASE WHEN NOT f.now THEN CASE WHEN o.seen > 0 AND NOT o.bad THEN '{CURED}' END
            WHEN o.seen = 0 OR NOT o.bad THEN '{NEW}'
            WHEN f.rank < o.rank OR abs(f.value_mm) - abs(o.value_mm) > sqrt(f.u95_mm ** 2 + o.u95_mm ** 2)
                OR f.beyond_mm - o.beyond_mm > sqrt(f.beyond_u95_mm ** 2 + o.beyond_u95_mm ** 2) THEN '{WORSE}'
            WHEN f.rank > o.rank OR abs(o.value_mm) - abs(f.value_mm) > sqrt(f.u95_mm ** 2 + o.u95_mm ** 2)
                THEN '{BETTER}'
            ELSE '{SAME}' END AS change
    FROM found f JOIN other o USING (now_id, now, feature_kind, name, from_mm)
)
SELECT s.aircraft_serial, s.panel, s.station, s.captured_at, s.scene_id, c.feature_kind, c.feature_id, c.name,
    c.from_mm, c.to_mm, c.positions, CASE WHEN c.now THEN c.value_mm ELSE c.before_mm END AS value_mm,
    CASE WHEN c.now THEN c.u95_mm ELSE c.before_u95_mm END AS u95_mm, c.decision, c.severity, c.reason,
    b.scene_id AS before_id, CASE WHEN c.now THEN c.before_mm ELSE c.value_mm END AS before_mm,
    CASE WHEN c.now THEN c.before_u95_mm ELSE c.u95_mm END AS before_u95_mm, c.change
FROM compared c JOIN fresh s ON s.scene_id = c.now_id LEFT JOIN before b ON b.now_id = c.now_id
WHERE c.change IS NOT NULL
ORDER BY c.rank, c.severity = 'red' DESC NULLS LAST, abs(c.value_mm) DESC NULLS LAST, s.scene_id, c.feature_id"""


def drift_sql(since: str) -> str:
    """A query of how values of the same place move from scan to scan, over all aircraft, for the places just scanned.

    Columns: panel, station, feature_kind, name, n (scans), slope (mm a scan), r (correlation with the scans' order),
    value_mm (of the newest), scene_id and captured_at (of the newest).
    """
    parts = " UNION ALL ".join(
        f"SELECT scene_id, '{kind.name}' AS feature_kind, {kind.id_columns[0]} AS name, "
        f"avg({kind.quantities[0].column}) AS v FROM {kind.table} SEMI JOIN watched USING (scene_id, captured_at) "
        f"WHERE isfinite({kind.quantities[0].column}) GROUP BY ALL"
        for kind in KINDS
        if kind.by_design
    )
    return f"""WITH fresh AS (
    SELECT * FROM (SELECT *, {TAKEN_AT} AS taken_at FROM latest_scenes) WHERE {since}
), watched AS (
    SELECT panel, station, scene_id, captured_at, registration, n_unlisted,
        row_number() OVER (PARTITION BY panel, station ORDER BY {NEWEST_FIRST}) AS back
    FROM scenes SEMI JOIN fresh USING (panel, station) QUALIFY back <= {WATCHED}
)
SELECT panel, station, feature_kind, name, count(*) AS n, regr_slope(v, -back) AS slope, corr(v, -back) AS r,
    arg_min(v, back) AS value_mm, arg_min(scene_id, back) AS scene_id, arg_min(captured_at, back) AS captured_at
FROM ({parts}) JOIN watched USING (scene_id)
WHERE {_KEPT_NAME}
GROUP BY panel, station, feature_kind, name HAVING count(*) >= 3"""
