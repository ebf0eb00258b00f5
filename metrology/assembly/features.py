"""Every physical feature of a panel once, from the rows of all scans that saw it.

A kind of feature needs nothing of its own here: quantities, names and size come from its declaration. Values of several
scans are combined by their uncertainties. Scans of one rig share its errors, so the combination claims no smaller U95
than the best scan; where scans differ by more than they should, it is widened by Birge's ratio.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from metrology.arrays import Array
from metrology.kinds import Kind, Quantity
from metrology.registration.rows import has_position
from metrology.results import COVERAGE_95, Feature

LEAST_REACH_MM = 1.0
"""Single features nearer than this are one, however small."""


@dataclass(frozen=True)
class Sighting:
    """A row of a scan, in the panel's frame."""

    scan: int
    """Number of the scan."""
    row: Feature
    """With panel coordinates."""
    place_u95_mm: float | None = None
    """U95 of its place, mm."""

    @property
    def place(self) -> Array:
        """(3,) in the panel's frame, mm."""
        row = self.row
        return np.array([row.x_panel_mm, row.y_panel_mm, row.z_panel_mm], float)


@dataclass(frozen=True)
class Difference:
    """What two scans say of one quantity of a feature."""

    quantity: Quantity
    scans: tuple[int, int]
    values: tuple[float, float]
    u95: float
    """Of the difference."""

    @property
    def beyond(self) -> bool:
        """Whether they differ by more than their uncertainties allow."""
        return abs(self.values[1] - self.values[0]) > self.u95


@dataclass(frozen=True)
class PanelFeature:
    """A physical feature of the panel."""

    kind: Kind
    part: int
    """Number of the part whose frame its place is in."""
    row: Feature
    """Its name, place and values, of all scans together."""
    best: int
    """The scan that measured it best."""
    seen_by: tuple[int, ...]
    measured_by: tuple[int, ...]
    """seen_by, measured_by: scans that found it, and those whose values are in it."""
    place_u95_mm: float | None
    differences: tuple[Difference, ...] = ()
    seen_as: tuple[str, ...] = ()
    """What the scans that found it call it."""
    side: float = 0.0
    """Of a course: positive where side B lies to the left of it for a viewer outside; 0 where unknown."""

    @property
    def name(self) -> str:
        """What it is called."""
        return str(getattr(self.row, self.kind.id_columns[0]))


def single_features(kind: Kind, part: int, sightings: Iterable[Sighting]) -> list[PanelFeature]:
    """The features of a kind that has no positions along something, each once."""
    groups: list[list[Sighting]] = []
    for sighting in sorted(sightings, key=lambda each: _rank(kind, each)):
        near = [group for group in groups if _is_same(kind, group, sighting)]
        if near:
            min(near, key=lambda group: np.linalg.norm(group[0].place - sighting.place)).append(sighting)
        else:
            groups.append([sighting])
    return [combined(kind, part, group) for group in groups]


def _is_same(kind: Kind, group: Sequence[Sighting], sighting: Sighting) -> bool:
    """Whether a row is of the feature that a group of rows is of: nearer than half its size, from another scan."""
    if any(each.scan == sighting.scan for each in group) or not has_position(sighting.row):
        return False
    sizes = [getattr(each.row, column) or 0.0 for column in kind.size for each in (group[0], sighting)]
    reach = max([LEAST_REACH_MM, *(size / 2 for size in sizes)])
    return bool(np.linalg.norm(group[0].place - sighting.place) < reach)


def _rank(kind: Kind, sighting: Sighting) -> tuple[bool, bool, bool, float]:
    """From the row that says most to the one that says least."""
    row, first = sighting.row, kind.quantities[0]
    u95 = getattr(row, first.u95_column)
    return row.is_missing, row.decision == "unconfirmed", u95 is None, u95 or 0.0


def combined(kind: Kind, part: int, sightings: Sequence[Sighting]) -> PanelFeature:
    """One feature from its rows; the row that says most gives what is not a value, such as its name."""
    best = min(sightings, key=lambda each: _rank(kind, each))
    found = [each for each in sightings if not each.row.is_missing] or [best]
    found = [each for each in found if each.row.is_found] or found
    row = best.row
    measured: set[int] = set()
    differences: list[Difference] = []
    for quantity in kind.quantities:
        known = [each for each in found if _value(each, quantity) is not None]
        measured |= {each.scan for each in known}
        if len(known) > 1:
            row = _with_mean(row, quantity, known)
            differences += _differences(quantity, best if best in known else known[0], known)
    place, u95 = _place(found)
    names = {each.scan: kind.id_of(each.row) for each in found if not each.row.is_missing}
    x, y, z = place
    return PanelFeature(
        kind,
        part,
        replace(row, x_panel_mm=x, y_panel_mm=y, z_panel_mm=z),
        best.scan,
        tuple(sorted(names)),
        tuple(sorted(measured)),
        u95,
        tuple(differences),
        tuple(names[scan] for scan in sorted(names)),
    )


def _value(sighting: Sighting, quantity: Quantity) -> tuple[float, float] | None:
    value, u95 = getattr(sighting.row, quantity.column), getattr(sighting.row, quantity.u95_column)
    return None if value is None or u95 is None else (float(value), float(u95))


def _with_mean(row: Feature, quantity: Quantity, known: Sequence[Sighting]) -> Feature:
    """The row with the weighted mean of a quantity and of what rests on it."""
    values, u95 = np.array([_value(each, quantity) for each in known], float).T
    weights = 1 / np.maximum(u95, 1e-9) ** 2
    mean = float((weights * values).sum() / weights.sum())
    birge = float(np.sqrt((weights * (values - mean) ** 2).sum() * COVERAGE_95**2 / (len(values) - 1)))
    spread = birge / float(np.sqrt(weights.sum()))
    changed: dict[str, Any] = {quantity.column: mean, quantity.u95_column: max(float(u95.min()), spread)}
    for column in quantity.rests_on_it:
        others = np.array([getattr(each.row, column) for each in known], float)
        if np.isfinite(others).all():
            changed[column] = float((weights * others).sum() / weights.sum())
    return replace(row, **changed)


def _differences(quantity: Quantity, best: Sighting, known: Sequence[Sighting]) -> list[Difference]:
    value, u95 = _value(best, quantity) or (0.0, 0.0)
    found = []
    for each in known:
        if each is not best and (other := _value(each, quantity)):
            found.append(
                Difference(quantity, (best.scan, each.scan), (value, other[0]), float(np.hypot(u95, other[1])))
            )
    return found


def _place(sightings: Sequence[Sighting]) -> tuple[tuple[float | None, float | None, float | None], float | None]:
    """Mean place by the places' uncertainties, which no combination makes smaller than the best."""
    placed = [each for each in sightings if each.row.x_panel_mm is not None]
    if not placed:
        return (None, None, None), None
    u95 = [each.place_u95_mm for each in placed if each.place_u95_mm is not None]
    weights = np.array([1 / max(each.place_u95_mm or 1.0, 1e-6) ** 2 for each in placed])
    x, y, z = (weights[:, None] * np.array([each.place for each in placed])).sum(0) / weights.sum()
    return (float(x), float(y), float(z)), min(u95, default=None)
