"""What changed between two assemblies of a panel: findings that are new, worse, better, gone or unchanged.

Features are the same where they lie at one place of one frame. Both assemblies are judged by the newer one's limits, so
what is new is new on the skin, and no other limit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from metrology.assembly.features import LEAST_REACH_MM
from metrology.assembly.rows import Change, ChangeRow, FindingRow
from metrology.kinds import BY_NAME, Kind, Quantity
from metrology.limits import PanelSpec
from metrology.results import Feature
from metrology.stretches import Excess, excesses
from metrology.verdicts import IN_ORDER, gravity

_SLACK_MM = 3.0  # positions of two assemblies along a course lie between each other


@dataclass(frozen=True)
class Snapshot:
    """What an assembly says."""

    frames: Mapping[int, str]
    """The name of each part's frame."""
    features: Mapping[str, Sequence[tuple[int, Feature]]]
    """Part and judged row, by the names of the kinds."""
    findings: Sequence[FindingRow]
    shows: Callable[[str, float, float], bool]
    """Whether skin was seen at a frame's x and y, mm."""

    def of(self, finding: FindingRow) -> tuple[str, list[Feature]]:
        """The frame and the rows of a finding."""
        kind = BY_NAME[finding.feature_kind]
        name = finding.feature_id.split("@")[0] if kind.is_course else finding.feature_id
        rows = [(part, row) for part, row in self.features[kind.name] if getattr(row, kind.id_columns[0]) == name]
        if kind.is_course:
            rows = [each for each in rows if _within(kind, each[1], finding, 0.05)]
        return (self.frames.get(rows[0][0], ""), [row for _, row in rows]) if rows else ("", [])

    def at(self, finding: FindingRow, frame: str, size_mm: float) -> list[Feature]:
        """The rows at the place of another assembly's finding."""
        kind = BY_NAME[finding.feature_kind]
        rows = [row for part, row in self.features[kind.name] if self.frames.get(part) == frame]
        if kind.is_course:
            name = finding.feature_id.split("@")[0]
            same = [row for row in rows if getattr(row, kind.id_columns[0]) == name]
            return [row for row in same if _within(kind, row, finding, _SLACK_MM)]
        placed = [row for row in rows if row.x_panel_mm is not None]
        if finding.x_panel_mm is None or not placed:
            return []
        place = np.array([finding.x_panel_mm, finding.y_panel_mm, finding.z_panel_mm], float)
        away = np.linalg.norm(np.array([_place(row) for row in placed], float) - place, axis=1)
        nearest = int(away.argmin())
        return [placed[nearest]] if away[nearest] < max(LEAST_REACH_MM, size_mm / 2) else []


def changes(now: Snapshot, before: Snapshot, spec: PanelSpec) -> list[ChangeRow]:
    """What of the findings of either is another one in the other.

    Parameters
    ----------
    spec : PanelSpec
        The limits that both were judged by.
    """
    found = []
    for finding in now.findings:
        frame, rows = now.of(finding)
        there = before.at(finding, frame, _size(finding, rows))
        found.append(_changed(finding, rows, there, before.shows, frame, spec))
    for finding in before.findings:
        frame, rows = before.of(finding)
        there = now.at(finding, frame, _size(finding, rows))
        if all(row.decision in IN_ORDER for row in there):
            found.append(_ended(finding, rows, there, now.shows, frame, spec))
    return found


def _changed(
    finding: FindingRow, rows: Sequence[Feature], before: Sequence[Feature], shown: Callable[[str, float, float], bool],
    frame: str, spec: PanelSpec,
) -> ChangeRow:  # fmt: skip
    """A finding of the newer assembly."""
    kind = BY_NAME[finding.feature_kind]
    worst, then = (_worst(kind, part, spec, finding.quantity) for part in (rows, before))
    was_one = any(row.decision not in IN_ORDER for row in before)
    change: Change = _compared(kind, finding, worst, then, before) if was_one else "new"
    seen = before or (finding.x_panel_mm is not None and shown(frame, finding.x_panel_mm, finding.y_panel_mm or 0.0))
    return _row(change, finding, rows, before, worst, then, None if seen else "not seen before")


def _ended(
    finding: FindingRow, rows: Sequence[Feature], now: Sequence[Feature], shown: Callable[[str, float, float], bool],
    frame: str, spec: PanelSpec,
) -> ChangeRow:  # fmt: skip
    """A finding of the older assembly where the newer one has none."""
    kind = BY_NAME[finding.feature_kind]
    seen = finding.x_panel_mm is not None and shown(frame, finding.x_panel_mm, finding.y_panel_mm or 0.0)
    is_gone = bool(now) or (seen and not kind.by_design)
    why = None if now else ("nothing is found there any more" if is_gone else "not found" if seen else "not seen")
    then, there = _worst(kind, rows, spec, finding.quantity), _worst(kind, now, spec, finding.quantity)
    return _row("gone" if is_gone else "not seen", finding, now, rows, there, then, why)


def _compared(
    kind: Kind, finding: FindingRow, now: Excess | None, then: Excess | None, before: Sequence[Feature]
) -> Change:
    """Which of the two is worse: by the values and their uncertainty or, where there are none, by the decisions."""
    if now and then and now.quantity.name == then.quantity.name and now.u95 is not None and then.u95 is not None:
        growth = now.beyond - then.beyond
        if abs(growth) <= float(np.hypot(now.u95, then.u95)):
            return "unchanged"
        return "worse" if growth > 0 else "better"
    was = min(gravity(row.decision) for row in before)
    rank = gravity(finding.decision)
    return "unchanged" if rank == was else "worse" if rank < was else "better"


def _worst(kind: Kind, rows: Sequence[Feature], spec: PanelSpec, quantity: str | None = None) -> Excess | None:
    """What lies farthest beyond a limit, of one quantity where that is asked for."""
    found = [each for row in rows for each in excesses(kind, row, spec) if quantity in (None, each.quantity.name)]
    return max(found, key=lambda each: each.beyond, default=None)


def _row(
    change: Change, finding: FindingRow, now: Sequence[Feature], before: Sequence[Feature], worst: Excess | None,
    then: Excess | None, why: str | None,
) -> ChangeRow:  # fmt: skip
    kind = BY_NAME[finding.feature_kind]
    named = worst.quantity.name if worst else then.quantity.name if then else finding.quantity
    quantity = next(q for q in kind.quantities if q.name == named)
    one, two = _value(worst, now, quantity), _value(then, before, quantity)
    both = None not in (*one, *two)
    return ChangeRow(
        finding.feature_kind, finding.feature_id, change, quantity.name, *one, *two,
        one[0] - two[0] if both else None,  # type: ignore[operator]
        float(np.hypot(one[1], two[1])) if both else None,  # type: ignore[arg-type]
        finding.from_mm, finding.to_mm, finding.x_panel_mm, finding.y_panel_mm, finding.z_panel_mm,
        _gravest(now), _gravest(before), why,
    )  # fmt: skip


def _value(worst: Excess | None, rows: Sequence[Feature], quantity: Quantity) -> tuple[float | None, float | None]:
    """Value and U95 of the worst row or, without limits, of the largest value."""
    if worst is not None and worst.quantity.name == quantity.name:
        return worst.value, worst.u95
    known = [row for row in rows if getattr(row, quantity.column) is not None]
    row = max(known, key=lambda row: abs(getattr(row, quantity.column)), default=None)
    return (None, None) if row is None else (getattr(row, quantity.column), getattr(row, quantity.u95_column))


def _gravest(rows: Sequence[Feature]) -> str | None:
    return min((row.decision for row in rows), key=gravity, default=None)


def _size(finding: FindingRow, rows: Sequence[Feature]) -> float:
    """The greatest extent of what was found, mm."""
    columns = BY_NAME[finding.feature_kind].size
    return max((float(getattr(row, column) or 0.0) for row in rows for column in columns), default=0.0)


def _within(kind: Kind, row: Feature, finding: FindingRow, slack: float) -> bool:
    if finding.from_mm is None or finding.to_mm is None:
        return False
    return bool(finding.from_mm - slack <= getattr(row, kind.id_columns[1]) <= finding.to_mm + slack)


def _place(row: Feature) -> tuple[float | None, float | None, float | None]:
    return row.x_panel_mm, row.y_panel_mm, row.z_panel_mm
