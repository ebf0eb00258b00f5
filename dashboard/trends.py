"""Series for the trend charts: one value per scan or aircraft in the order of time, and how all values are spread."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from dashboard.data import Archive
from dashboard.findings import Selection
from metrology.statistics import Capability, capability, capability_from_moments, pooled_sigma
from metrology.tolerance import Limit
from storage.archive.views import TAKEN_AT

_BINS = 60


@dataclass(frozen=True)
class Quantity:
    """A measured quantity: its table and column, its unit and the name of its limit."""

    table: str
    column: str
    title: str
    unit: str
    limit: str

    @property
    def measured(self) -> str:
        """SQL for the value; what is not finite is not a measurement."""
        return f"CASE WHEN isfinite({self.column}) THEN {self.column} END"


QUANTITIES = {
    "height": Quantity("rivets", "height_mean_mm", "Rivet height", "mm", "height_mm"),
    "tilt": Quantity("rivets", "tilt_deg", "Rivet tilt", "°", "tilt_deg"),
    "step": Quantity("seam_stations", "step_mm", "Seam step", "mm", "step_mm"),
    "width": Quantity("seam_stations", "width_mm", "Seam width", "mm", "width_mm"),
}
FASTENER_TYPE = "fastener type"
SUBJECTS = {
    "rivet": ("height", "tilt"),
    "seam": ("step", "width"),
    "panel": ("height", "tilt", "step", "width"),
    FASTENER_TYPE: ("height", "tilt"),
}
"""What a trend is about, and the quantities that fit."""
TYPE_SQL = "round(diameter_mm * 2) / 2"
"""A fastener type is told by its head's diameter, to half a millimetre."""


@dataclass(frozen=True)
class Subject:
    """What a trend follows.

    Attributes
    ----------
    kind : "rivet", "seam", "panel" or "fastener type"
    panel, station : str
        Station only for rivets and seams.
    name : str
        Rivet or seam; the head's diameter in mm for a type.
    """

    kind: str
    panel: str = ""
    station: str = ""
    name: str = ""

    def where(self) -> tuple[str, list[Any]]:
        """SQL condition on the quantity's table."""
        if self.kind == FASTENER_TYPE:
            return f"{TYPE_SQL} = ?", [_number(self.name)]
        conditions, parameters = ["panel = ?"], list[Any]([self.panel])
        if self.kind in ("rivet", "seam"):
            column = "rivet_id" if self.kind == "rivet" else "seam_id"
            conditions += ["station = ?", f"{column} = ?"]
            parameters += [self.station, self.name]
        return " AND ".join(conditions), parameters

    @property
    def averaged(self) -> bool:
        """Whether a point of the series is a mean of many values."""
        return self.kind != "rivet"


def series(archive: Archive, subject: Subject, quantity: Quantity, selection: Selection) -> pd.DataFrame:
    """One row per scan (rivet, seam) or aircraft (panel, type), in the order of time.

    Columns: captured_at, value (mean), n (values in it), variance (of them), aircraft_serial, scene_id (the newest),
    rig_id, software_version.
    """
    condition, parameters = subject.where()
    limited, more = selection.where()
    by = "scene_id" if subject.kind in ("rivet", "seam") else "aircraft_serial"
    return archive.rows(
        "SELECT max(s.taken_at) AS captured_at, avg(q.v) AS value, count(q.v) AS n, "
        "var_samp(q.v) AS variance, any_value(q.aircraft_serial) AS aircraft_serial, max(q.scene_id) AS scene_id, "
        "arg_max(s.rig_id, s.taken_at) AS rig_id, arg_max(s.software_version, s.taken_at) AS software_version "
        f"FROM (SELECT *, {quantity.measured} AS v FROM {quantity.table} WHERE {condition}) q "
        f"JOIN (SELECT scene_id, {TAKEN_AT} AS taken_at, rig_id, software_version FROM scenes WHERE {limited}) s "
        "USING (scene_id) "
        f"GROUP BY q.{by} ORDER BY 1, 5",
        [*parameters, *more],
    )


@dataclass(frozen=True)
class Spread:
    """How single values are distributed.

    Attributes
    ----------
    n : int
    mean, sd : float
    centres, counts : (k,) ndarray
        Histogram.
    width : float
        Of a bin.
    """

    n: int
    mean: float
    sd: float
    centres: np.ndarray
    counts: np.ndarray
    width: float


def spread(archive: Archive, subject: Subject, quantity: Quantity, selection: Selection) -> Spread | None:
    """Distribution of all single values; None where there are fewer than two."""
    condition, parameters = subject.where()
    limited, more = selection.where()
    values = (
        f"SELECT {quantity.measured} AS v FROM {quantity.table} q "
        f"SEMI JOIN (SELECT scene_id FROM scenes WHERE {limited}) s USING (scene_id) "
        f"WHERE {condition} AND v IS NOT NULL"
    )
    known = [*more, *parameters]
    row = archive.rows(
        f"SELECT count(*) AS n, avg(v) AS mean, stddev_samp(v) AS sd, min(v) AS low, max(v) AS high FROM ({values})",
        known,
    ).iloc[0]
    if row["n"] < 2:
        return None
    bins_wanted = min(_BINS, 2 * np.ceil(np.cbrt(row["n"])))  # Rice's rule
    width = max(float((row["high"] - row["low"]) / bins_wanted), 1e-6)
    bins = archive.rows(
        f"SELECT floor(v / {width!r})::BIGINT AS bin, count(*) AS n FROM ({values}) GROUP BY 1 ORDER BY 1", known
    )
    return Spread(
        int(row["n"]),
        float(row["mean"]),
        float(row["sd"]),
        (bins["bin"].to_numpy(float) + 0.5) * width,
        bins["n"].to_numpy(),
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
    for column, word in (("rig_id", "rig"), ("software_version", "version")):
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
    table, column = ("rivets", "rivet_id") if kind == "rivet" else ("seam_stations", "seam_id")
    rows = archive.rows(
        f"SELECT DISTINCT {column} AS name FROM {table} WHERE panel = ? AND station = ? ORDER BY 1", [panel, station]
    )
    return [str(name) for name in rows["name"]]


def failing_panels(archive: Archive, selection: Selection) -> dict[str, int]:
    """Findings outside their limits on the newest scans, by panel."""
    condition, parameters = selection.where()
    rows = archive.rows(
        "SELECT panel, count(*) AS n FROM ("
        "SELECT scene_id, panel FROM rivets WHERE decision IN ('fail', 'conditional fail') UNION ALL "
        "SELECT scene_id, panel FROM seam_stations WHERE decision IN ('fail', 'conditional fail')) "
        f"SEMI JOIN (SELECT scene_id FROM latest_scenes WHERE {condition}) USING (scene_id) GROUP BY 1",
        parameters,
    )
    return dict(zip(rows["panel"].astype(str), rows["n"].astype(int), strict=True))


def layout(archive: Archive, panel: str, quantity: Quantity, selection: Selection) -> pd.DataFrame:
    """Each feature of a panel with its place, mean, standard deviation and share outside its limits.

    Places are in the panel's frame where its pattern was recognised, else pixels of each station's picture, the
    stations side by side.
    """
    limited, more = selection.where()
    name = "rivet_id" if quantity.table == "rivets" else "seam_id || ' @ ' || round(s_mm)::INT"
    rows = archive.rows(
        f"SELECT station, {name} AS name, avg({quantity.measured}) AS mean, "
        f"stddev_samp({quantity.measured}) AS sd, count({quantity.measured}) AS n, "
        "avg((decision IN ('fail', 'conditional fail'))::INT) AS outside, "
        "median(x_panel_mm) AS x_panel, median(y_panel_mm) AS y_panel, median(u_px) AS u, median(v_px) AS v "
        f"FROM {quantity.table} q SEMI JOIN (SELECT scene_id FROM scenes WHERE {limited}) s USING (scene_id) "
        "WHERE panel = ? GROUP BY ALL ORDER BY 1, 2",
        [*more, panel],
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
