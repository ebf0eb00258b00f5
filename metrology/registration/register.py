"""Recognising a scan in its panel's pattern.

The placement of the rig is searched among all ways in which pairs of found rivets can be pairs of the nominal pattern
(`search`), refined by a robust rigid fit on rivets, skin directions and seams (`fit`), and the most probable one is
taken (`hypothesis`). Its log-probability counts expected rivets that were not found, found ones that nobody expected,
how far each lies from its nominal place, and how far the rig would have moved from the station's nominal placement:
that last term resolves patterns that look alike after a turn or a shift.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from metrology.arrays import Array
from metrology.cloud import Reconstruction
from metrology.fastener import size_verdict
from metrology.kinds import DEFECT, HOLE, RIVET, SEAM_STATION
from metrology.panel import NominalRivet, PanelLayout, Placement
from metrology.registration.hypothesis import Hypothesis, Matcher, Scan
from metrology.registration.openings import explained, missing_fasteners
from metrology.registration.relabel import Recognised, relabel_rivets, relabel_stations
from metrology.registration.rows import has_position, placed, positions
from metrology.registration.search import PointPattern, estimated_normals, motion
from metrology.registration.settings import RegistrationSettings
from metrology.registration.zones import in_nearest_zone
from metrology.results import Features, Hole, Rivet, SeamStation, of_type
from metrology.skin_normal import skin_normal

Status = Literal["recognised", "enrolled", "not enrolled", "not recognised"]

_NORMAL_REACH = 1.5  # in diameters of the head
_COURSE_POINTS = 24
_FEWEST_WRONG = 3  # heads of another size that make one doubt the station
# Placements whose probabilities differ by less than a factor of twenty cannot be told apart with 95 % confidence.
_AMBIGUOUS = float(np.log(20.0))


@dataclass(frozen=True)
class Registration:
    """A scan in terms of its panel."""

    status: Status
    """Not enrolled: there is no pattern yet, and this scan is not fit to become it."""
    placement: Placement | None
    """Rig frame to panel frame."""
    rivets: tuple[Rivet, ...]
    stations: tuple[SeamStation, ...]
    """rivets, stations: with the panel's ids, zones and panel coordinates; rows for what is missing included where
    asked for. As measured where the scan was not recognised."""
    matched: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    unlisted: tuple[str, ...] = ()
    """matched, missing, unlisted: rivet ids: recognised; expected in view and not found; found and in no pattern."""
    rms_mm: float | None = None
    """Of the recognised rivets' distances from their nominal places."""
    shift_mm: float | None = None
    turn_deg: float | None = None
    """shift_mm, turn_deg: how far the rig stands from the station's nominal placement."""
    warnings: tuple[str, ...] = ()
    enrolled: PanelLayout | None = None
    """The pattern whose first scan this one is."""
    others: Features = field(default_factory=dict)
    """Features of other kinds, which no pattern names, in panel coordinates where the placement is known."""
    ambiguous: bool = False
    """Whether another placement fits almost as well, so that names may be shifted."""

    @property
    def features(self) -> Features:
        """All that was found, by kind."""
        return {RIVET.name: self.rivets, SEAM_STATION.name: self.stations, **self.others}


def register(
    rivets: Sequence[Rivet],
    stations: Sequence[SeamStation],
    reconstruction: Reconstruction,
    layout: PanelLayout,
    station: str,
    settings: RegistrationSettings | None = None,
    *,
    missing_rows: bool = True,
) -> Registration:
    """Recognise a scan's rivets and seams in a panel's nominal pattern.

    Parameters
    ----------
    rivets, stations
        As measured, with ids of the scan's own.
    reconstruction : Reconstruction
        Gives the rig (what is in view) and the skin's direction.
    station : str
        Which nominal placement the rig is near; where the layout has none by that name, the whole pattern is searched.
    missing_rows : bool
        Whether rivets of the pattern that are in view and were not found become rows. True for a pattern that a person
        vouches for; one that merely repeats what an earlier scan found gives only a warning.
    """
    settings = settings or RegistrationSettings()
    prior = layout.stations.get(station)
    rows = [k for k, rivet in enumerate(rivets) if has_position(rivet)]
    scan = _scan([rivets[k] for k in rows], stations, reconstruction)
    if len(scan.rivets) == 0 and not scan.seams:
        return _unrecognised(rivets, stations, "found no rivet and no seam")
    matcher = Matcher(scan, _pattern(layout, prior), layout, prior, reconstruction.rig, settings)
    ranked = matcher.ranked()
    if not ranked or not matcher.convincing(ranked[0]):
        found = f"found at best {int((ranked[0].partner >= 0).sum()) if ranked else 0} of {len(rows)} rivets in it"
        return _unrecognised(rivets, stations, found)
    best = ranked[0]
    absent = matcher.expected(best.placement)
    partner = {row: int(k) for row, k in zip(rows, matcher.in_place(best), strict=True) if k >= 0}
    absent[list(partner.values())] = False
    known = Recognised(
        best.placement,
        {row: layout.rivets[k] for row, k in partner.items()},
        [layout.rivets[k] for k in np.flatnonzero(absent)],
        best.seams,
        missing_rows,
    )
    distances = matcher.distances(best)
    shift, turn = (None, None) if prior is None else motion(best.placement, prior, scan.middle)
    turn_deg = None if turn is None else float(np.degrees(turn))
    named = relabel_rivets(rivets, known, reconstruction)
    listed = {rivet.rivet_id for rivet in layout.rivets}
    return Registration(
        "recognised",
        best.placement,
        tuple(named),
        tuple(relabel_stations(stations, known, reconstruction, layout.seams, settings.gap_mm)),
        matched=tuple(rivet.rivet_id for rivet in known.rivets.values()),
        missing=tuple(rivet.rivet_id for rivet in known.missing),
        unlisted=tuple(r.rivet_id for r in named if r.rivet_id not in listed and r.decision != "unconfirmed"),
        rms_mm=float(np.sqrt((distances**2).mean())) if len(distances) else None,
        shift_mm=shift,
        turn_deg=turn_deg,
        ambiguous=_ambiguous(ranked),
        warnings=(*_warnings(ranked, shift, turn_deg, known.missing, settings), *_other_sizes(named)),
    )


def with_others(registered: Registration, found: Features, layout: PanelLayout | None = None) -> Registration:
    """The registration with features of kinds that no pattern names, placed in the panel's frame where it is known.

    A hole where the pattern has a rivet that was not found is a missing fastener. A defect is judged by the zone of the
    rivet or seam that is nearest to it.
    """
    placement = registered.placement
    others = {
        name: rows if placement is None else [placed(row, placement) for row in rows] for name, rows in found.items()
    }
    if layout and DEFECT.name in others:
        others[DEFECT.name] = [in_nearest_zone(row, layout) for row in others[DEFECT.name]]
    missing = [rivet for rivet in layout.rivets if rivet.rivet_id in registered.missing] if layout else []
    holes = missing_fasteners(of_type(others, Hole), missing)
    rivets = explained(registered.rivets, holes)
    return replace(registered, rivets=tuple(rivets), others={**others, HOLE.name: holes} if holes else others)


def _scan(rivets: Sequence[Rivet], stations: Sequence[SeamStation], reconstruction: Reconstruction) -> Scan:
    """The rivets and stations that have positions, as points."""
    places = positions(rivets)
    normals = np.full(places.shape, np.nan)
    for k, rivet in enumerate(rivets):
        normal = skin_normal(reconstruction.points, rivet.u_px, rivet.v_px, _NORMAL_REACH * rivet.major_px)
        if normal is not None:
            normals[k] = normal
    diameters = np.array([rivet.diameter_mm for rivet in rivets], float)
    seams: dict[str, list[SeamStation]] = {}
    for station in stations:
        if has_position(station):
            seams.setdefault(station.seam_id, []).append(station)
    courses = {name: _thinned(positions(members)) for name, members in seams.items()}
    return Scan(PointPattern(places, normals, diameters), courses)


def _thinned(course: Array) -> Array:
    """At most _COURSE_POINTS of a seam's stations, evenly: its course is smooth."""
    return course[np.linspace(0, len(course) - 1, min(len(course), _COURSE_POINTS)).round().astype(int)]


def _pattern(layout: PanelLayout, prior: Placement | None) -> PointPattern:
    """The nominal rivets as points; normals that are not given are estimated, facing the rig where it is known."""
    places = np.array([rivet.position for rivet in layout.rivets], float).reshape(-1, 3)
    normals = estimated_normals(places)
    if prior is not None:
        normals *= np.where(((prior.t - places) * normals).sum(1) < 0, -1.0, 1.0)[:, None]
    for k, rivet in enumerate(layout.rivets):
        if rivet.normal is not None:
            normals[k] = np.array(rivet.normal) / np.linalg.norm(rivet.normal)
    diameters = np.array([rivet.diameter_mm for rivet in layout.rivets], float)
    return PointPattern(places, normals, diameters)


def _unrecognised(rivets: Sequence[Rivet], stations: Sequence[SeamStation], found: str) -> Registration:
    warning = (
        f"panel's pattern not recognised: {found}, expected most; ids are this scan's own; is this the right station?"
    )
    return Registration("not recognised", None, tuple(rivets), tuple(stations), warnings=(warning,))


def _ambiguous(ranked: Sequence[Hypothesis]) -> bool:
    """Whether two placements are almost alike."""
    return len(ranked) > 1 and ranked[0].score - ranked[1].score < _AMBIGUOUS


def _warnings(
    ranked: Sequence[Hypothesis], shift: float | None, turn: float | None, missing: Sequence[NominalRivet],
    settings: RegistrationSettings,
) -> list[str]:  # fmt: skip
    warnings = []
    if _ambiguous(ranked):
        warnings.append(
            "panel's pattern fits in two ways almost alike, expected one: ids may be shifted; "
            "see to the station's nominal placement"
        )
    if shift is not None and turn is not None and (shift > settings.shift_mm or turn > settings.turn_deg):
        warnings.append(
            f"rig found {shift:.1f} mm and {turn:.1f}° from the station's nominal placement, expected at most "
            f"{settings.shift_mm:g} mm and {settings.turn_deg:g}°"
        )
    if missing:
        names = ", ".join(rivet.rivet_id for rivet in missing)
        warnings.append(f"rivets of the panel's pattern in view but not found: {names}")
    return warnings


def _other_sizes(rivets: Sequence[Rivet]) -> list[str]:
    """A warning where most heads are of another size than the pattern's: each of them is a finding, too."""
    verdicts = [size_verdict(rivet) for rivet in rivets if not rivet.is_missing]
    known, wrong = sum(v is not None for v in verdicts), verdicts.count("wrong")
    if wrong < _FEWEST_WRONG or 2 * wrong <= known:
        return []
    return [f"heads of another size than the pattern's: {wrong} of {known}; is this the right station?"]
