"""Rows of a recognised scan: the panel's ids, zones and coordinates, and rows for what is missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from metrology.arrays import Array
from metrology.cloud import Reconstruction
from metrology.panel import NominalRivet, NominalSeam, Placement, course_length, points_along
from metrology.registration.courses import on_course
from metrology.registration.rows import placed
from metrology.registration.view import in_view
from metrology.results import MISSING, Rivet, SeamStation
from metrology.rig import Rig

UNLISTED = "not in the panel's pattern"

_COURSE_SAMPLE_MM = 2.0


@dataclass(frozen=True)
class Recognised:
    """What is what."""

    placement: Placement
    rivets: Mapping[int, NominalRivet]
    """By row of the scan's rivets."""
    missing: Sequence[NominalRivet]
    """Expected in view, not found."""
    seams: Mapping[str, NominalSeam]
    """By the scan's own seam id."""
    missing_rows: bool
    """Whether missing rivets become rows."""


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
            named = replace(
                _confirmed(rivet), rivet_id=nominal.rivet_id, zone=nominal.zone, diameter_nominal_mm=nominal.diameter_mm
            )
            listed.append(placed(named, known.placement))
    listed.sort(key=lambda rivet: rivet.rivet_id)
    unlisted.sort(key=lambda rivet: (rivet.v_px, rivet.u_px))
    extra = [replace(rivet, rivet_id=f"X{k:02d}") for k, rivet in enumerate(unlisted, 1)]
    missing = known.missing if known.missing_rows else ()
    return [*listed, *(_missing_rivet(nominal, known.placement, reconstruction) for nominal in missing), *extra]


def _confirmed(rivet: Rivet) -> Rivet:
    """A ring in doubt where the pattern has a rivet is that rivet."""
    if rivet.decision != "unconfirmed":
        return rivet
    return replace(rivet, decision="not measured" if rivet.height_mean_mm is None else "no limit", reason=None)


def relabel_stations(
    stations: Sequence[SeamStation], known: Recognised, reconstruction: Reconstruction, layout: Sequence[NominalSeam],
    gap_mm: float,
) -> list[SeamStation]:  # fmt: skip
    """The stations by their nominal seams, `s_mm` from the nominal start, with a row for each stretch not found.

    Seams in no pattern are named XS01, XS02 …
    """
    rows: list[SeamStation] = []
    found: dict[str, list[Sequence[SeamStation]]] = {}
    extra = 0
    for name in dict.fromkeys(station.seam_id for station in stations):
        piece = [station for station in stations if station.seam_id == name]
        seam = known.seams.get(name)
        if seam is not None:
            found.setdefault(seam.seam_id, []).append(piece)
            continue
        extra += 1
        rows += [
            placed(
                replace(station, seam_id=f"XS{extra:02d}", reason=_joined(station.reason, UNLISTED)),
                known.placement,
            )
            for station in piece
        ]
    for seam in layout:
        of_seam = on_course(found.get(seam.seam_id, ()), seam, known.placement)
        places = np.array([row.s_mm for row in of_seam])
        rows += [*of_seam, *_gaps(seam, places, known.placement, reconstruction.rig, gap_mm)]
    return sorted(rows, key=lambda row: (row.seam_id, row.s_mm))


def _joined(reason: str | None, addition: str | None) -> str | None:
    return "; ".join(part for part in (reason, addition) if part) or None


def _missing_rivet(nominal: NominalRivet, placement: Placement, reconstruction: Reconstruction) -> Rivet:
    """A row where a rivet should be: its place is the nominal one, so that the operator can be shown it."""
    left, right = reconstruction.rig.left, reconstruction.rig.right
    position = placement.to_rig(nominal.position)
    u, v = left.project(position)
    u_right, v_right = (None, None) if right is None else map(float, right.project(position))
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
        u_right_px=u_right,
        v_right_px=v_right,
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
