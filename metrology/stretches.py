"""A stretch of a course is one finding: consecutive positions beyond a limit, with their worst value and length.

Positions within U95 of a limit, and those that were not measured, make stretches of their own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

from metrology.kinds import Kind, Quantity
from metrology.limits import Limit, PanelSpec
from metrology.requirements import downstream_of, limit_of
from metrology.results import Course, Decision, Feature, Severity
from metrology.verdicts import DECISIONS, IN_ORDER, OUTSIDE, SEVERITIES

Row = TypeVar("Row", bound=Course)
_GAP = 1.5  # spacings between positions that are still next to each other


@dataclass(frozen=True)
class Excess:
    """The worst of one quantity over a stretch: the position that is farthest beyond its limit."""

    quantity: Quantity
    row: Feature
    limit: Limit
    beyond: float
    """In the quantity's unit; negative inside."""

    @property
    def value(self) -> float:
        """Measured there."""
        return float(getattr(self.row, self.quantity.column))

    @property
    def u95(self) -> float | None:
        """Its expanded uncertainty."""
        u95: float | None = getattr(self.row, self.quantity.u95_column)
        return u95


@dataclass(frozen=True)
class Stretch:
    """Consecutive positions of a course that do not simply pass, for the same reason."""

    kind: Kind
    name: str
    """Of the course."""
    rows: tuple[Course, ...]
    """In their order, judged."""
    spacing_mm: float
    """Usual distance of the course's positions."""
    excesses: tuple[Excess, ...]
    """Of the quantities that lie beyond a limit or within U95 of one, the worst one first; none where nothing was
    measured."""

    @property
    def from_mm(self) -> float:
        """Where it begins along the course."""
        return self._at(self.rows[0])

    @property
    def to_mm(self) -> float:
        """Where it ends."""
        return self._at(self.rows[-1])

    @property
    def length_mm(self) -> float:
        """With half a spacing at both ends."""
        return self.to_mm - self.from_mm + self.spacing_mm

    @property
    def feature_id(self) -> str:
        """Such as ``S1@24.0-88.0``; of a single position its own."""
        single = self.kind.id_of(self.rows[0])
        return single if len(self.rows) == 1 else f"{single}-{self.to_mm:.1f}"

    @cached_property
    def decision(self) -> Decision:
        """The gravest."""
        return min((row.decision for row in self.rows), key=list(DECISIONS).index)

    @property
    def severity(self) -> Severity | None:
        """The gravest."""
        return min((row.severity for row in self.rows), key=list(SEVERITIES).index)

    @property
    def worst(self) -> Feature:
        """The position that is farthest beyond a limit."""
        return self.excesses[0].row if self.excesses else self.rows[0]

    @property
    def said(self) -> str:
        """In one line."""
        stretch = f"from {self.from_mm:.0f} to {self.to_mm:.0f} mm ({self.length_mm:.0f} mm)"
        where = stretch if len(self.rows) > 1 else f"at {self.from_mm:.0f} mm"
        if not self.excesses:
            return f"{where} {self.decision}" + (f": {self.rows[0].reason}" if self.rows[0].reason else "")
        return f"{where}: " + "; ".join(map(self._said, self.excesses))

    def _said(self, excess: Excess) -> str:
        quantity = excess.quantity
        u95 = "" if excess.u95 is None else f" ± {excess.u95:.3f}"
        return (
            f"worst {quantity.said} {excess.value:+.3f}{u95} {quantity.unit} at {self._at(excess.row):.0f} mm, "
            f"expected {excess.limit}"
        )

    def _at(self, row: Feature) -> float:
        return float(getattr(row, self.kind.id_columns[1]))


def stretches(kind: Kind, rows: Sequence[Course], spec: PanelSpec) -> list[Stretch]:
    """The stretches of all courses of a kind, course by course, of rows that are judged."""
    name, position = kind.id_columns
    courses: dict[str, list[Course]] = {}
    for row in sorted(rows, key=lambda row: getattr(row, position)):
        courses.setdefault(getattr(row, name), []).append(row)
    return [stretch for label, course in courses.items() for stretch in _of_course(kind, label, course, spec)]


def with_stretches(kind: Kind, rows: Sequence[Row], spec: PanelSpec) -> list[Row]:
    """Judged rows that name the stretch they are of, and say how far they lie beyond their limits."""
    named = {
        id(row): stretch.feature_id
        for stretch in stretches(kind, rows, spec)
        if len(stretch.rows) > 1
        for row in stretch.rows
    }
    return [
        row.changed(
            stretch=named.get(id(row)),
            beyond_mm=max((excess.beyond for excess in excesses(kind, row, spec)), default=None),
        )
        for row in rows
    ]


def _of_course(kind: Kind, label: str, course: Sequence[Course], spec: PanelSpec) -> Iterator[Stretch]:
    s = [float(getattr(row, kind.id_columns[1])) for row in course]
    spacing = float(np.median(np.diff(s))) if len(s) > 1 else 0.0
    found: list[list[int]] = []
    for k, row in enumerate(course):
        if row.decision in IN_ORDER:
            continue
        follows = bool(found) and found[-1][-1] == k - 1 and s[k] - s[k - 1] < _GAP * spacing
        if follows and _reason_to_look(row) == _reason_to_look(course[k - 1]):
            found[-1].append(k)
        else:
            found.append([k])
    for members in found:
        rows = tuple(course[k] for k in members)
        yield Stretch(kind, label, rows, spacing, _worst(kind, rows, spec))


def _reason_to_look(row: Course) -> Decision:
    """Beyond a limit by more or by less than U95 is alike."""
    return OUTSIDE[0] if row.decision in OUTSIDE else row.decision


def _worst(kind: Kind, rows: Sequence[Course], spec: PanelSpec) -> tuple[Excess, ...]:
    """The worst of each quantity that keeps rows from passing."""
    worst: dict[str, Excess] = {}
    for excess in (excess for row in rows for excess in excesses(kind, row, spec)):
        name = excess.quantity.name
        does_not_pass = excess.u95 is None or excess.beyond > -excess.u95
        if does_not_pass and (name not in worst or excess.beyond > worst[name].beyond):
            worst[name] = excess
    return tuple(sorted(worst.values(), key=lambda excess: -excess.beyond))


def excesses(kind: Kind, row: Feature, spec: PanelSpec) -> Iterator[Excess]:
    """How far each quantity of a row that was measured lies beyond its limit."""
    for quantity in kind.quantities_of(row):
        limit = limit_of(spec.zone(row.zone), quantity, downstream_of(quantity, row))
        value = getattr(row, quantity.column)
        if limit is not None and value is not None:
            yield Excess(quantity, row, limit, -limit.margin(value))
