"""What the store holds of a series, each value beside its truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from flows.study.series import RigKind, Scan, Series, known
from metrology.arrays import Array
from simulator.truth import TrueRivet, TrueSeam, Truth
from storage.archive import Store

Quantity = Literal["height", "step", "width"]

_SAME_SEAM_MM = 4.0  # a station farther than that from a seam's course is not of this seam
_SAME_PLACE_MM = 1.0  # seams end where a scan shows no more of them; this far within all scans see them
_REACH_MM = 4.0  # a position is measured where stations lie within that on both sides of it


@dataclass(frozen=True)
class Value:
    """One quantity of one feature in one scan."""

    series: str
    station: str
    """Placement and rig."""
    scan: int
    """Counted from 0 in each placement."""
    feature: str
    """Rivet, or seam and position."""
    quantity: Quantity
    true_mm: float
    measured_mm: float | None
    u95_mm: float | None
    """measured_mm, u95_mm: None where it was not found or not measured."""

    @property
    def error_mm(self) -> float:
        """Measured less true; NaN where not measured."""
        return np.nan if self.measured_mm is None else self.measured_mm - self.true_mm


def rivet_values(store: Store, series: Series, rig: RigKind) -> list[Value]:
    """The height of every visible rivet in every scan: of what was found nearest to it, within half its diameter."""
    values = []
    truths = _truths(series)
    for scan, rows in _rows(store, series, rig, "rivets"):
        for true in truths[scan.placement].rivets:
            if not true.visible:
                continue
            row = nearest(true, rows) or {}
            measured, u95 = row.get("height_mean_mm"), row.get("height_u95_mm")
            values.append(_value(scan, true.id, "height", true.height_mean_mm, measured, u95))
    return values


def nearest(true: TrueRivet, rows: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    """The row of a rivet, None where none lies on its head."""
    if not rows:
        return None
    distance = np.linalg.norm(_points(rows) - true.xyz_mm, axis=1)
    return rows[int(distance.argmin())] if distance.min() < true.diameter_mm / 2 else None


def found_rivets(
    store: Store, series: Series, rig: RigKind
) -> Iterator[tuple[Sequence[TrueRivet], list[dict[str, Any]]]]:
    """For every scan the true rivets and the rows of what was found, measured or not."""
    truths = _truths(series)
    for scan, rows in _rows(store, series, rig, "rivets", "confidence > 0"):
        yield truths[scan.placement].rivets, rows


def station_values(store: Store, series: Series, rig: RigKind) -> list[Value]:
    """Step and width at every station that was measured, against the truth at its own place."""
    values = []
    truths = _truths(series)
    for scan, rows in _rows(store, series, rig, "seam_stations"):
        for seam in truths[scan.placement].seams:
            course = _Course(seam)
            for row, at in course.on_it(rows):
                if not course.visible(at):
                    continue
                for quantity, true in course.truth(at).items():
                    measured, u95 = row[f"{quantity}_mm"], row[f"{quantity}_u95_mm"]
                    values.append(_value(scan, f"{seam.id} {row['s_mm']:.0f} mm", quantity, true, measured, u95))
    return values


def position_values(store: Store, series: Series, rig: RigKind, positions: int) -> list[Value]:
    """Step and width at fixed places of each seam, between the two stations beside each.

    Stations follow what a scan shows of the seam, so they lie elsewhere in every scan; the linear interpolation keeps
    the seam's own course from looking like scatter.
    """
    values = []
    truths = _truths(series)
    for scan, rows in _rows(store, series, rig, "seam_stations"):
        for seam in truths[scan.placement].seams:
            course = _Course(seam)
            stations = course.on_it(rows)
            for number, at in enumerate(course.positions(positions), start=1):
                for quantity, true in course.truth(at).items():
                    measured, u95 = between(stations, at, quantity)
                    values.append(_value(scan, f"{seam.id} position {number}", quantity, true, measured, u95))
    return values


class _Course:
    """A true seam as a line along which everything is a function of the arc length."""

    def __init__(self, seam: TrueSeam) -> None:
        self._points = np.array(seam.xyz_mm)
        self._arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self._points, axis=0), axis=1))])
        self._visible = np.array(seam.visible)
        self._true: dict[Quantity, list[float]] = {"step": seam.step_mm, "width": seam.width_mm}

    def on_it(self, rows: Sequence[dict[str, Any]]) -> list[tuple[dict[str, Any], float]]:
        """Rows that lie on the seam with their arc lengths, in their order along it."""
        placed = []
        for row, point in zip(rows, _points(rows), strict=True):
            at, distance = self._foot(point)
            if distance < _SAME_SEAM_MM:
                placed.append((row, at))
        return sorted(placed, key=lambda pair: pair[1])

    def visible(self, at: float) -> bool:
        """Whether the nearest station of the truth is visible."""
        return bool(self._visible[np.abs(self._arc - at).argmin()])

    def truth(self, at: float) -> dict[Quantity, float]:
        """Step and width there."""
        return {quantity: float(np.interp(at, self._arc, values)) for quantity, values in self._true.items()}

    def positions(self, number: int) -> list[float]:
        """Arc lengths of evenly spaced places within the visible part, its ends left out."""
        seen = self._arc[self._visible]
        share = (np.arange(number) + 0.5) / number
        return list(seen[0] + share * (seen[-1] - seen[0])) if len(seen) else []

    def _foot(self, point: Array) -> tuple[float, float]:
        """Arc length of the nearest point of the course, and the distance to it."""
        start, run = self._points[:-1], np.diff(self._points, axis=0)
        share = np.clip(((point - start) * run).sum(1) / (run**2).sum(1), 0, 1)
        distance = np.linalg.norm(start + share[:, None] * run - point, axis=1)
        k = int(distance.argmin())
        return float(self._arc[k] + share[k] * (self._arc[k + 1] - self._arc[k])), float(distance[k])


def between(
    stations: list[tuple[dict[str, Any], float]], at: float, quantity: Quantity
) -> tuple[float | None, float | None]:
    """Step or width at a place; see `interpolated`."""
    return interpolated(stations, at, f"{quantity}_mm", f"{quantity}_u95_mm")


def interpolated(
    stations: list[tuple[dict[str, Any], float]], at: float, column: str, u95_column: str
) -> tuple[float | None, float | None]:
    """A value at a place, linear between the measured stations beside it, with the larger U95 of the two.

    Parameters
    ----------
    stations : list of (row, arc length in mm)
        In their order along the seam.
    at : float
        Arc length, mm.
    """
    there = [(s, row) for row, s in stations if row[column] is not None and abs(s - at) <= _REACH_MM]
    before = [(s, row) for s, row in there if s <= at]
    after = [(s, row) for s, row in there if s > at]
    if not (before and after):
        return None, None
    (s0, row0), (s1, row1) = before[-1], after[0]
    share = (at - s0) / (s1 - s0)
    measured = (1 - share) * row0[column] + share * row1[column]
    spans = [row[u95_column] for row in (row0, row1)]
    return measured, None if None in spans else max(spans)


def shared_places(scans: Sequence[list[tuple[dict[str, Any], float]]], number: int) -> list[float]:
    """Arc lengths of evenly spaced places along what all scans show of a course; none where that is nothing.

    Parameters
    ----------
    scans : sequence of list of (row, arc length in mm)
        In their order along the course.
    """
    first = max(stations[0][1] for stations in scans) + _SAME_PLACE_MM
    last = min(stations[-1][1] for stations in scans) - _SAME_PLACE_MM
    return [first + (k + 0.5) / number * (last - first) for k in range(number)] if last > first else []


def grid(values: Sequence[Value], quantity: Quantity) -> tuple[list[str], Array, Array]:
    """Values of one quantity as a table, features in their order of appearance.

    Returns
    -------
    features : list of str
    true : (features,) ndarray
    measured : (features, scans) ndarray
        NaN where not measured; scans in the order of station and repeat.
    """
    asked = [value for value in values if value.quantity == quantity]
    features = list(dict.fromkeys(value.feature for value in asked))
    columns = {place: k for k, place in enumerate(dict.fromkeys((value.station, value.scan) for value in asked))}
    measured = np.full((len(features), len(columns)), np.nan)
    true = np.full(len(features), np.nan)
    row = {feature: k for k, feature in enumerate(features)}
    for value in asked:
        true[row[value.feature]] = value.true_mm
        if value.measured_mm is not None:
            measured[row[value.feature], columns[value.station, value.scan]] = value.measured_mm
    return features, true, measured


def _value(
    scan: Scan, feature: str, quantity: Quantity, true: float, measured: float | None, u95: float | None
) -> Value:
    return Value(scan.series.name, scan.key.station, scan.repeat, feature, quantity, true, measured, u95)


def _truths(series: Series) -> list[Truth]:
    simulation = series.simulation
    return [known(simulation, placement).truth for placement in range(len(simulation.placements))]


def _rows(
    store: Store, series: Series, rig: RigKind, table: str, which: str = "x_mm IS NOT NULL"
) -> Iterator[tuple[Scan, list[dict[str, Any]]]]:
    """Each scan of a series with its rows, by default those that have a place."""
    rows = store.query(f"SELECT * FROM {table} WHERE aircraft_serial = ? AND {which}", [series.name]).to_pylist()
    by_scene: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        by_scene.setdefault(row["scene_id"], []).append(row)
    for scan in series.scans(rig):
        yield scan, by_scene.get(scan.key.scene_id, [])


def _points(rows: Sequence[dict[str, Any]]) -> Array:
    return np.array([(row["x_mm"], row["y_mm"], row["z_mm"]) for row in rows], float).reshape(-1, 3)
