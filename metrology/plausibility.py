"""Which values are results: those that say something, and that the part can have.

A value whose expanded uncertainty is wider than its use says nothing, and one that no head or joint can have comes of
points that are none. Either is not measured, with the reason. What follows from the geometry alone is judged here; the
limits' part is in `metrology.tolerance`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from metrology.kinds import RIVET, SEAM_STATION, Kind, Quantity
from metrology.results import Decision, Feature, Rivet, SeamStation

Row = TypeVar("Row", bound=Feature)

# A head's height or the height of its rim known to no better than a tenth of its diameter (half a millimetre for the
# usual ones, several times any limit) says nothing about flushness.
_SHARE_OF_HEAD = 0.1
_TILT_U95_DEG = float(np.degrees(np.arctan(2 * _SHARE_OF_HEAD)))
# Beyond these a head has left its hole.
_MOST_HEIGHT = 0.5  # of the diameter
_MOST_TILT_DEG = 45.0
# Skins are one to three millimetres thick, gaps up to several wide.
_SEAM_U95_MM = 1.0
_MOST_STEP_MM = 20.0
_MOST_WIDTH_MM = 50.0
_HEIGHT, _TILT = RIVET.quantities
_STEP, _WIDTH = SEAM_STATION.quantities


def plausible_rivet(rivet: Rivet) -> Rivet:
    """The rivet without the values that are no results.

    Without its height nothing but the ellipse in the image is left: place, diameter and tilt come of the same surface.
    """
    if rivet.height_mean_mm is None or rivet.diameter_mm is None:
        return rivet
    widest, most = _SHARE_OF_HEAD * rivet.diameter_mm, _MOST_HEIGHT * rivet.diameter_mm
    if problem := _problem("height", "mm", rivet.height_mean_mm, rivet.height_u95_mm, widest, most):
        bare = without(without(rivet, _TILT, problem), _HEIGHT, problem)
        return replace(bare, x_mm=None, y_mm=None, z_mm=None, diameter_mm=None, rms_inner_mm=None)
    problem = _problem("tilt", "°", rivet.tilt_deg, rivet.tilt_u95_deg, _TILT_U95_DEG, _MOST_TILT_DEG)
    return without(rivet, _TILT, problem) if problem else rivet


def plausible_station(station: SeamStation) -> SeamStation:
    """The seam station without the values that are no results."""
    if problem := _problem("step", "mm", station.step_mm, station.step_u95_mm, _SEAM_U95_MM, _MOST_STEP_MM):
        station = without(station, _STEP, problem)
    if problem := _problem("width", "mm", station.width_mm, station.width_u95_mm, _SEAM_U95_MM, _MOST_WIDTH_MM):
        station = without(station, _WIDTH, problem)
    return station


def without(row: Row, quantity: Quantity, reason: str) -> Row:
    """A feature without a quantity, nor what rests on it."""
    nothing: dict[str, Any] = dict.fromkeys((quantity.column, quantity.u95_column, *quantity.rests_on_it))
    # Doubt about what something is outlives what was measured of it.
    decision: Decision = "unconfirmed" if row.decision == "unconfirmed" else "not measured"
    return replace(row, **nothing, decision=decision, reason=_with(row.reason, reason))


def unjudged(kind: Kind, row: Row) -> Row:
    """What may be no feature of the kind, with its place and size alone: the rest waits until a person confirms it."""
    names = [(q.column, q.u95_column, *q.rests_on_it) for q in kind.quantities]
    nothing: dict[str, Any] = dict.fromkeys(name for group in names for name in group)
    return replace(row, **nothing, severity=None)


def _problem(name: str, unit: str, value: float | None, u95: float | None, widest: float, most: float) -> str | None:
    """Why a value and its U95 are no result; neither is one that is not a number."""
    if value is None or u95 is None:
        return None
    if not u95 <= widest:
        return f"{name}: found U95 of {u95:.3g} {unit}, expected at most {widest:.3g} {unit}"
    if not abs(value) <= most:
        return f"{name}: found {value:+.3g} {unit}, expected at most {most:.3g} {unit} either way"
    return None


def _with(reason: str | None, more: str) -> str:
    return "; ".join(dict.fromkeys(part for part in (reason, more) if part))
