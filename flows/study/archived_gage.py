"""Gage study of captured scans in the archive: operators × parts × trials, bias, linearity, stability, and the planner.

Words and limits are those of AIAG, Measurement Systems Analysis, 4th edition (2010), to which AS13100 refers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from flows.study.document import Bar, Cell, Column, Section, Table
from flows.study.folder import Finished, claim
from flows.study.gage_plan import QUANTITIES, GagePlan, Scanned, part_name, scanned, scans_of
from flows.study.gage_tables import Crossed, analysed, analysis_table, operators_figure, variation_table
from flows.study.report import write_report
from flows.study.values import interpolated, shared_places
from metrology.gage_bias import Bias, bias, linearity
from metrology.kinds import Kind, Quantity
from metrology.statistics import NELSON_RULES, individuals_chart, rule_violations
from storage.archive import Store
from storage.archive.bundle import document_hash

_LEAST_STABLE = 12  # scans of which a control chart says something
_LEAST_LINEAR = 5  # parts with a reference value that the manual asks for

Values = dict[str, dict[str, float]]
"""Value of each part in each scan, by part and scene."""


@dataclass(frozen=True)
class _Study:
    """A plan, what was scanned, and the values of each quantity."""

    plan: GagePlan
    found: Scanned
    values: Mapping[str, Values]


def run_archived(store: Store, plan: GagePlan, out: Path) -> Finished:
    """Write what the archive's scans say about the gage; incomplete studies say what is still to be scanned."""
    claim(out, "gage", document_hash(plan.model_dump(mode="json")))
    found = scanned(store, plan)
    values = {name: quantity_values(store, plan, *QUANTITIES[name]) for name in plan.quantities}
    study = _Study(plan, found, values)
    tables = [_crossed(study, name) for name in plan.quantities] if found.trials >= 2 else []
    sections = [_planner(study), *_variation(study, tables), *_references(study), *_stability(store, study)]
    lead = (
        f"Panel {plan.panel}; {len(plan.operators)} operators, {plan.trials} trials; scans of {store.root}, "
        f"analysed with Flushline {version('flushline')}.",
        "Terms and limits after AIAG, Measurement Systems Analysis, 4th edition, to which AS13100 refers.",
    )
    left = found.still(plan.trials)
    problems = (f"{len(left)} scans are still to be made; the report lists them",) if left else ()
    return Finished(write_report(out, plan.title, lead, sections), tuple(_bars(study, tables)), problems)


def quantity_values(store: Store, plan: GagePlan, kind: Kind, quantity: Quantity) -> Values:
    """Every measured value of a quantity in the plan's scans."""
    scans = {row["scene_id"]: row for row in scans_of(store, plan)}
    rows = store.query(f"SELECT * FROM {kind.table} WHERE panel = ?", [plan.panel]).to_pylist()
    rows = [row for row in rows if row["scene_id"] in scans and row["x_mm"] is not None]
    if kind.is_course:
        return _along(plan, kind, quantity, rows)
    values: Values = {}
    for row in rows:
        feature, value = kind.id_of(row), row[quantity.column]
        if value is not None and (not plan.parts or feature in plan.parts):
            part = part_name(plan, row["aircraft_serial"], row["station"], feature)
            values.setdefault(part, {})[row["scene_id"]] = value
    return values


def _along(plan: GagePlan, kind: Kind, quantity: Quantity, rows: Sequence[dict[str, Any]]) -> Values:
    """Values at places along each course that all its scans show."""
    name, position = kind.id_columns
    courses: dict[tuple[str, str, str], dict[str, list[tuple[dict[str, Any], float]]]] = {}
    for row in rows:
        if not plan.parts or row[name] in plan.parts:
            key = row["aircraft_serial"], row["station"], row[name]
            courses.setdefault(key, {}).setdefault(row["scene_id"], []).append((row, row[position]))
    values: Values = {}
    for (aircraft, station, course), scans in sorted(courses.items()):
        for stations in scans.values():
            stations.sort(key=lambda pair: pair[1])
        for at in shared_places(list(scans.values()), plan.positions):
            part = part_name(plan, aircraft, station, f"{course}@{at:.1f}")
            for scene, stations in scans.items():
                value, _ = interpolated(stations, at, quantity.column, quantity.u95_column)
                if value is not None:
                    values.setdefault(part, {})[scene] = value
    return values


def _crossed(study: _Study, name: str) -> Crossed:
    """A quantity's values as parts × operators × trials, of the trials that every cell has."""
    parts: list[str] = []
    rows: list[NDArray[np.float64]] = []
    for aircraft in study.plan.aircraft:
        for station in study.plan.stations:
            cells = [c for c in study.found.cells if (c.aircraft, c.station) == (aircraft, station)]
            scans = [cell.scans[: study.found.trials] for cell in cells]
            here = {scene for scenes in scans for scene in scenes}
            for part, values in study.values[name].items():
                if here & values.keys():
                    parts.append(part)
                    rows.append(np.array([[values.get(scene, np.nan) for scene in scenes] for scenes in scans]))
    table = np.array(rows).reshape(len(rows), len(study.plan.operators), study.found.trials)
    return analysed(name, QUANTITIES[name][1].unit, parts, table)


def _planner(study: _Study) -> Section:
    plan, found = study.plan, study.found
    columns = (
        Column("aircraft"), Column("station"), Column("operator"), Column("scanned", 0), Column("still to scan", 0),
        Column("not counted", 0),
    )  # fmt: skip
    rows: list[list[Cell]] = [
        [c.aircraft, c.station, c.operator, len(c.scans), plan.trials - len(c.scans), len(c.extra)] for c in found.cells
    ]
    tables = [Table("plan", "Scans of each operator", columns, rows)]
    if left := found.still(plan.trials):
        order: list[list[Cell]] = [[k, *names] for k, names in enumerate(left, 1)]
        heads = (Column("no.", 0), Column("operator"), Column("aircraft"), Column("station"))
        tables.append(Table("to-scan", "Still to scan, in this random order", heads, order))
    text = [
        f"{'Complete' if not left else f'{len(left)} scans are missing'}: each operator scans each station "
        f"{plan.trials} times, places the rig anew each time, and does not see earlier results. The earliest scans "
        "count."
    ]
    if left and found.trials >= 2:
        text.append(f"The figures below are of the {found.trials} trials that all operators have: preliminary.")
    elif left:
        text.append("Variation is analysed when every operator has two trials or more.")
    for name, count in found.others.items():
        said = f"operator {name!r}, whom the plan does not name" if name else "nobody: scene.json names no operator"
        text.append(f"{count} scans of these stations are by {said}; they do not count.")
    return Section("Plan", tuple(text), tuple(tables))


def _variation(study: _Study, tables: Sequence[Crossed]) -> list[Section]:
    if not tables:
        return []
    plan = study.plan
    text = [
        "Crossed study by analysis of variance with interaction; an interaction with p above 0.05 is pooled with the "
        "repeatability. Equipment variation (EV): the same operator and part. Appraiser variation (AV): between "
        "operators, with the interaction. %GRR of tolerance is 6 σ(GRR) over upper less lower limit."
    ]
    for table in tables:
        text += [_judged(table, plan)] if table.study else [f"{table.quantity}: fewer than two parts were measured."]
        if table.left_out:
            text.append(f"{table.quantity}: left out, as a scan did not measure them: {', '.join(table.left_out)}.")
        if table.study and len(table.parts) < 10:
            text.append(f"{table.quantity}: {len(table.parts)} parts; the manual recommends ten or more.")
    figures = tuple(operators_figure(table, plan.operators) for table in tables if table.study)
    return [
        Section("Variation", tuple(text), (variation_table(tables, plan.tolerance), analysis_table(tables)), figures)
    ]


def _judged(table: Crossed, plan: GagePlan) -> str:
    """The manual's words for a quantity's %GRR and ndc."""
    study = table.study
    assert study is not None
    tolerance = plan.tolerance.get(table.quantity)
    share = study.percent_of_variation if tolerance is None else study.percent_of_tolerance(tolerance)
    of = "variation" if tolerance is None else "tolerance"
    if share <= plan.acceptable_percent:
        said = "an acceptable measurement system"
    elif share <= plan.conditional_percent:
        said = "may be acceptable for some applications, by agreement with the customer"
    else:
        said = "not acceptable"
    ndc = study.distinct_categories
    if ndc is None:
        return f"{table.quantity}: {share:.1f} % of {of}: {said}."
    enough = "enough" if ndc >= plan.least_categories else f"fewer than {plan.least_categories}"
    return f"{table.quantity}: {share:.1f} % of {of}: {said}; ndc {ndc}, {enough}."


def _bars(study: _Study, tables: Sequence[Crossed]) -> list[Bar]:
    plan = study.plan
    return [
        Bar(f"%GRR of tolerance, {t.quantity}", t.study.percent_of_tolerance(tolerance), plan.acceptable_percent, "%")
        for t in tables
        if t.study and (tolerance := plan.tolerance.get(t.quantity))
    ]


def _references(study: _Study) -> list[Section]:
    """Bias of each part that is known otherwise, and linearity over them."""
    rows: list[list[Cell]] = []
    points: dict[str, list[tuple[float, float]]] = {}
    counted = {scene for cell in study.found.cells for scene in cell.scans}
    for known in study.plan.reference:
        of_part = study.values.get(known.quantity, {}).get(known.part, {})
        values = [value for scene, value in of_part.items() if scene in counted]
        if len(values) < 2:
            rows.append([known.part, known.quantity, known.value, len(values), *[None] * 4, "measured too seldom"])
            continue
        found = bias(values, known.value, known.u95)
        rows.append([known.part, known.quantity, known.value, found.n, found.bias, found.u95, found.t, found.p_value,
                     _of_bias(found)])  # fmt: skip
        points.setdefault(known.quantity, []).extend((known.value, value - known.value) for value in values)
    if not rows:
        return []
    columns = (
        Column("part"), Column("quantity"), Column("reference", 4), Column("n", 0), Column("bias", 4, sign=True),
        Column("± 95 %", 4), Column("t", 2), Column("p", 4), Column("judged"),
    )  # fmt: skip
    text = ("Deviation of the mean from the reference value; its 95 % interval holds the reference's own uncertainty.",)
    return [Section("Bias", text, (Table("bias", "Bias of each part", columns, rows),)), *_linearity(points)]


def _of_bias(found: Bias) -> str:
    return "not significant" if found.is_zero else "significant"


def _linearity(points: Mapping[str, Sequence[tuple[float, float]]]) -> list[Section]:
    columns = (
        Column("quantity"), Column("n", 0), Column("slope", 5, sign=True), Column("± 95 %", 5),
        Column("intercept", 5, sign=True), Column("± 95 %", 5), Column("R²", 3), Column("judged"),
    )  # fmt: skip
    rows: list[list[Cell]] = []
    text = ["Straight line of all deviations over the reference values. Acceptable where neither slope nor intercept "
            "is significant."]  # fmt: skip
    figures = []
    for quantity, of in points.items():
        x, y = (np.array(side) for side in zip(*of, strict=True))
        parts = len(np.unique(x))
        if parts < 2:
            text.append(f"{quantity}: one reference value; a line needs two or more.")
            continue
        f = linearity(x, y)
        judged = "acceptable" if f.is_linear else "slope or intercept is significant"
        rows.append([quantity, f.n, f.slope, f.slope_u95, f.intercept, f.intercept_u95, f.r_squared, judged])
        if parts < _LEAST_LINEAR:
            text.append(f"{quantity}: {parts} reference values; the manual asks for {_LEAST_LINEAR} or more.")
        ends = np.array([x.min(), x.max()])
        line = go.Scatter(x=ends, y=f.slope * ends + f.intercept, name="line")
        values = go.Scatter(x=x, y=y, mode="markers", name="deviation", marker={"size": 5})
        titles = {"xaxis_title": "reference", "yaxis_title": "deviation"}
        figures.append(go.Figure([values, line]).update_layout(title=quantity, height=320, **titles))
    return [Section("Linearity", tuple(text), (Table("linearity", "Linearity", columns, rows),), tuple(figures))]


def _stability(store: Store, study: _Study) -> list[Section]:
    """Control chart of each quantity: the mean deviation of a scan's parts from their own means, scan by scan."""
    order = [row["scene_id"] for row in scans_of(store, study.plan)]
    rows: list[list[Cell]] = []
    figures = []
    for quantity, values in study.values.items():
        off = np.full((len(values), len(order)), np.nan)
        for k, of_part in enumerate(values.values()):
            mean = np.mean(list(of_part.values()))
            off[k] = [of_part.get(scene, np.nan) - mean for scene in order]
        seen = np.isfinite(off).any(axis=0)
        series = np.nanmean(off[:, seen], axis=0) if seen.any() else np.zeros(0)
        if len(series) < _LEAST_STABLE:
            rows.append([quantity, len(series), None, f"too few scans: a chart needs {_LEAST_STABLE} or more"])
            continue
        chart = individuals_chart(series)
        broken = rule_violations(chart, NELSON_RULES)
        named = ", ".join(
            f"rule {name} at scan {', '.join(str(int(p) + 1) for p in at)}" for name, at in broken.items()
        )
        rows.append([quantity, len(series), chart.sigma, named or "stable: no rule of Nelson's is broken"])
        scans = np.arange(1, len(series) + 1)
        figure = go.Figure(go.Scatter(x=scans, y=series, mode="lines+markers"))
        for level in (chart.lower, chart.centre, chart.upper):
            figure.add_hline(y=level)
        figures.append(figure.update_layout(title=f"{quantity}: mean deviation of each scan", height=300))
    columns = (Column("quantity"), Column("scans", 0), Column("σ", 5), Column("judged"))
    text = ("Individuals chart over the plan's scans in their order of time: the mean deviation of a scan's parts.",)
    return [Section("Stability", text, (Table("stability", "Stability", columns, rows),), tuple(figures))]
