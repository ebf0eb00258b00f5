"""How findings stand: waiting for a decision, with open work, or decided. One answer for pages, reports and sign-off.

A finding is a feature of the newest scan of its place that does not simply pass, or one of any scan
whose disposition left work open. Work that a disposition asked for (rework, repair, re-scan) is open until the same
feature (of a course: every position near to it) passes on a later scan of its station, until it is disposed of anew on
a later scan, or until a person closes it. A disposition holds for the values it was made about: where another run of
the scan measured something else, the finding waits again.

A stretch of a course is one finding (`metrology.stretches`). What was decided about it was decided about each of its
positions, so that it stands as they do: it waits as long as one of them does.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import duckdb
import pyarrow as pa

from metrology.kinds import KINDS, Kind
from metrology.verdicts import SEVERITIES
from storage.archive.views import RANK_SQL
from storage.review_details import Numbers
from storage.review_entries import SHOWN_NUMBERS, Entry, Feature, Review

State = Literal["waiting", "open work", "decided"]
WAITING: State = "waiting"
OPEN_WORK: State = "open work"
DECIDED: State = "decided"
UNRESOLVED: tuple[State, ...] = (WAITING, OPEN_WORK)
"""What stands between a scan and its sign-off."""

_KEY = "aircraft_serial, panel, station, captured_at, scene_id"
ATTENTION = "decision NOT IN ('pass', 'no limit')"
"""What a person must look at, as a condition on features."""

NEWEST = "scene_id IN (SELECT scene_id FROM latest_scenes)"
"""The newest scan of each station, as a condition on a scene's key."""

# Pages and reports write three decimals; a smaller difference nobody saw.
_VISIBLE = 0.0005
_REVIEWED = pa.schema(
    [
        *(pa.field(name, pa.string()) for name in ("scene_id", "feature_kind", "feature_id", "disposition", "who")),
        pa.field("decided_at", pa.timestamp("us", "UTC")),
        pa.field("comment", pa.string()),
        *(pa.field(name, pa.string()) for name in Numbers.model_fields),
        pa.field("decided_run", pa.string()),
        pa.field("decided_verdict", pa.string()),
        *(pa.field(f"decided_{name}", pa.float64()) for name in SHOWN_NUMBERS),
        pa.field("open_work", pa.bool_()),
        pa.field("closed_by", pa.string()),
        pa.field("closed_because", pa.string()),
    ]
)
_SIGNED = pa.schema([("scene_id", pa.string()), ("signed_by", pa.string()), ("signed_at", pa.timestamp("us", "UTC"))])


_NOT_ALONG = "NULL::DOUBLE AS at_mm, NULL::DOUBLE AS beyond_mm, NULL::VARCHAR AS stretch"
_SEVERITY_RANK = f"list_position({[name or '' for name in SEVERITIES]}, coalesce(severity, ''))"
_DECIDED = ", ".join(name for name in _REVIEWED.names if name not in ("scene_id", "feature_kind", "feature_id"))


def _differs(name: str) -> str:
    then, now = f"d.decided_{name}", f"f.{name}"
    return f"coalesce(abs({then} - {now}) > {_VISIBLE}, ({then} IS NULL) <> ({now} IS NULL))"


# Of a finding f of scene s with its last disposition d and the scene's sign-off g.
_STATE = f"""CASE WHEN d.open_work THEN '{OPEN_WORK}' WHEN g.signed_by IS NOT NULL THEN '{DECIDED}'
    WHEN d.disposition IS NULL THEN '{WAITING}'
    WHEN d.decided_verdict IS NOT NULL AND d.decided_run <> s.run_id
        AND (d.decided_verdict <> f.decision OR {" OR ".join(map(_differs, SHOWN_NUMBERS))}) THEN '{WAITING}'
    ELSE '{DECIDED}' END"""


@dataclass(frozen=True)
class Standing:
    """How a finding stands."""

    feature: Feature
    state: State


def features_sql(kind: Kind, condition: str = "true", source: str | None = None) -> str:
    """Rows of one kind of feature as findings list them: key, kind, id, values, verdict, and where along a course."""
    first, *others = kind.quantities
    columns = {"value_mm": first.column, "u95_mm": first.u95_column}
    columns |= {name: "NULL::DOUBLE" for name in SHOWN_NUMBERS if name not in columns}
    columns |= {quantity.column: quantity.column for quantity in others if quantity.column in columns}
    values = ", ".join(f"{sql} AS {name}" for name, sql in columns.items())
    along = f"{kind.id_columns[1]} AS at_mm, beyond_mm, stretch" if kind.is_course else _NOT_ALONG
    return (
        f"SELECT {_KEY}, '{kind.name}' AS feature_kind, {kind.id_sql} AS feature_id, {values}, "
        f"severity, decision, reason, {along} FROM {source or kind.table} WHERE {condition}"
    )


def stretches_sql(source: str, more: str) -> str:
    """The positions of each stretch as one finding.

    Parameters
    ----------
    source : str
        What has the columns of `features_sql`, of positions that name their stretch alone.
    more : str
        Further columns, as SQL.
    """
    worst = ", ".join(("value_mm", "u95_mm", *(name for name in SHOWN_NUMBERS if name != "value_mm")))
    length = "(max(at_mm) - min(at_mm)) * count(*) / greatest(count(*) - 1, 1)"
    at = "arg_max({'at_mm': at_mm, 'reason': reason}, coalesce(beyond_mm, '-inf'::DOUBLE))"
    said = f"printf('from %.0f to %.0f mm (%.0f mm), worst at %.0f mm', min(at_mm), max(at_mm), {length}, {at}.at_mm)"
    return f"""SELECT * EXCLUDE (worst), unnest(worst) FROM (SELECT
    any_value(aircraft_serial) AS aircraft_serial, any_value(panel) AS panel, any_value(station) AS station,
    any_value(captured_at) AS captured_at, scene_id, feature_kind, stretch AS feature_id,
    arg_max({_struct(worst)}, coalesce(beyond_mm, '-inf'::DOUBLE)) AS worst,
    first(severity ORDER BY {_SEVERITY_RANK}) AS severity, first(decision ORDER BY {RANK_SQL}) AS decision,
    concat_ws(': ', {said}, {at}.reason) AS reason, min(at_mm) AS from_mm, max(at_mm) AS to_mm,
    count(*)::INTEGER AS n_positions, {more}
FROM {source} GROUP BY scene_id, feature_kind, stretch)"""


def _struct(columns: str) -> str:
    return "{" + ", ".join(f"'{name}': {name}" for name in columns.split(", ")) + "}"


def _of_scenes(kind: Kind, scenes: str) -> str:
    return f"{kind.table} SEMI JOIN {scenes} USING (scene_id)"


def noticed_sql() -> str:
    """A query of what needs attention on the newest scans, which `findings_sql` can read in place of the tables."""
    return f"FROM ({_of_kinds(KINDS, ATTENTION)}) SEMI JOIN latest_scenes USING (scene_id)"


def _of_kinds(kinds: Sequence[Kind], condition: str, scenes: str | None = None) -> str:
    parts = [features_sql(kind, condition, scenes and _of_scenes(kind, scenes)) for kind in kinds]
    return " UNION ALL ".join(parts or [features_sql(KINDS[0], "false")])


def findings_sql(
    kinds: Sequence[Kind] = KINDS,
    attention: str = ATTENTION,
    worked: str = "true",
    near: str = "true",
    scenes: str = "true",
    newest: str = NEWEST,
    noticed: str | None = None,
) -> str:
    """A query of findings with how they stand; the connection must know `reviewed` and `signed` (see `register`).

    Columns: the key, feature_kind, feature_id, value_mm, u95_mm, tilt_deg, width_mm, severity, decision, reason,
    run_id, panel_spec, software_version, the columns of `reviewed`, signed_by, signed_at, state, and of stretches
    from_mm, to_mm; n_positions is 1 for all else. Values of a stretch are those of its worst position.

    Parameters
    ----------
    attention, worked : str
        Conditions on what is listed of the newest scans, and on what is listed for its open work.
    near : str
        A condition on a feature's key. Where conditions have parameters, they stand in this order: `scenes`,
        `attention`, `near`, `near`, `worked`, `attention`.
    scenes : str
        A condition on its scene, which stands first.
    newest : str
        Which scans' findings are listed, whether worked on or not.
    noticed : str, optional
        A table that has the rows of `noticed_sql`; with it `newest` stays as it is.
    """
    among = ", ".join(f"'{kind.name}'" for kind in kinds) or "NULL"
    rows = f"FROM {noticed} WHERE feature_kind IN ({among})" if noticed else _of_kinds(kinds, newest)
    parts = (
        f"FROM ({rows}) WHERE {attention} AND {near}",
        f"FROM ({_of_kinds(kinds, 'true', 'open_scenes')}) SEMI JOIN worked USING (scene_id, feature_kind, feature_id) "
        f"WHERE {near} AND {worked} AND NOT ({attention} AND {newest})",
    )
    decided = f"""any_value(run_id) AS run_id, any_value(panel_spec) AS panel_spec,
    any_value(software_version) AS software_version, arg_max({_struct(_DECIDED)}, decided_at) AS last,
    any_value(signed_by) AS signed_by, any_value(signed_at) AS signed_at, CASE WHEN bool_or(state = '{WAITING}')
    THEN '{WAITING}' WHEN bool_or(state = '{OPEN_WORK}') THEN '{OPEN_WORK}' ELSE '{DECIDED}' END AS state"""
    along = "(FROM found WHERE stretch IS NOT NULL)"
    return f"""WITH worked AS (SELECT scene_id, feature_kind, feature_id FROM reviewed WHERE open_work),
open_scenes AS (SELECT DISTINCT scene_id FROM worked),
s AS (SELECT scene_id, run_id, panel_spec, software_version FROM scenes WHERE {scenes}),
found AS MATERIALIZED (
    SELECT f.*, s.* EXCLUDE (scene_id), d.* EXCLUDE (scene_id, feature_kind, feature_id), g.signed_by, g.signed_at,
        {_STATE} AS state
    FROM ({" UNION ALL ".join(parts)}) f JOIN s USING (scene_id)
    LEFT JOIN reviewed d USING (scene_id, feature_kind, feature_id) LEFT JOIN signed g USING (scene_id)
)
SELECT * EXCLUDE (at_mm, beyond_mm, stretch), NULL::DOUBLE AS from_mm, NULL::DOUBLE AS to_mm, 1 AS n_positions
FROM found WHERE stretch IS NULL
UNION ALL BY NAME SELECT * EXCLUDE (last), unnest(last) FROM ({stretches_sql(along, decided)})"""


def register(connection: duckdb.DuckDBPyConnection, review: Review) -> None:
    """Make what people decided known to a connection.

    `reviewed` has the last disposition of each feature, what it was about, whether its work is open, and by whom it was
    closed; `signed` has the sign-off of each scene.
    """
    connection.register("reviewed", reviewed_features(connection, review))
    connection.register("signed", signed_scenes(review))


def reviewed_features(connection: duckdb.DuckDBPyConnection, review: Review) -> pa.Table:
    """The last disposition of each feature that has one."""
    work, closes = open_work(connection, review), review.closes()
    rows = []
    for key, entry in review.current().items():
        scene_id, feature = key
        close = closes.get(key)
        rows.append(
            (scene_id, feature.kind, feature.id, entry.disposition, entry.who, entry.at, entry.comment,
             *entry.numbers.columns, entry.run_id, entry.decided_verdict, entry.decided_value_mm,
             entry.decided_tilt_deg, entry.decided_width_mm, key in work, close.who if close else None,
             close.comment if close else None)
        )  # fmt: skip
    return _table(rows, _REVIEWED)


def signed_scenes(review: Review) -> pa.Table:
    """The sign-off of each scene that has one."""
    return _table([(scene, entry.who, entry.at) for scene, entry in review.sign_offs().items()], _SIGNED)


def open_work(connection: duckdb.DuckDBPyConnection, review: Review) -> dict[tuple[str, Feature], Entry]:
    """Dispositions whose work is not done: nobody closed it, and no later scan shows that it is."""
    asked = review.work()
    if not asked:
        return {}
    rows = [(*_row(key), True) for key in asked]
    rows += [(*_row(key), False) for key in review.current() if key not in asked]
    names = [(name, pa.string()) for name in ("scene_id", "feature_kind", "feature_id")]
    connection.register("disposed", _table(rows, pa.schema([*names, ("asks", pa.bool_())])))
    done = {(scene, Feature(kind, name)) for scene, kind, name in connection.execute(_DONE_SQL).fetchall()}
    connection.unregister("disposed")
    return {key: entry for key, entry in asked.items() if key not in done}


# A scan whose panel was not recognised has ids of its own; what is in no pattern (X…) is numbered anew on each scan.
_SAME = """s.registration IS DISTINCT FROM 'not recognised'
    AND NOT (coalesce(s.n_unlisted, 0) > 0 AND feature_id LIKE 'X%')"""
_PASSES = "decision IN ('pass', 'conditional pass')"
# Positions of two scans of a course lie between each other: one is answered by those this near to it, all of them.
NEAR_MM = 1.5
_COURSES = ", ".join(f"'{kind.name}'" for kind in KINDS if kind.is_course)
_ALONG = f"feature_kind IN ({_COURSES})"
_PLACE = f"""CASE WHEN {_ALONG} THEN split_part(feature_id, '@', 1) ELSE feature_id END AS name,
    CASE WHEN {_ALONG} THEN TRY_CAST(split_part(feature_id, '@', 2) AS DOUBLE) END AS place_mm"""
_DONE_SQL = f"""WITH named AS (
    SELECT d.*, s.aircraft_serial, s.panel, s.station, s.captured_at, {_PLACE}
    FROM disposed d JOIN scenes s USING (scene_id) WHERE {_SAME}
), places AS (SELECT DISTINCT aircraft_serial, panel, station FROM named WHERE asks
), later AS (SELECT s.* FROM scenes s SEMI JOIN places USING (aircraft_serial, panel, station)
), found AS (
    SELECT f.*, {_PLACE}, {_PASSES} AS passes FROM (
        {
    " UNION ALL ".join(
        features_sql(kind, "true" if kind.is_course else _PASSES, _of_scenes(kind, "later")) for kind in KINDS
    )
}
    ) f JOIN later s USING (scene_id) WHERE {_SAME}
), answers AS (
    SELECT aircraft_serial, panel, station, feature_kind, name, place_mm, captured_at, passes, 'scan' AS by FROM found
    UNION ALL
    SELECT aircraft_serial, panel, station, feature_kind, name, place_mm, captured_at, true, 'person' FROM named
)
SELECT DISTINCT scene_id, feature_kind, feature_id FROM (
    SELECT n.scene_id, n.feature_kind, n.feature_id FROM named n
    JOIN answers a USING (aircraft_serial, panel, station, feature_kind, name)
    WHERE n.asks AND a.captured_at > n.captured_at
        AND coalesce(abs(a.place_mm - n.place_mm) <= {NEAR_MM}, n.place_mm IS NULL)
    GROUP BY n.scene_id, n.feature_kind, n.feature_id, a.captured_at, a.by HAVING bool_and(a.passes)
)"""


def standings(connection: duckdb.DuckDBPyConnection, review: Review, scene_id: str) -> tuple[Standing, ...]:
    """How each finding of a scene stands, in the order of their names."""
    return standings_of(connection, review, [scene_id])[scene_id]


def standings_of(
    connection: duckdb.DuckDBPyConnection, review: Review, scene_ids: Sequence[str]
) -> dict[str, tuple[Standing, ...]]:
    """How each finding of some scenes stands, by the scene and in the order of their names."""
    if not scene_ids:
        return {}
    register(connection, review)
    among = f"scene_id IN ({', '.join('?' * len(scene_ids))})"
    sql = findings_sql(near=among, scenes=among, newest="true")
    rows = connection.execute(
        f"SELECT scene_id, feature_kind, feature_id, state FROM ({sql}) ORDER BY feature_kind, feature_id",
        [*scene_ids] * 3,
    ).fetchall()
    found: dict[str, list[Standing]] = {scene_id: [] for scene_id in scene_ids}
    for scene_id, kind, name, state in rows:
        found[scene_id].append(Standing(Feature(kind, name), state))
    return {scene_id: tuple(standing) for scene_id, standing in found.items()}


def said(standings: Iterable[Standing]) -> str:
    """How many findings stand how, in words: "18 waiting, 1 open work, 1 decided"."""
    counts = Counter(standing.state for standing in standings)
    return ", ".join(f"{counts[state]} {state}" for state in (*UNRESOLVED, DECIDED) if counts[state]) or "no findings"


def _row(key: tuple[str, Feature]) -> tuple[str, str, str]:
    return key[0], key[1].kind, key[1].id


def _table(rows: Sequence[tuple[Any, ...]], schema: pa.Schema) -> pa.Table:
    columns = list(zip(*rows, strict=True)) or [()] * len(schema)
    return pa.table([pa.array(column, field.type) for column, field in zip(columns, schema, strict=True)], schema)
