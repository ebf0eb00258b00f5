"""One seam of an assembled panel along its whole length: step and gap, what they must meet, and the aircraft before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from dashboard.data import Archive
from dashboard.panels import PanelView
from metrology.arrays import Array
from metrology.errors import FlushlineError
from metrology.kinds import SEAM_STATION, Quantity
from metrology.requirements import Downstream, downstream_of, limit_of
from metrology.results import Severity
from metrology.tolerance import PanelSpec
from storage.archive.schema import PANEL_OF_KIND

_TABLE = PANEL_OF_KIND[SEAM_STATION.name].name
STEP, GAP = SEAM_STATION.quantities[:2]


@dataclass(frozen=True)
class Course:
    """What is drawn of one quantity of a seam; all arrays have shape (n,), NaN where nothing was measured."""

    quantity: Quantity
    values: Array
    u95: Array
    """values, u95: mm."""
    bounds: tuple[Array, Array, Array, Array]
    """Lower, upper, serious lower, serious upper limit at each place, mm; NaN where there is none."""
    severities: tuple[Severity | None, ...]
    """Of each value against its own limits; None where there are none, or nothing was measured."""
    before: Array
    """On the aircraft before, at its own places, mm."""


@dataclass(frozen=True)
class SeamCourse:
    """A seam of a panel."""

    name: str
    rows: pd.DataFrame
    """Of the panel's positions along it, in their order."""
    s_mm: Array
    """(n,) arc length of each position."""
    courses: tuple[Course, ...]
    into_wind: bool
    """Whether steps are drawn as the air meets them: + faces the wind."""
    downstream: Downstream
    """Whether side B lies downstream of side A."""
    stretches: tuple[tuple[float, float, str | None], ...]
    """From, to and severity of what does not simply pass."""
    before: str
    """Serial number of the aircraft before; "" where there is none."""
    before_s_mm: Array
    """(m,) arc length of its positions."""


def seam_names(view: PanelView) -> list[str]:
    """The seams of a panel."""
    return sorted(map(str, view.features[SEAM_STATION.name]["seam_id"].dropna().unique()))


def seam_course(archive: Archive, view: PanelView, name: str) -> SeamCourse:
    """A seam along its whole length."""
    rows = view.features[SEAM_STATION.name]
    rows = rows[rows["seam_id"] == name].sort_values("s_mm").reset_index(drop=True)
    signs = {downstream_of(STEP, row) for row in rows.to_dict("records")} - {0}
    downstream: Downstream = signs.pop() if len(signs) == 1 else 0
    before = _before(archive, view, name)
    try:
        spec = archive.specification(view.row.bundle_path)
    except FlushlineError:
        spec = None
    courses = tuple(_course(quantity, rows, before, spec, downstream) for quantity in (STEP, GAP))
    serial = str(before["aircraft_serial"].iloc[0]) if len(before) else ""
    return SeamCourse(
        name,
        rows,
        _numbers(rows, "s_mm"),
        courses,
        downstream != 0,
        downstream,
        _stretches(view, name),
        serial,
        _numbers(before, "s_mm"),
    )


def _stretches(view: PanelView, name: str) -> tuple[tuple[float, float, str | None], ...]:
    found = view.findings[(view.findings["feature_kind"] == SEAM_STATION.name) & view.findings["from_mm"].notna()]
    return tuple(
        (float(row.from_mm), float(row.to_mm), row.severity if isinstance(row.severity, str) else None)
        for row in found.itertuples()
        if str(row.feature_id).split("@")[0] == name
    )


def _before(archive: Archive, view: PanelView, name: str) -> pd.DataFrame:
    """The same seam on the newest other aircraft that was scanned before."""
    return archive.rows(
        f"SELECT aircraft_serial, s_mm, {STEP.column}, {GAP.column} FROM {_TABLE} "
        "WHERE (captured_at, scene_id) = (SELECT (captured_at, scene_id) FROM panels WHERE panel = ? "
        "AND aircraft_serial <> ? AND captured_at < ? ORDER BY captured_at DESC, scene_id LIMIT 1) "
        "AND seam_id = ? ORDER BY s_mm",
        [str(view.row.panel), str(view.row.aircraft_serial), view.row.captured_at.to_pydatetime(), name],
    )


def _course(
    quantity: Quantity, rows: pd.DataFrame, before: pd.DataFrame, spec: PanelSpec | None, downstream: Downstream
) -> Course:
    # As the air meets it, where that is known: a step is B above A, and faces the wind where B lies downstream.
    sign = -1.0 if quantity is STEP and downstream == -1 else 1.0
    values = _numbers(rows, quantity.column)
    bounds = np.full((4, len(rows)), np.nan)
    severities: list[Severity | None] = [None] * len(rows)
    for k, zone in enumerate(rows["zone"]):
        limit = None
        if spec is not None:
            named = spec.zone(None if pd.isna(zone) else str(zone))
            limit = limit_of(named, quantity, downstream if quantity.into_wind else 0)
        if limit is not None:
            bounds[:, k] = [np.nan if bound is None else bound for bound in limit.bounds]
            severities[k] = limit.severity(values[k]) if np.isfinite(values[k]) else None
    if sign < 0:
        bounds = -bounds[[1, 0, 3, 2]]
    lower, upper, serious_lower, serious_upper = bounds
    return Course(
        quantity, sign * values, _numbers(rows, quantity.u95_column), (lower, upper, serious_lower, serious_upper),
        tuple(severities), sign * _numbers(before, quantity.column),
    )  # fmt: skip


def _numbers(rows: pd.DataFrame, column: str) -> Array:
    values: Array = rows[column].to_numpy(float, na_value=np.nan)
    return np.where(np.isfinite(values), values, np.nan)
