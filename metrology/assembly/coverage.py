"""What of a panel was measured, what was seen without being measured, and what nobody looked at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrology.assembly.assemble import Assembly
from metrology.assembly.panel import PanelFeatures
from metrology.assembly.rows import CoverageRow, State
from metrology.assembly.scan import PanelScan
from metrology.kinds import RIVET, SEAM_STATION
from metrology.panel import NominalRivet, NominalSeam, PanelLayout, Placement, course_length, foot_on, points_along
from metrology.registration.view import in_view
from metrology.results import Feature

_SAMPLE_MM = 2.0
_REACH_MM = 3.0  # a position of a seam is measured where one this near along it was
_CELL_MM = 5.0


@dataclass(frozen=True)
class Coverage:
    """How much of a panel is covered."""

    rows: tuple[CoverageRow, ...]
    """Of every nominal fastener and stretch of a seam; empty where no pattern says what there should be."""
    area_mm2: float
    """Skin that was measured."""
    next_station: str | None
    """Where to stand next; None where nothing is missing."""

    @property
    def gaps(self) -> list[str]:
        """What keeps the panel from being complete, in words."""
        return gaps_said([(row.feature_id, row.state) for row in self.rows])


def gaps_said(states: Sequence[tuple[str, str]]) -> list[str]:
    """What was not seen and what was not measured, in words, from ids and states."""
    said = []
    for state in ("not seen", "not measured"):
        names = [name for name, found in states if found == state]
        more = f" and {len(names) - 8} more" if len(names) > 8 else ""
        said += [f"{state}: {', '.join(names[:8])}{more}"] if names else []
    return said


def coverage(assembly: Assembly, features: PanelFeatures, layout: PanelLayout) -> Coverage:
    """Coverage by the specification's pattern."""
    nominal = [(assembly.scans[n], p) for k, n, p in assembly.placed() if assembly.parts[k - 1].nominal]
    rows = [_of_rivet(rivet, nominal, features) for rivet in layout.rivets]
    for seam in layout.seams:
        rows += _of_seam(seam, nominal, features)
    return Coverage(tuple(rows), measured_area(assembly), _next(rows, layout, nominal))


def _state(row: Feature | None, is_measured: bool, is_seen: bool) -> tuple[State, str | None]:
    if row is not None and is_measured:
        return "measured", None
    if row is not None:
        return "not measured", row.reason or "no value"
    return ("not measured", "in view, but not found") if is_seen else ("not seen", None)


def _of_rivet(
    rivet: NominalRivet, scans: Sequence[tuple[PanelScan, Placement]], features: PanelFeatures
) -> CoverageRow:
    found = next((f.row for f in features[RIVET.name] if f.name == rivet.rivet_id), None)
    place = np.array([rivet.position], float)
    seen = any(scan.sees(placement.to_rig(place))[0] for scan, placement in scans)
    value = None if found is None else getattr(found, RIVET.quantities[0].column)
    state, why = _state(found, value is not None, seen)
    return CoverageRow(RIVET.name, rivet.rivet_id, *rivet.position, state=state, reason=why)


def _of_seam(
    seam: NominalSeam, scans: Sequence[tuple[PanelScan, Placement]], features: PanelFeatures
) -> list[CoverageRow]:
    """Stretches of a nominal seam that are alike."""
    s = np.arange(_SAMPLE_MM / 2, course_length(seam.course), _SAMPLE_MM)
    points = points_along(seam.course, s)
    seen = np.zeros(len(s), bool)
    for scan, placement in scans:
        seen |= scan.sees(placement.to_rig(points))
    rows = [f.row for f in features[SEAM_STATION.name] if f.name == seam.seam_id and not f.row.is_missing]
    places = np.array([(row.x_panel_mm, row.y_panel_mm, row.z_panel_mm) for row in rows], float).reshape(-1, 3)
    along = foot_on(seam.course, places).s if len(rows) else np.empty(0)
    nearest = np.abs(s[:, None] - along).argmin(1) if len(rows) else np.zeros(len(s), int)
    near = np.abs(s - along[nearest]) < _REACH_MM if len(rows) else np.zeros(len(s), bool)
    states = []
    for k in range(len(s)):
        row = rows[nearest[k]] if near[k] else None
        value = None if row is None else getattr(row, SEAM_STATION.quantities[0].column)
        states.append(_state(row, value is not None, bool(seen[k])))
    starts = [k for k in range(len(s)) if k == 0 or states[k][0] != states[k - 1][0]]
    found = []
    for start, stop in zip(starts, [*starts[1:], len(s)], strict=True):
        x, y, z = points[(start + stop - 1) // 2]
        low, high = s[start] - _SAMPLE_MM / 2, s[stop - 1] + _SAMPLE_MM / 2
        found.append(
            CoverageRow(
                SEAM_STATION.name, f"{seam.seam_id}@{low:.0f}-{high:.0f}", float(x), float(y), float(z),
                from_mm=float(low), to_mm=float(high), state=states[start][0], reason=states[start][1],
            )
        )  # fmt: skip
    return found


def measured_area(assembly: Assembly) -> float:
    """Area of the skin that has points, mm², what several scans saw once; cells along the panel, with their slope."""
    total = 0.0
    for number in range(1, len(assembly.parts) + 1):
        cells: dict[tuple[int, int], float] = {}
        for part, k, placement in assembly.placed():
            if part != number:
                continue
            skin = assembly.scans[k].skin
            points = placement.to_panel(skin.points.reshape(-1, 3))
            normals = skin.normals.reshape(-1, 3) @ placement.R.T
            known = np.isfinite(points[:, 2]) & np.isfinite(normals[:, 2])
            found, first = np.unique(np.floor(points[known, :2] / _CELL_MM).astype(int), axis=0, return_index=True)
            slope = np.clip(np.abs(normals[known, 2][first]), 0.1, 1)
            cells |= dict(zip(map(tuple, found.tolist()), (_CELL_MM**2 / slope).tolist(), strict=True))
        total += sum(cells.values())
    return total


def _next(rows: Sequence[CoverageRow], layout: PanelLayout, scans: Sequence[tuple[PanelScan, Placement]]) -> str | None:
    """Which station to scan next: the specification's that shows most of what nobody saw, or a move of the last one."""
    unseen = np.array([(row.x_mm, row.y_mm, row.z_mm) for row in rows if row.state == "not seen"], float)
    if len(unseen) == 0 or not scans:
        return None
    there = {scan.key.station for scan, _ in scans}
    rig = scans[-1][0].rig
    shown = {
        name: int(in_view(rig, placement.to_rig(unseen)).sum())
        for name, placement in layout.stations.items()
        if name not in there
    }
    if shown and max(shown.values()) > 0:
        name = max(shown, key=lambda station: shown[station])
        return f"station {name}: shows {shown[name]} of {len(unseen)} that nobody saw"
    last, placement = max(scans, key=lambda each: each[0].key.captured_at)
    middle = placement.to_panel(last.skin.middle)
    reach = float(np.nanmax(np.linalg.norm(last.skin.points - last.skin.middle, axis=2)))
    nearest = unseen[np.linalg.norm(unseen - middle, axis=1).argmin()]
    group = unseen[np.linalg.norm(unseen - nearest, axis=1) < reach]
    move = group.mean(0) - middle
    return (
        f"as for {last.key.station}, moved by {move[0]:+.0f} mm in x, {move[1]:+.0f} mm in y, {move[2]:+.0f} mm in z "
        f"of the panel's frame: shows about {len(group)} of {len(unseen)} that nobody saw"
    )
