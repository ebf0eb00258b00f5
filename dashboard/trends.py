"""Series for the trend charts: one value per scan or aircraft in the order of time, and how all values are spread."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from dashboard.data import Archive
from dashboard.findings import Selection
from dashboard.standard import PLAIN, SIGNS, LimitGroup, Standard
from dashboard.words import N_, _
from metrology import kinds
from metrology.errors import FlushlineError
from metrology.kinds import KINDS, RIVET, Kind
from metrology.requirements import limit_of
from metrology.statistics import Capability, capability, capability_from_moments, pooled_sigma
from metrology.tolerance import Limit, PanelSpec
from storage.archive.views import OUTSIDE_SQL, TAKEN_AT

_BINS = 60
_ROUND = "row_number() OVER (PARTITION BY aircraft_serial, panel, station ORDER BY captured_at, scene_id)"
"""Which scan of its station a scene is."""


@dataclass(frozen=True)
class Quantity:
    """A measured quantity of a kind, with the title and unit that it is charted by."""

    kind: Kind
    measured_as: kinds.Quantity
    title: str
    unit: str

    @property
    def table(self) -> str:
        """The kind's table."""
        return self.kind.table

    @property
    def column(self) -> str:
        """The value's column."""
        return self.measured_as.column

    @property
    def measured(self) -> str:
        """SQL for the value; what is not finite is not a measurement."""
        return f"CASE WHEN isfinite(q.{self.column}) THEN q.{self.column} END"

    @property
    def downstream(self) -> str:
        """SQL for whether side B lies downstream, which decides the limits of a step; 0 where that is nothing to it."""
        as_met = self.measured_as.into_wind
        if not as_met:
            return "0"
        return f"CASE WHEN q.{as_met} IS NULL THEN 0 WHEN q.{self.column} * q.{as_met} < 0 THEN -1 ELSE 1 END"

    def against(self, standard: Standard) -> Quantity:
        """The quantity as a chart names it that holds it against a standard."""
        return (
            replace(self, title=_("{quantity} over its limits", quantity=_(self.title)), unit="×")
            if standard.relative
            else self
        )


QUANTITIES = {
    quantity.name: Quantity(kind, quantity, quantity.title, quantity.unit)
    for kind in KINDS
    for quantity in kind.quantities
}
FASTENER_TYPE = N_("fastener type")
BY_SUBJECT = {kind.subject: kind for kind in KINDS}
"""The kinds whose values a trend follows name by name."""
SUBJECTS = {
    **{subject: tuple(quantity.name for quantity in kind.quantities) for subject, kind in BY_SUBJECT.items()},
    N_("panel"): tuple(QUANTITIES),
    FASTENER_TYPE: tuple(quantity.name for quantity in RIVET.quantities),
}
"""What a trend is about, and the quantities that fit."""
TYPE_SQL = "round(diameter_mm * 2) / 2"
"""A fastener type is recognised by its head's diameter, to half a millimetre."""


@dataclass(frozen=True)
class Subject:
    """What a trend follows."""

    kind: str
    """What a name stands for, "rivet" or "seam"; or "panel", or "fastener type"."""
    panel: str = ""
    station: str = ""
    """panel, station: station only for names."""
    name: str = ""
    """The name; the head's diameter in mm for a type."""

    def where(self) -> tuple[str, list[Any]]:
        """SQL condition on the quantity's table."""
        if self.kind == FASTENER_TYPE:
            return f"{TYPE_SQL} = ?", [_number(self.name)]
        conditions, parameters = ["panel = ?"], list[Any]([self.panel])
        if kind := BY_SUBJECT.get(self.kind):
            conditions += ["station = ?", f"{kind.id_columns[0]} = ?"]
            parameters += [self.station, self.name]
        return " AND ".join(conditions), parameters

    @property
    def of_aircraft(self) -> bool:
        """Whether a point of the series is of an aircraft, over several scans."""
        return self.kind not in BY_SUBJECT

    @property
    def averaged(self) -> bool:
        """Whether a point of the series is a mean of many values."""
        kind = BY_SUBJECT.get(self.kind)
        return kind is None or len(kind.id_columns) > 1


def limit_groups(archive: Archive, subject: Subject, quantity: Quantity, selection: Selection) -> list[LimitGroup]:
    """By which limits the values of a trend were judged: those that each run's own specification gives."""
    values, parameters = _values(subject, quantity, selection, PLAIN)
    rows = archive.rows(
        "SELECT config_hash, panel_spec, zone, downstream, max(bundle_path) AS bundle_path, "
        # A step of nothing says nothing of the wind.
        f"count(*) FILTER ({'v <> 0 OR downstream = 0' if quantity.measured_as.into_wind else 'true'}) AS n "
        f"FROM ({values}) WHERE v IS NOT NULL GROUP BY 1, 2, 3, 4 ORDER BY ALL",
        parameters,
    )
    groups = []
    for (config, named, zone), part in rows.groupby(["config_hash", "panel_spec", "zone"], sort=False):
        spec = _specification(archive, part["bundle_path"].iloc[0])
        counts = dict(zip(part["downstream"].astype(int), part["n"].astype(int), strict=True))
        for sign in SIGNS if quantity.measured_as.into_wind else (0,):
            limit = limit_of(spec.zone(str(zone) or None), quantity.measured_as, sign) if spec else None
            groups.append(
                LimitGroup(str(config), str(named), str(zone), counts.get(sign, 0), sign, limit, spec is not None)
            )
    return groups


def _specification(archive: Archive, bundle: object) -> PanelSpec | None:
    try:
        return archive.specification(bundle)
    except FlushlineError:  # a bundle that is not here any more
        return None


def _values(subject: Subject, quantity: Quantity, selection: Selection, standard: Standard) -> tuple[str, list[Any]]:
    """SQL for a trend's values v, in the unit of the standard, with their scan's columns, and its parameters."""
    condition, parameters = subject.where()
    limited, more = selection.where()
    scaled, scales = "", list[Any]()
    if standard.scales:
        rows = ", ".join("(?, ?, ?, ?::INT, ?::DOUBLE, ?::DOUBLE)" for _ in standard.scales)
        scaled = (
            f"JOIN (VALUES {rows}) l(config_hash, panel_spec, zone, downstream, middle, reach) "
            f"ON l.config_hash = s.config_hash AND l.panel_spec = s.panel_spec AND l.zone = coalesce(q.zone, '') "
            f"AND l.downstream = {quantity.downstream} "
        )
        scales = [value for scale in standard.scales for value in scale]
    value = f"({quantity.measured} - l.middle) / l.reach" if scaled else quantity.measured
    sql = (
        f"SELECT q.*, s.taken_at, s.round, s.rig_id, s.software_version, s.config_hash, s.panel_spec, s.bundle_path, "
        f"{quantity.downstream} AS downstream, {value} AS v "
        f"FROM (SELECT * REPLACE (coalesce(zone, '') AS zone) FROM {quantity.table} WHERE {condition}) q "
        f"JOIN (SELECT scene_id, {TAKEN_AT} AS taken_at, {_ROUND if subject.of_aircraft else '1'} AS round, "
        "rig_id, software_version, bundle_path, "
        "coalesce(config_hash, '') AS config_hash, "
        f"coalesce(panel_spec, '') AS panel_spec FROM scenes WHERE {limited}) s USING (scene_id) {scaled}"
    )
    return sql, [*parameters, *more, *scales]


def series(
    archive: Archive, subject: Subject, quantity: Quantity, selection: Selection, standard: Standard = PLAIN
) -> pd.DataFrame:
    """One row per scan (rivet, seam) or round of scans of an aircraft (panel, type), in the order of time.

    A round has one scan of each station: what was scanned again after rework is not averaged with what was before.

    Columns: captured_at, value (mean), n (values in it), variance (of them), aircraft_serial, scene_id (the newest),
    rig_id, software_version.
    """
    values, parameters = _values(subject, quantity, selection, standard)
    by = "t.aircraft_serial, t.round" if subject.of_aircraft else "t.scene_id"
    return archive.rows(
        "SELECT max(taken_at) AS captured_at, avg(v) AS value, count(v) AS n, "
        "var_samp(v) AS variance, any_value(t.aircraft_serial) AS aircraft_serial, max(t.scene_id) AS scene_id, "
        "arg_max(rig_id, t.taken_at) AS rig_id, arg_max(software_version, t.taken_at) AS software_version "
        f"FROM ({values}) t GROUP BY {by} ORDER BY 1, 5",
        parameters,
    )


@dataclass(frozen=True)
class Spread:
    """How single values are distributed."""

    n: int
    mean: float
    sd: float
    centres: np.ndarray
    counts: np.ndarray
    """centres, counts: (k,): histogram."""
    width: float
    """Of a bin."""


def spread(
    archive: Archive, subject: Subject, quantity: Quantity, selection: Selection, standard: Standard = PLAIN
) -> Spread | None:
    """Distribution of all single values; None where there are fewer than two."""
    everything, known = _values(subject, quantity, selection, standard)
    bins = archive.rows(
        f"WITH q AS MATERIALIZED (SELECT v FROM ({everything}) WHERE v IS NOT NULL), "
        "w AS (SELECT count(v) AS n, avg(v) AS mean, stddev_samp(v) AS sd, "
        # As many bins as Rice's rule gives, up to a number.
        f"greatest((max(v) - min(v)) / least({_BINS}, 2 * ceil(cbrt(count(v)))), 1e-6) AS width FROM q) "
        "SELECT any_value(w) AS whole, floor(v / w.width)::BIGINT AS bin, count(*) AS counted FROM q, w "
        "GROUP BY bin ORDER BY bin",
        known,
    )
    whole = dict(bins["whole"].iloc[0]) if len(bins) else {"n": 0}
    if whole["n"] < 2:
        return None
    width = float(whole["width"])
    return Spread(
        int(whole["n"]),
        float(whole["mean"]),
        float(whole["sd"]),
        (bins["bin"].to_numpy(float) + 0.5) * width,
        bins["counted"].to_numpy(),
        width,
    )


def capability_of(subject: Subject, rows: pd.DataFrame, values: Spread, limit: Limit | None) -> Capability | None:
    """Capability against a limit. Short-term σ: of moving ranges, or within the subgroups that a point averages."""
    if limit is None:
        return None
    if subject.averaged:
        sigma, freedom = pooled_sigma(rows["variance"].to_numpy(float), rows["n"].to_numpy(float))
        return capability_from_moments(
            values.n,
            values.mean,
            values.sd,
            limit.lower,
            limit.upper,
            sigma_within=sigma,
            freedom_within=freedom,
        )
    return capability(rows["value"].to_numpy(float), limit.lower, limit.upper)


@dataclass(frozen=True)
class Event:
    """Something that changed just before the point `index`."""

    index: int
    text: str


def events(rows: pd.DataFrame) -> list[Event]:
    """Changes of rig calibration and of software version along a series."""
    found = []
    for column, word in (("rig_id", _("rig")), ("software_version", _("version"))):
        names = rows[column].astype("object").where(rows[column].notna(), None).tolist()
        for i in range(1, len(names)):
            if names[i] != names[i - 1] and names[i] is not None:
                said = str(names[i])
                found.append(Event(i, said if said.startswith(word) else f"{word} {said}"))
    return found


def options(archive: Archive, kind: str, panel: str, station: str) -> Sequence[str]:
    """Names that a subject of this kind can have."""
    if kind == FASTENER_TYPE:
        rows = archive.rows(
            f"SELECT {TYPE_SQL} AS name FROM rivets WHERE diameter_mm IS NOT NULL GROUP BY 1 ORDER BY 1"
        )
        return [f"{name:g}" for name in rows["name"]]
    named = BY_SUBJECT[kind]
    rows = archive.rows(
        f"SELECT DISTINCT {named.id_columns[0]} AS name FROM {named.table} WHERE panel = ? AND station = ? ORDER BY 1",
        [panel, station],
    )
    return [str(name) for name in rows["name"]]


PARETO = {
    N_("panel"): "panel",
    N_("cause"): "trim(regexp_extract(coalesce(reason, ''), '^[a-z ]+'))",
    N_("fastener type"): "CASE WHEN {type} IS NOT NULL THEN printf('%g mm', {type}) END",
    N_("station"): "station",
    N_("operator"): "operator",
    N_("aircraft"): "aircraft_serial",
}
"""What findings are counted by, and its SQL for a row; a cause is what a reason begins with."""


def outside_by(archive: Archive, selection: Selection, by: str) -> dict[str, int]:
    """Findings outside their limits on the newest scans, by what is alike in them; a stretch of a seam is one."""
    condition, parameters = selection.where()
    parts = []
    for kind in KINDS:
        one = f"coalesce(stretch, {kind.id_sql})" if kind.is_course else kind.id_sql
        named = PARETO[by].format(type=TYPE_SQL if kind is RIVET else "NULL::DOUBLE")
        parts.append(
            f"SELECT scene_id, '{kind.name}' AS kind, {one} AS finding, any_value({named}) AS name FROM {kind.table} "
            f"JOIN (SELECT scene_id, operator FROM latest_scenes WHERE {condition}) USING (scene_id) "
            f"WHERE {OUTSIDE_SQL} GROUP BY ALL"
        )
    rows = archive.rows(
        f"SELECT name, count(*) AS n FROM ({' UNION ALL '.join(parts)}) "
        f"WHERE name IS NOT NULL OR {by != FASTENER_TYPE} GROUP BY 1",
        parameters * len(KINDS),
    )
    names = ["" if pd.isna(name) else str(name) for name in rows["name"]]
    return dict(zip(names, rows["n"].astype(int), strict=True))


def layout(archive: Archive, panel: str, quantity: Quantity, selection: Selection, standard: Standard) -> pd.DataFrame:
    """Each feature of a panel with its place, mean, standard deviation and share outside its limits.

    Places are in the panel's frame where its pattern was recognised, else pixels of each station's picture, the
    stations side by side.
    """
    values, parameters = _values(Subject("panel", panel), quantity, selection, standard)
    column, *positions = quantity.kind.id_columns
    name = " || ' @ ' || ".join([column, *(f"round({position})::INT" for position in positions)])
    rows = archive.rows(
        f"SELECT station, {column} AS named, {name} AS name, avg(v) AS mean, stddev_samp(v) AS sd, count(v) AS n, "
        f"avg(({OUTSIDE_SQL})::INT) AS outside, "
        "median(x_panel_mm) AS x_panel, median(y_panel_mm) AS y_panel, median(u_px) AS u, median(v_px) AS v "
        f"FROM ({values}) GROUP BY ALL ORDER BY 1, 2",
        parameters,
    )
    registered = bool(len(rows)) and bool(rows["x_panel"].notna().all())
    if registered:
        rows["x"], rows["y"] = rows["x_panel"], rows["y_panel"]
    else:
        stations = {name: i for i, name in enumerate(sorted(rows["station"].unique()))}
        width = 1.15 * float(rows["u"].max()) if len(rows) else 1.0
        rows["x"] = rows["u"] + width * rows["station"].map(stations).astype(float)
        rows["y"] = -rows["v"]
    rows.attrs["registered"] = registered
    return rows


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")
