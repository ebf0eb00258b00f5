"""AS9102 form 3, characteristic accountability: workbook and CSV, and the ballooned map that its numbers are on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from metrology.limits import Limit
from metrology.verdicts import OUTSIDE
from storage.documents import utc_text
from storage.export.balloons import ballooned_map
from storage.export.delimited import write_delimited
from storage.export.formats import Place
from storage.export.subject import Characteristic, ExportedScene, Subject
from storage.export.traceability import traceability_sheet
from storage.export.workbook import Sheet, SheetColumn, write_workbook


@dataclass(frozen=True)
class Field:
    """A column of the form."""

    head: str
    """With the number of the field where the form has one."""
    of: Callable[[Characteristic], object]
    """What goes there, of a characteristic."""
    meaning: str
    """For the documentation."""


def requirement(limit: Limit | None, unit: str) -> str:
    """A limit in words; none where the specification asks for nothing."""
    if limit is None:
        return "no limit"
    lower, upper = (None if bound is None else f"{bound:g}" for bound in (limit.lower, limit.upper))
    if lower is None:
        return f"at most {upper} {unit}"
    return f"at least {lower} {unit}" if upper is None else f"from {lower} to {upper} {unit}"


def _place(c: Characteristic) -> str:
    x, y, z = (c.row[f"{axis}_panel_mm"] for axis in "xyz")
    where = "" if x is None else f", panel x {x:.1f} y {y:.1f} z {z:.1f} mm"
    return f"{c.scene.row['station']} {c.kind.name} {c.feature}{where}"


def _source(c: Characteristic) -> str:
    return "" if c.limit is None else " ".join(part for part in (c.limit.source, c.limit.revision) if part)


FORM_3 = (
    Field("5 Char. No.", lambda c: c.number, "number on the ballooned map"),
    Field(
        "6 Reference Location",
        _place,
        "station, kind and id of the feature or stretch, its (worst) place in the panel's frame",
    ),
    Field("7 Characteristic Designator", lambda c: c.quantity.title, "the quantity"),
    Field("8 Requirement", lambda c: requirement(c.limit, c.quantity.unit), "the limit that it was judged by"),
    Field("Lower", lambda c: c.limit.lower if c.limit else None, "lower limit, a number"),
    Field("Upper", lambda c: c.limit.upper if c.limit else None, "upper limit, a number"),
    Field("9 Results", lambda c: c.value, "measured value, a number; empty where it was not measured"),
    Field("Unit", lambda c: c.quantity.unit, "of limits, result and U95"),
    Field("U95", lambda c: c.u95, "expanded uncertainty (95 %) of the result"),
    Field("Verdict", lambda c: c.decision, "by ISO 14253-1, of this quantity"),
    Field("10 Designed / Qualified Tooling", lambda c: c.scene.row["rig_id"], "rig (calibration)"),
    Field("Program", lambda c: f"Flushline {c.scene.row['software_version'] or ''}".strip(), "program and version"),
    Field("Program Revision", lambda c: c.scene.row["config_hash"], "names settings and specification"),
    Field("Source of Limit", _source, "document and revision that the limit comes from"),
    Field("Date", lambda c: c.scene.row["captured_at"], "when the scan was taken (UTC)"),
    Field("Feature Verdict", lambda c: c.row["decision"], "of the whole feature, the fastener's size included"),
    Field("14 Comments", lambda c: c.row["reason"], "why it does not pass, or was not measured"),
)
"""What goes where; field 11, the non-conformance, follows from all quantities of a feature."""
NONCONFORMANCE = "11 Nonconformance Number"


def write(subject: Subject, place: Place) -> list[Path]:
    """Form 3 as a workbook and as CSV, and the map."""
    heads = [*(field.head for field in FORM_3), NONCONFORMANCE]
    rows = list(_rows(subject))
    book, text, drawing = place.file("-as9102.xlsx"), place.file("-as9102.csv"), place.file("-as9102-balloons.svg")
    units = {"9 Results": "mm", "U95": "mm", "Lower": "mm", "Upper": "mm"}
    columns = [SheetColumn(head, units.get(head, "")) for head in heads]
    newest = max(scene.row["captured_at"] for scene in subject.scenes)
    form = Sheet("Form 3", columns, rows, _head(subject))
    write_workbook(book, [form, traceability_sheet(subject, place.store)], newest)
    write_delimited(text, heads, rows, place.decimal)
    drawing.write_text(ballooned_map(subject, place.store), encoding="utf-8")
    return [book, text, drawing]


def _head(subject: Subject) -> list[tuple[object, ...]]:
    specs = dict.fromkeys(scene.row["panel_spec"] or "" for scene in subject.scenes)
    operators = dict.fromkeys(scene.row["operator"] or "" for scene in subject.scenes)
    return [
        ("AS9102 Form 3: Characteristic Accountability, Verification and Compatibility Evaluation",),
        ("1 Part Number", subject.panel, "2 Part Name", "; ".join(filter(None, specs))),
        ("3 Serial Number", subject.aircraft_serial, "4 FAIR Identifier", subject.name),
        ("12 Prepared By", "; ".join(filter(None, operators)), "Scans", "; ".join(map(_scan, subject.scenes))),
        (),
    ]


def _scan(scene: ExportedScene) -> str:
    row = scene.row
    return f"{row['station']} {utc_text(row['captured_at'])}"


def _rows(subject: Subject) -> Iterator[list[object]]:
    for _, group in groupby(subject.lines, key=lambda c: (c.scene.scene_id, c.kind.name, c.feature)):
        feature = list(group)
        outside = [c.decision in OUTSIDE for c in feature]
        # What fails as a whole (another fastener than the pattern's) fails by none of its quantities.
        if not any(outside) and feature[0].row["decision"] in OUTSIDE:
            outside[0] = True
        for c, fails in zip(feature, outside, strict=True):
            finding = f"{c.scene.scene_id}/{c.feature}" if fails else None
            yield [*(field.of(c) for field in FORM_3), finding]
