"""Found pieces of a seam on its nominal course: names, positions, the same sides all along, and the wind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.fits import FittedStation
from metrology.panel import Foot, NominalSeam, Placement, foot_on
from metrology.registration.rows import has_position, placed, positions
from metrology.results import SeamStation
from metrology.seams.sides import is_upright, oriented, towards_b

Array = NDArray[np.float64]

# Air that flows within this of a seam's direction crosses it neither way: the sine of 10°.
_ALONG_THE_SEAM = 0.17


@dataclass(frozen=True)
class _Piece:
    """A found piece of a seam.

    Attributes
    ----------
    stations : sequence of SeamStation
    measured : list of SeamStation
        Those with a place, k of them.
    foot : Foot
        Their feet on the nominal course.
    across : (k, 3) ndarray
        From side A to side B, rig frame.
    """

    stations: Sequence[SeamStation]
    measured: list[SeamStation]
    foot: Foot
    across: Array


def on_course(pieces: Sequence[Sequence[SeamStation]], seam: NominalSeam, placement: Placement) -> list[SeamStation]:
    """The stations of a seam's found pieces, by its name and with `s_mm` from its nominal start.

    A seam has the same sides all along: a piece whose own direction in the image says otherwise is turned.
    """
    found = [_piece(stations, seam, placement) for stations in pieces]
    if len(found) > 1:
        found = _with_same_sides(found, placement)
    return [row for piece in found for row in _named(piece, seam, placement)]


def _piece(stations: Sequence[SeamStation], seam: NominalSeam, placement: Placement) -> _Piece:
    measured = [station for station in stations if has_position(station)]
    foot = foot_on(seam.course, placement.to_panel(positions(measured)))
    across = _sides(measured, foot, placement)
    for k, station in enumerate(measured):
        if isinstance(station, FittedStation) and station.fit is not None:
            across[k] = station.fit.frame.axes[0]
    return _Piece(stations, measured, foot, across)


def _sides(measured: Sequence[SeamStation], foot: Foot, placement: Placement) -> Array:
    """(k, 3) from side A to side B, rig frame, for a seam of which these are the stations."""
    order = np.argsort(foot.s, kind="stable")
    course = np.array([(station.u_px, station.v_px) for station in measured])[order]
    forwards = (oriented(course)[0] == course[0]).all()
    growing = foot.tangent @ placement.R * (1.0 if forwards else -1.0)
    return towards_b(growing, positions(measured), is_upright(course))


def _with_same_sides(pieces: Sequence[_Piece], placement: Placement) -> list[_Piece]:
    measured = [station for piece in pieces for station in piece.measured]
    feet = Foot(*(np.concatenate([getattr(p.foot, name) for p in pieces]) for name in ("s", "offset", "tangent")))
    of_whole = np.split(_sides(measured, feet, placement), np.cumsum([len(p.measured) for p in pieces])[:-1])
    return [
        piece if (piece.across * across).sum() >= 0 else _turned(piece)
        for piece, across in zip(pieces, of_whole, strict=True)
    ]


def _turned(piece: _Piece) -> _Piece:
    """The piece with its sides exchanged."""
    turned = {id(station): exchanged(station) for station in piece.stations}
    return _Piece(
        [turned[id(s)] for s in piece.stations], [turned[id(s)] for s in piece.measured], piece.foot, -piece.across
    )


def exchanged(station: SeamStation) -> SeamStation:
    step = None if station.step_mm is None else -station.step_mm
    row = station.changed(step_mm=step, n_left=station.n_right, n_right=station.n_left)
    if isinstance(row, FittedStation) and row.fit is not None:
        return row.changed(fit=row.fit.exchanged())
    return row


def _named(piece: _Piece, seam: NominalSeam, placement: Placement) -> list[SeamStation]:
    own = np.array([station.s_mm for station in piece.measured])
    downstream = _b_is_downstream(piece, seam, placement)
    rows = {id(s): (float(x), sign) for s, x, sign in zip(piece.measured, piece.foot.s, downstream, strict=True)}
    named = []
    for station in piece.stations:
        s, sign = rows.get(id(station), (None, None))
        if s is None:
            s = _carried(station.s_mm, own, piece.foot.s)
        wind = None if station.step_mm is None or sign is None or sign == 0 else float(sign * station.step_mm)
        row = station.changed(seam_id=seam.seam_id, s_mm=s, zone=seam.zone_at(s), step_into_wind_mm=wind)
        named.append(placed(row, placement))
    return named


def _carried(s: float, own: Array, nominal: Array) -> float:
    """Nominal arc length of a station without position, from its neighbours' (the scan may count the other way)."""
    nearest = int(np.abs(own - s).argmin())
    reverse = len(own) > 1 and (nominal[-1] - nominal[0]) * (own[-1] - own[0]) < 0
    return float(nominal[nearest] + (own[nearest] - s if reverse else s - own[nearest]))


def _b_is_downstream(piece: _Piece, seam: NominalSeam, placement: Placement) -> Array:
    """(k,) +1 where side B lies downstream of side A, −1 where upstream, 0 where that cannot be told.

    A step with B downstream and higher faces the wind.
    """
    if seam.airflow is None:
        return np.zeros(len(piece.measured))
    tangent = piece.foot.tangent
    across = piece.across @ placement.R.T
    across -= (tangent * across).sum(1, keepdims=True) * tangent
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    component = across @ (np.array(seam.airflow) / np.linalg.norm(seam.airflow))
    return np.where(np.abs(component) > _ALONG_THE_SEAM, np.sign(component), 0.0)
