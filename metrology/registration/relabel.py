"""Rows of a recognised scan: the panel's ids, zones and coordinates, and rows for what is missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import Reconstruction
from metrology.panel import NominalRivet, NominalSeam, Placement, course_length, foot_on, points_along
from metrology.registration.rows import has_position, placed, positions
from metrology.registration.view import in_view
from metrology.results import Rivet, SeamStation
from metrology.rig import Rig

Array = NDArray[np.float64]

MISSING = "missing"
UNLISTED = "not in the panel's pattern"

_DIAMETER_TOLERANCE = 0.1  # of the nominal one; heads of neighbouring sizes differ by more

_COURSE_SAMPLE_MM = 2.0
# Air that flows within this of a seam's direction crosses it neither way: the sine of 10°.
_ALONG_THE_SEAM = 0.17


@dataclass(frozen=True)
class Recognised:
    """What is what.

    Attributes
    ----------
    placement : Placement
    rivets : mapping of int to NominalRivet
        By row of the scan's rivets.
    missing : sequence of NominalRivet
        Expected in view, not found.
    seams : mapping of str to NominalSeam
        By the scan's own seam id.
    missing_rows : bool
        Whether missing rivets become rows.
    """

    placement: Placement
    rivets: Mapping[int, NominalRivet]
    missing: Sequence[NominalRivet]
    seams: Mapping[str, NominalSeam]
    missing_rows: bool


def relabel_rivets(rivets: Sequence[Rivet], known: Recognised, reconstruction: Reconstruction) -> list[Rivet]:
    """The rivets by their nominal names, in the pattern's order of names; then missing ones if asked for, then others.

    Unlisted rivets are named X01, X02 … from top to bottom of the left image: their names are this scan's own.
    """
    listed, unlisted = [], []
    for row, rivet in enumerate(rivets):
        nominal = known.rivets.get(row)
        if nominal is None:
            unlisted.append(replace(placed(rivet, known.placement), reason=_joined(rivet.reason, UNLISTED)))
        else:
            reason = _joined(rivet.reason, _wrong_size(rivet, nominal))
            named = replace(rivet, rivet_id=nominal.rivet_id, zone=nominal.zone, reason=reason)
            listed.append(placed(named, known.placement))
    listed.sort(key=lambda rivet: rivet.rivet_id)
    unlisted.sort(key=lambda rivet: (rivet.v_px, rivet.u_px))
    extra = [replace(rivet, rivet_id=f"X{k:02d}") for k, rivet in enumerate(unlisted, 1)]
    missing = known.missing if known.missing_rows else ()
    return [*listed, *(_missing_rivet(nominal, known.placement, reconstruction) for nominal in missing), *extra]


def relabel_stations(
    stations: Sequence[SeamStation], known: Recognised, reconstruction: Reconstruction, layout: Sequence[NominalSeam],
    gap_mm: float,
) -> list[SeamStation]:  # fmt: skip
    """The stations by their nominal seams, `s_mm` from the nominal start, with a row for each stretch not found.

    Seams in no pattern are named XS01, XS02 …
    """
    rows: list[SeamStation] = []
    extra = 0
    for name in dict.fromkeys(station.seam_id for station in stations):
        piece = [station for station in stations if station.seam_id == name]
        seam = known.seams.get(name)
        if seam is None:
            extra += 1
            rows += [
                placed(
                    replace(station, seam_id=f"XS{extra:02d}", reason=_joined(station.reason, UNLISTED)),
                    known.placement,
                )
                for station in piece
            ]
        else:
            rows += _on_course(piece, seam, known.placement)
    for seam in layout:
        found = np.array([row.s_mm for row in rows if row.seam_id == seam.seam_id])
        rows += _gaps(seam, found, known.placement, reconstruction.rig, gap_mm)
    return sorted(rows, key=lambda row: (row.seam_id, row.s_mm))


def _joined(reason: str | None, addition: str | None) -> str | None:
    return "; ".join(part for part in (reason, addition) if part) or None


def _wrong_size(rivet: Rivet, nominal: NominalRivet) -> str | None:
    """What is to be said of a head whose diameter is not the nominal one."""
    if rivet.diameter_mm is None or nominal.diameter_mm is None:
        return None
    if abs(rivet.diameter_mm / nominal.diameter_mm - 1) <= _DIAMETER_TOLERANCE:
        return None
    return f"diameter {rivet.diameter_mm:.1f} mm, expected {nominal.diameter_mm:.1f} mm"


def _missing_rivet(nominal: NominalRivet, placement: Placement, reconstruction: Reconstruction) -> Rivet:
    """A row where a rivet should be: its place is the nominal one, so that the operator can be shown it."""
    left, right = reconstruction.rig.left, reconstruction.rig.right
    position = placement.to_rig(nominal.position)
    (u, v), (u_right, v_right) = left.project(position), right.project(position)
    size = (nominal.diameter_mm or 0.0) * left.K[0, 0] / position[2]
    there = _measured_share(reconstruction, u, v, max(size / 2, 5.0))
    why = "no head found where the pattern has one" if there > 0.5 else "the skin was not measured there"
    row = Rivet(
        rivet_id=nominal.rivet_id,
        x_mm=float(position[0]),
        y_mm=float(position[1]),
        z_mm=float(position[2]),
        u_px=float(u),
        v_px=float(v),
        u_right_px=float(u_right),
        v_right_px=float(v_right),
        diameter_mm=nominal.diameter_mm,
        major_px=float(size),
        minor_px=float(size),
        angle_deg=0.0,
        confidence=0.0,
        reason=f"{MISSING}: {why}",
        zone=nominal.zone,
    )
    return placed(row, placement)


def _measured_share(reconstruction: Reconstruction, u: float, v: float, reach: float) -> float:
    """Share of the left pixels within `reach` of (u, v) that have a point."""
    row, column, r = round(v), round(u), int(np.ceil(reach))
    depth = reconstruction.points[max(0, row - r) : row + r + 1, max(0, column - r) : column + r + 1, 2]
    return float(np.isfinite(depth).mean()) if depth.size else 0.0


def _on_course(piece: Sequence[SeamStation], seam: NominalSeam, placement: Placement) -> list[SeamStation]:
    """One found piece of a seam on its nominal course."""
    measured = [station for station in piece if has_position(station)]
    at = placement.to_panel(positions(measured))
    foot = foot_on(seam.course, at)
    own = np.array([station.s_mm for station in measured])
    downstream = _b_is_downstream(piece, at, foot.tangent, seam, placement)
    rows = {id(s): (float(x), sign) for s, x, sign in zip(measured, foot.s, downstream, strict=True)}
    named = []
    for station in piece:
        s, sign = rows.get(id(station), (None, None))
        if s is None:
            s = _carried(station.s_mm, own, foot.s)
        wind = None if station.step_mm is None or sign is None or sign == 0 else float(sign * station.step_mm)
        row = replace(station, seam_id=seam.seam_id, s_mm=s, zone=seam.zone, step_into_wind_mm=wind)
        named.append(placed(row, placement))
    return named


def _carried(s: float, own: Array, nominal: Array) -> float:
    """Nominal arc length of a station without position, from its neighbours' (the scan may count the other way)."""
    nearest = int(np.abs(own - s).argmin())
    reverse = len(own) > 1 and (nominal[-1] - nominal[0]) * (own[-1] - own[0]) < 0
    return float(nominal[nearest] + (own[nearest] - s if reverse else s - own[nearest]))


def _b_is_downstream(
    piece: Sequence[SeamStation], at: Array, tangent: Array, seam: NominalSeam, placement: Placement
) -> NDArray[np.float64]:
    """(k,) +1 where side B lies downstream of side A, −1 where upstream, 0 where that cannot be told.

    Side A is at the smaller u for a seam nearer to vertical in the left image, at the smaller v otherwise; a step
    with B downstream and higher faces the wind.
    """
    if seam.airflow is None:
        return np.zeros(len(at))
    ordered = sorted(piece, key=lambda station: station.s_mm)
    chord_u, chord_v = ordered[-1].u_px - ordered[0].u_px, ordered[-1].v_px - ordered[0].v_px
    upright = abs(chord_v) >= abs(chord_u)
    towards_b = placement.R @ (np.array([1.0, 0.0, 0.0]) if upright else np.array([0.0, 1.0, 0.0]))
    across = towards_b - (tangent @ towards_b)[:, None] * tangent
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    flow = np.array(seam.airflow) / np.linalg.norm(seam.airflow)
    component = across @ flow
    return np.where(np.abs(component) > _ALONG_THE_SEAM, np.sign(component), 0.0)


def _gaps(seam: NominalSeam, found: Array, placement: Placement, rig: Rig, gap_mm: float) -> list[SeamStation]:
    """A row in the middle of each stretch of a nominal seam that is in view and was not found."""
    s = np.arange(_COURSE_SAMPLE_MM / 2, course_length(seam.course), _COURSE_SAMPLE_MM)
    points = points_along(seam.course, s)
    absent = in_view(rig, placement.to_rig(points))
    if len(found):
        absent &= np.abs(s[:, None] - found).min(1) > gap_mm / 2
    edges = np.flatnonzero(np.diff(np.concatenate([[0], absent.astype(int), [0]])))
    rows = []
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        length = (stop - start) * _COURSE_SAMPLE_MM
        if length < gap_mm:
            continue
        middle = (start + stop - 1) // 2
        position = placement.to_rig(points[middle])
        u, v = rig.left.project(position)
        row = SeamStation(
            seam_id=seam.seam_id,
            s_mm=float(s[middle]),
            x_mm=float(position[0]),
            y_mm=float(position[1]),
            z_mm=float(position[2]),
            u_px=float(u),
            v_px=float(v),
            reason=f"{MISSING}: the seam was not found over {length:.0f} mm",
            zone=seam.zone,
        )
        rows.append(placed(row, placement))
    return rows
