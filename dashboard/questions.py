"""The questions asked most, as SQL that anybody may change: the page SQL answers each by one click."""

from __future__ import annotations

from dashboard.trends import TYPE_SQL
from dashboard.words import N_

_OUT = "decision IN ('fail', 'conditional fail')"
_NOTICED = "decision NOT IN ('pass', 'no limit')"
_FEATURES = f"""SELECT scene_id, {_OUT} AS outside FROM rivets
    UNION ALL SELECT scene_id, {_OUT} FROM seam_stations"""

QUESTIONS = {
    N_("Worst of each aircraft"): """SELECT aircraft_serial, panel, station, kind, name, value_mm, decision, reason
FROM (
    SELECT aircraft_serial, panel, station, 'rivet' AS kind, rivet_id AS name, height_mean_mm AS value_mm,
        decision, reason FROM worst_rivets
    UNION ALL SELECT aircraft_serial, panel, station, 'seam', printf('%s at %.0f mm', seam_id, s_mm), step_mm,
        decision, reason FROM worst_seam_stations
)
QUALIFY row_number() OVER (PARTITION BY aircraft_serial ORDER BY abs(value_mm) DESC NULLS LAST) = 1
ORDER BY abs(value_mm) DESC NULLS LAST LIMIT 500""",
    N_("Share of seam length out of tolerance"): f"""SELECT aircraft_serial, panel,
    round(100 * avg(({_OUT})::INT), 1) AS percent_outside, count(*) AS positions
FROM latest_seam_stations WHERE decision <> 'not measured'
GROUP BY ALL ORDER BY percent_outside DESC, aircraft_serial, panel LIMIT 500""",
    N_("First-pass yield"): f"""WITH first_scans AS (
    SELECT scene_id, aircraft_serial, panel FROM scenes
    QUALIFY row_number() OVER (PARTITION BY aircraft_serial, panel, station ORDER BY captured_at) = 1
), judged AS (
    SELECT aircraft_serial, panel, bool_or(outside) AS outside
    FROM first_scans JOIN ({_FEATURES}) USING (scene_id) GROUP BY ALL
)
SELECT panel, count(*) AS aircraft, count(*) FILTER (NOT outside) AS passed_at_once,
    round(100 * avg((NOT outside)::INT), 1) AS percent
FROM judged GROUP BY panel ORDER BY percent, panel LIMIT 500""",
    N_("Never measured"): """SELECT aircraft_serial, panel, station, rivet_id AS name, count(*) AS scans,
    any_value(reason) AS reason
FROM rivets GROUP BY ALL HAVING count(height_mean_mm) = 0
UNION ALL SELECT aircraft_serial, panel, station, seam_id, count(DISTINCT scene_id), any_value(reason)
FROM seam_stations GROUP BY ALL HAVING count(step_mm) = 0 AND count(width_mm) = 0
UNION ALL SELECT aircraft_serial, panel, station, feature_id, NULL, coalesce(reason, state)
FROM panel_coverage WHERE state <> 'measured'
ORDER BY ALL LIMIT 1000""",
    N_("Drift from aircraft to aircraft"): """SELECT panel, station, rivet_id, count(*) AS scans,
    round(regr_slope(height_mean_mm, number), 4) AS mm_each_scan, round(corr(height_mean_mm, number), 2) AS correlation,
    arg_max(height_mean_mm, number) AS newest_mm
FROM (
    SELECT *, row_number() OVER (PARTITION BY panel, station, rivet_id ORDER BY captured_at) AS number
    FROM rivets WHERE height_mean_mm IS NOT NULL
)
GROUP BY ALL HAVING count(*) >= 5 ORDER BY abs(correlation) DESC LIMIT 200""",
    N_("Who decided what"): """SELECT "at", who, action, disposition, scene_id, feature_kind, feature_id, comment
FROM decisions ORDER BY number DESC LIMIT 1000""",
    N_("Distance to the limit"): f"""WITH found AS (
    SELECT scene_id, aircraft_serial, panel, station, rivet_id AS name, NULL AS at_mm,
        coalesce(zone, 'default') AS zone, 'rivet' AS kind, 'height' AS quantity, height_mean_mm AS value_mm,
        NULL AS into_wind_mm FROM latest_rivets WHERE {_NOTICED}
    UNION ALL SELECT scene_id, aircraft_serial, panel, station, seam_id, s_mm, coalesce(zone, 'default'),
        'seam station', 'step', step_mm, step_into_wind_mm FROM latest_seam_stations WHERE {_NOTICED}
    UNION ALL SELECT scene_id, aircraft_serial, panel, station, seam_id, s_mm, coalesce(zone, 'default'),
        'seam station', 'gap', width_mm, NULL FROM latest_seam_stations WHERE {_NOTICED}
), judged AS (
    SELECT f.*, l.lower, l.upper, l.depends_on, CASE l.depends_on
        WHEN 'into the wind' THEN coalesce(into_wind_mm, abs(value_mm))
        WHEN 'out of the wind' THEN coalesce(-into_wind_mm, abs(value_mm)) ELSE value_mm END AS met_mm
    FROM found f JOIN limits l USING (panel, zone, kind, quantity)
    JOIN (SELECT scene_id, config_hash FROM scenes) s USING (scene_id)
    WHERE list_contains(l.config_hashes, s.config_hash)
)
SELECT aircraft_serial, panel, station, name, at_mm, quantity, depends_on, met_mm AS value_mm, lower, upper,
    round(greatest(lower - met_mm, met_mm - upper), 4) AS beyond_mm
FROM judged WHERE met_mm IS NOT NULL
QUALIFY row_number() OVER (PARTITION BY scene_id, name, quantity ORDER BY beyond_mm DESC) = 1
ORDER BY beyond_mm DESC LIMIT 500""",
    N_("Recurring at the same place"): f"""SELECT panel, station, rivet_id, count(DISTINCT aircraft_serial) AS aircraft,
    round(avg(height_mean_mm), 3) AS mean_mm, string_agg(DISTINCT aircraft_serial, ', ') AS which
FROM latest_rivets WHERE {_OUT}
GROUP BY ALL HAVING count(DISTINCT aircraft_serial) > 1 ORDER BY aircraft DESC, panel, station LIMIT 500""",
    N_("By fastener type"): f"""SELECT {TYPE_SQL} AS head_mm, count(*) AS rivets,
    count(*) FILTER ({_OUT}) AS outside, round(100 * avg(({_OUT})::INT), 1) AS percent_outside,
    round(avg(height_mean_mm), 4) AS mean_mm, round(stddev_samp(height_mean_mm), 4) AS sd_mm
FROM latest_rivets WHERE diameter_mm IS NOT NULL GROUP BY 1 ORDER BY 1""",
    N_("By operator"): f"""SELECT coalesce(operator, '(not stated)') AS operator, count(DISTINCT scene_id) AS scans,
    count(*) AS features, round(100 * avg(outside::INT), 1) AS percent_outside,
    count(DISTINCT scene_id) FILTER (status <> 'ok') AS scans_with_warnings
FROM scenes JOIN ({_FEATURES}) USING (scene_id) GROUP BY 1 ORDER BY scans DESC LIMIT 500""",
}
MORE = {
    N_("How each panel stands"): "SELECT * FROM panel_summary\n"
    "ORDER BY n_rivets_failing + n_seam_stations_failing DESC\nLIMIT 200",
    N_("Steps of each seam"): "SELECT * FROM seam_summary ORDER BY step_abs_p95_mm DESC LIMIT 200",
    N_(
        "What could not be measured, and why"
    ): "SELECT reason, count(*) AS n\nFROM rivets WHERE decision = 'not measured'\nGROUP BY reason ORDER BY n DESC",
    N_("Rivets that people let pass"): "SELECT r.*, d.who, d.comment\nFROM rivets r JOIN dispositions d\n"
    "ON r.scene_id = d.scene_id AND r.rivet_id = d.feature_id\nWHERE d.disposition = 'use as is'",
    N_("Open work"): "SELECT scene_id, feature_id, disposition, who, decided_at\nFROM dispositions "
    "WHERE open_work ORDER BY decided_at",
    N_("Rigs and when they are due"): "SELECT * FROM rigs\n"
    "ORDER BY least(calibration_due_at, verification_due_at) NULLS LAST",
    N_("Seconds per scan and rig"): "SELECT rig_id, count(*) AS scenes, median(seconds_total) AS seconds\n"
    "FROM scenes GROUP BY rig_id ORDER BY scenes DESC",
}
"""Further examples."""
