"""Courses over a whole panel: the pieces of a seam that its scans saw become one, with s from one end."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from metrology.arrays import Array
from metrology.assembly.carried import Known, known_course
from metrology.assembly.features import PanelFeature, Sighting, combined
from metrology.kinds import Kind
from metrology.panel import PanelLayout, course_length, foot_on
from metrology.registration.courses import exchanged
from metrology.results import Feature, SeamStation

_SAME_COURSE_MM = 1.5  # median distance of two pieces where they run side by side
_FEWEST_BESIDE = 3
_REACH_SPACINGS = 1.5  # positions farther apart than this have something unmeasured between them


@dataclass(frozen=True)
class Piece:
    """A scan's rows of one course."""

    scan: int
    name: str
    """By the scan."""
    sightings: tuple[Sighting, ...]
    """In the order along it."""
    across: Array | None = None
    """(k, 3) or None: from side A to side B at the rows with a place, panel frame."""
    listed: bool = False
    """Whether the name is the specification's."""

    @property
    def placed(self) -> list[Sighting]:
        """Rows with a place that were found."""
        return [s for s in self.sightings if s.row.x_panel_mm is not None and not s.row.is_missing]

    @property
    def places(self) -> Array:
        """(k, 3) of the rows with a place, panel frame."""
        return np.array([s.place for s in self.placed]).reshape(-1, 3)


def course_features(
    kind: Kind, part: int, pieces: Iterable[Piece], layout: PanelLayout | None = None,
    known: Mapping[str, Known] | None = None,
) -> list[list[PanelFeature]]:  # fmt: skip
    """The courses of a kind, each once: its positions in order, with s from one end.

    Parameters
    ----------
    known : mapping of str to Known, optional
        Courses of the assembly before: these go on as they were counted, with the same sides.
    """
    sound = [piece for piece in pieces if len(piece.placed) > 1]
    return [_one_course(kind, part, group, layout, known or {}) for group in _groups(sound)]


def _groups(pieces: Sequence[Piece]) -> list[list[Piece]]:
    groups: list[list[Piece]] = []
    for piece in sorted(pieces, key=lambda each: -len(each.placed)):
        same = [group for group in groups if any(_is_same(piece, other) for other in group)]
        groups = [group for group in groups if group not in same]
        groups.append([*(other for group in same for other in group), piece])
    return groups


def _is_same(piece: Piece, other: Piece) -> bool:
    if piece.listed and other.listed:
        return piece.name == other.name
    if piece.scan == other.scan:
        return False
    foot = foot_on(other.places, piece.places)
    beside = (foot.s > 0) & (foot.s < course_length(other.places))
    return bool(beside.sum() >= _FEWEST_BESIDE and np.median(foot.distance[beside]) < _SAME_COURSE_MM)


def _one_course(
    kind: Kind, part: int, pieces: Sequence[Piece], layout: PanelLayout | None, known: Mapping[str, Known]
) -> list[PanelFeature]:
    course = _course(pieces)
    guide = _nominal(pieces, layout)
    name = next((piece.name for piece in pieces if piece.listed), None)
    before = known.get(name or known_course(course, known) or "")
    if guide is None and before:
        guide = before.places
    if _is_backwards(course, guide):
        course = course[::-1]
    start = 0.0 if guide is None else float(guide[0, 0] + foot_on(guide[:, 1:], course[:1]).s[0])
    sides = [_side(piece, course) for piece in pieces]
    side = (before.side if before else 0.0) or sides[max(range(len(pieces)), key=lambda k: len(pieces[k].placed))]
    turned = [_turned(p) if own * side < 0 else p for p, own in zip(pieces, sides, strict=True)]
    along = [_along(kind, piece, course, start) for piece in turned]
    rows = []
    for s, sightings in _positions(kind, along):
        feature = combined(kind, part, sightings)
        label, position = kind.id_columns
        changed: dict[str, Any] = {label: name or pieces[0].name, position: s}
        rows.append(replace(feature, row=replace(feature.row, **changed), side=float(np.sign(side))))
    return rows


def _course(pieces: Sequence[Piece]) -> Array:
    """A polyline through all pieces: the longest one, and at its ends what others go on with."""
    first, *waiting = sorted(pieces, key=lambda piece: -course_length(piece.places))
    course = first.places
    while waiting:
        nearest = min(waiting, key=lambda piece: _gap(course, piece.places))
        waiting.remove(nearest)
        foot = foot_on(course, nearest.places)
        before, after = foot.s < 0, foot.s > course_length(course)
        course = np.concatenate(
            [
                nearest.places[before][np.argsort(foot.s[before])],
                course,
                nearest.places[after][np.argsort(foot.s[after])],
            ]
        )
        course = course[np.concatenate([[True], np.linalg.norm(np.diff(course, axis=0), axis=1) > 1e-6])]
    return course


def _gap(course: Array, places: Array) -> float:
    """How far apart two pieces are along their course; 0 where they run side by side."""
    s, length = foot_on(course, places).s, course_length(course)
    return float(np.maximum(np.maximum(-s, s - length), 0).min())


def _is_backwards(course: Array, guide: Array | None) -> bool:
    """Whether a course runs against its guide or, without one, to the left (or up and down, upwards)."""
    if guide is not None:
        s = foot_on(guide[:, 1:], course[[0, -1]]).s
        return bool(s[0] > s[1])
    x, y, _ = course[-1] - course[0]
    return bool(x < 0 if abs(x) >= abs(y) else y > 0)


def _nominal(pieces: Sequence[Piece], layout: PanelLayout | None) -> Array | None:
    """(n, 4) s of the start (0) and x, y, z of the corners."""
    names = {piece.name for piece in pieces if piece.listed}
    seams = [seam for seam in layout.seams if seam.seam_id in names] if layout else []
    return np.insert(np.array(seams[0].course, float), 0, 0.0, axis=1) if seams else None


def _side(piece: Piece, course: Array) -> float:
    """Positive where side B lies to the left of the course for a viewer outside (z outward); 0 where unknown."""
    if piece.across is None:
        return 0.0
    tangent = foot_on(course, piece.places).tangent
    return float(np.nansum(np.cross(tangent, piece.across)[:, 2]))


def _turned(piece: Piece) -> Piece:
    rows = [replace(s, row=exchanged(s.row)) if isinstance(s.row, SeamStation) else s for s in piece.sightings]
    return replace(piece, sightings=tuple(rows), across=None if piece.across is None else -piece.across)


def _along(kind: Kind, piece: Piece, course: Array, start: float) -> list[tuple[float, Sighting]]:
    """The rows of a piece with their s on the whole course; one without a place lies between its neighbours."""
    position = kind.id_columns[1]
    own = np.array([getattr(s.row, position) for s in piece.placed])
    on_course = foot_on(course, piece.places).s + start
    order = np.argsort(own)
    own, on_course = own[order], on_course[order]
    slope = np.sign(on_course[-1] - on_course[0]) or 1.0
    rows = []
    for sighting in piece.sightings:
        s = float(getattr(sighting.row, position))
        nearest = int(np.abs(own - s).argmin())
        inside = own[0] <= s <= own[-1]
        rows.append(
            (
                float(np.interp(s, own, on_course) if inside else on_course[nearest] + slope * (s - own[nearest])),
                sighting,
            )
        )
    return sorted(rows, key=lambda each: each[0])


def _positions(kind: Kind, pieces: Sequence[list[tuple[float, Sighting]]]) -> list[tuple[float, list[Sighting]]]:
    """Positions along the whole course, and what each piece has there."""
    spacing = float(np.median(np.concatenate([np.diff([s for s, _ in piece]) for piece in pieces])))
    kept: list[float] = []
    for piece in sorted(pieces, key=lambda each: each[0][0]):
        reached = kept[-1] if kept else -np.inf
        kept += [s for s, _ in piece if s > reached + spacing / 2]
    found = []
    for s in kept:
        there = [each for piece in pieces if (each := _at(kind, piece, s, spacing)) is not None]
        measured = [each for each in there if not each.row.is_missing]
        found.append((s, measured or there))
    return found


def _at(kind: Kind, piece: list[tuple[float, Sighting]], s: float, spacing: float) -> Sighting | None:
    """What a piece says at a position: between its two neighbours there."""
    places = np.array([each for each, _ in piece])
    after = int(np.searchsorted(places, s))
    near = [k for k in (after - 1, after) if 0 <= k < len(piece) and abs(places[k] - s) < _REACH_SPACINGS * spacing]
    if not near:
        return None
    nearest = min(near, key=lambda k: abs(places[k] - s))
    if len(near) < 2 or abs(places[nearest] - s) < 1e-6:
        return piece[nearest][1] if abs(places[nearest] - s) <= spacing / 2 else None
    one, two = piece[near[0]][1], piece[near[1]][1]
    share = float((s - places[near[0]]) / max(places[near[1]] - places[near[0]], 1e-9))
    return replace(piece[nearest][1], row=_between(kind, piece[nearest][1].row, one.row, two.row, share))


def _between(kind: Kind, row: Feature, one: Feature, two: Feature, share: float) -> Feature:
    """A row with values between two others; unmeasured where one of these is."""
    columns = ["x_panel_mm", "y_panel_mm", "z_panel_mm"]
    columns += [c for q in kind.quantities for c in (q.column, q.u95_column, *q.rests_on_it)]
    changed: dict[str, Any] = {}
    for column in columns:
        a, b = getattr(one, column), getattr(two, column)
        if a is not None and b is not None:
            changed[column] = float((1 - share) * a + share * b)
    return replace(row, **changed)
