"""Work that was decided about a panel's findings, and what the scans since then show."""

from __future__ import annotations

from metrology.kinds import KINDS
from storage.archive.schema import PANEL_OF_KIND
from storage.archive.work import NEAR_MM
from storage.review import ASKS_FOR_WORK

NOT_CURED, PLANNED, CURED, CLOSED, DECIDED_ANEW = "not cured", "planned", "cured", "closed by a person", "decided anew"
STATES = (NOT_CURED, PLANNED, CURED, CLOSED, DECIDED_ANEW)
"""What may have become of work; of a stretch the first that holds for one of its positions."""


def rework_sql() -> str:
    """A query of the dispositions that asked for work; the connection must know `reviewed` (`work.register`).

    Columns: scene_id, station, captured_at (of the scan that it was decided on), feature_kind, name, disposition, who,
    decided_at, comment, concession, part_number, work_order, state (one of `STATES`), at_mm (middle of a stretch; NULL
    where there are no positions), panel_feature (its name in the assembled panel, of a stretch that of its first
    position; NULL where the panel has none). Parameters: aircraft, panel.
    """
    panel = " UNION ALL ".join(
        f"SELECT aircraft_serial, panel, '{kind.name}' AS feature_kind, {kind.id_sql} AS panel_feature, "
        f"unnest(seen_by) AS scene_id, unnest(seen_as) AS own FROM {PANEL_OF_KIND[kind.name].name} "
        "WHERE aircraft_serial = $1 AND panel = $2"
        for kind in KINDS
    )
    states = ", ".join(f"'{state}'" for state in STATES)
    return f"""WITH of_panel AS (
    SELECT scene_id, station, captured_at FROM scenes WHERE aircraft_serial = $1 AND panel = $2
), newest AS (SELECT station, captured_at AS newest_at FROM latest_scenes WHERE aircraft_serial = $1 AND panel = $2
), asked AS (
    SELECT r.*, o.station, o.captured_at, n.newest_at, split_part(r.feature_id, '@', 1) AS name,
        TRY_CAST(split_part(r.feature_id, '@', 2) AS DOUBLE) AS at_mm
    FROM reviewed r JOIN of_panel o USING (scene_id) JOIN newest n USING (station)
), seen AS (
    SELECT p.feature_kind, p.panel_feature, o.station, split_part(p.own, '@', 1) AS name,
        TRY_CAST(split_part(p.own, '@', 2) AS DOUBLE) AS at_mm
    FROM ({panel}) p JOIN of_panel o USING (scene_id)
), each AS (
    SELECT a.scene_id, a.station, a.captured_at, a.feature_kind, a.name, a.at_mm, a.disposition, a.who, a.decided_at,
        a.comment, a.concession, a.part_number, a.work_order, CASE WHEN a.closed_by IS NOT NULL THEN '{CLOSED}'
            WHEN NOT a.open_work AND EXISTS (
                FROM asked b WHERE b.station = a.station AND b.feature_kind = a.feature_kind
                AND b.feature_id = a.feature_id AND b.captured_at > a.captured_at) THEN '{DECIDED_ANEW}'
            WHEN NOT a.open_work THEN '{CURED}' WHEN a.newest_at > a.captured_at THEN '{NOT_CURED}'
            ELSE '{PLANNED}' END AS state,
        (SELECT arg_min(s.panel_feature, coalesce(abs(s.at_mm - a.at_mm), 0)) FROM seen s
         WHERE s.station = a.station AND s.feature_kind = a.feature_kind AND s.name = a.name
            AND coalesce(abs(s.at_mm - a.at_mm) <= {NEAR_MM}, s.at_mm IS NULL)) AS panel_feature
    FROM asked a WHERE a.disposition IN {ASKS_FOR_WORK}
)
SELECT * FROM (SELECT scene_id, station, captured_at, feature_kind, name, disposition, who, decided_at,
    any_value(comment) AS comment, any_value(concession) AS concession, any_value(part_number) AS part_number,
    any_value(work_order) AS work_order, avg(at_mm) AS at_mm,
    first(state ORDER BY list_position([{states}], state)) AS state,
    first(panel_feature ORDER BY at_mm) FILTER (panel_feature IS NOT NULL) AS panel_feature
FROM each GROUP BY scene_id, station, captured_at, feature_kind, name, disposition, who, decided_at)
ORDER BY list_position([{states}], state), decided_at"""
