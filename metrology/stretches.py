"""A stretch of a course is one finding: consecutive positions beyond a limit, with their worst value and length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrology.kinds import Kind, Quantity
from metrology.limits import Limit, PanelSpec
from metrology.requirements import downstream_of, limit_of
from metrology.results import Decision, Feature, Severity
from metrology.verdicts import DECISIONS, OUTSIDE, SEVERITIES

_GAP = 1.5  # spacings between positions that are still next to each other


@dataclass(frozen=True)
class Stretch:
    """Consecutive positions of a course of which one quantity lies beyond a limit, or was not measured.

    Attributes
    ----------
    kind : Kind
    name : str
        Of the course.
    quantity : Quantity
    rows : tuple of Feature
        In their order.
    length_mm : float
    worst : Feature
        The position that is farthest beyond.
    decision : Decision
        The gravest.
    severity : Severity or None
    limit : Limit or None
        At the worst position.
    """

    kind: Kind
    name: str
    quantity: Quantity
    rows: tuple[Feature, ...]
    length_mm: float
    worst: Feature
    decision: Decision
    severity: Severity | None
    limit: Limit | None

    @property
    def from_mm(self) -> float:
        """Where it begins along the course."""
        return float(getattr(self.rows[0], self.kind.id_columns[1]))

    @property
    def to_mm(self) -> float:
        """Where it ends."""
        return float(getattr(self.rows[-1], self.kind.id_columns[1]))

    @property
    def feature_id(self) -> str:
        """Such as ``S1@24.0-88.0``."""
        return f"{self.name}@{self.from_mm:.1f}-{self.to_mm:.1f}"

    @property
    def said(self) -> str:
        """In one line."""
        where = f"{self.quantity.said} from {self.from_mm:.0f} to {self.to_mm:.0f} mm ({self.length_mm:.0f} mm)"
        value, u95 = getattr(self.worst, self.quantity.column), getattr(self.worst, self.quantity.u95_column)
        if value is None:
            return f"{where} not measured"
        at = getattr(self.worst, self.kind.id_columns[1])
        return f"{where}, worst {value:+.3f} ± {u95:.3f} {self.quantity.unit} at {at:.0f} mm, expected {self.limit}"


def stretches(kind: Kind, rows: Sequence[Feature], spec: PanelSpec) -> list[Stretch]:
    """The stretches of all courses of a kind, course by course, quantity by quantity."""
    name, position = kind.id_columns
    courses: dict[str, list[Feature]] = {}
    for row in sorted(rows, key=lambda row: getattr(row, position)):
        courses.setdefault(getattr(row, name), []).append(row)
    return [
        stretch
        for label, course in courses.items()
        for quantity in kind.quantities
        for stretch in _of_course(kind, label, course, quantity, spec)
    ]


def _of_course(kind: Kind, label: str, course: Sequence[Feature], quantity: Quantity, spec: PanelSpec) -> list[Stretch]:
    s = [float(getattr(row, kind.id_columns[1])) for row in course]
    spacing = float(np.median(np.diff(s))) if len(s) > 1 else 0.0
    judged = [_judged(row, quantity, spec) for row in course]
    found: list[list[int]] = []
    for k, (decision, _) in enumerate(judged):
        is_out, is_unknown = decision in OUTSIDE, decision == "not measured"
        if not (is_out or is_unknown):
            continue
        last = found[-1][-1] if found else None
        follows = last == k - 1 and s[k] - s[k - 1] < _GAP * spacing
        if follows and is_out == (judged[k - 1][0] in OUTSIDE):
            found[-1].append(k)
        else:
            found.append([k])
    return [_stretch(kind, label, course, quantity, judged, members, spacing) for members in found]


def _judged(row: Feature, quantity: Quantity, spec: PanelSpec) -> tuple[Decision, Limit | None]:
    limit = limit_of(spec.zone(row.zone), quantity, downstream_of(quantity, row))
    if limit is None or quantity.lacking(row):
        return "no limit", limit
    value, u95 = getattr(row, quantity.column), getattr(row, quantity.u95_column)
    if value is None or u95 is None:
        return "not measured", limit
    return limit.decision(value, u95), limit


def _stretch(
    kind: Kind, label: str, course: Sequence[Feature], quantity: Quantity,
    judged: Sequence[tuple[Decision, Limit | None]], members: Sequence[int], spacing: float,
) -> Stretch:  # fmt: skip
    def beyond(k: int) -> float:
        value, limit = getattr(course[k], quantity.column), judged[k][1]
        return -limit.margin(value) if value is not None and limit is not None else 0.0

    worst = max(members, key=beyond)
    value, limit = getattr(course[worst], quantity.column), judged[worst][1]
    first, last = (float(getattr(course[k], kind.id_columns[1])) for k in (members[0], members[-1]))
    colours: list[Severity] = [
        lim.severity(v)
        for k in members
        if (lim := judged[k][1]) is not None and (v := getattr(course[k], quantity.column)) is not None
    ]
    return Stretch(
        kind,
        label,
        quantity,
        tuple(course[k] for k in members),
        last - first + spacing,
        course[worst],
        min((judged[k][0] for k in members), key=list(DECISIONS).index),
        min(colours, key=list(SEVERITIES).index) if value is not None and colours else None,
        limit,
    )
