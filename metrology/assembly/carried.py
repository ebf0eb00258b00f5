"""The frame and the names of the assembly before, carried over to the next one: what was R05 stays R05.

Where the same scan is in both, it lies where it lay. Else the scan of the same station is found again in the new one as
neighbours are found (`pairing`): by evidence, or not at all.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from metrology.arrays import Array
from metrology.assembly.assemble import Assembly, Part
from metrology.assembly.features import LEAST_REACH_MM, PanelFeature
from metrology.assembly.pairing import neighbours
from metrology.assembly.scan import PanelScan
from metrology.kinds import KINDS, Kind
from metrology.panel import PanelLayout, Placement, course_length, foot_on

_SAME_COURSE_MM = 1.5  # median distance of two courses where they run side by side
_FEWEST_BESIDE = 3
_TRIED = 3  # scans of a part that are looked for again, until one is found
_SPARSE_MM = 10.0  # of a remembered course


@dataclass(frozen=True)
class Known:
    """What an earlier assembly named."""

    part: int
    """Of the assembly before, in whose frame it lies."""
    places: Array
    """(n, 4): s, x, y, z, mm; one row with s = 0 for what is no course."""
    side: float = 0.0
    """Of a course: positive where side B lies to the left of it for a viewer outside; 0 where unknown."""


Names = Mapping[str, Mapping[str, Known]]
"""By the names of the kinds, and then by names of features."""


@dataclass(frozen=True)
class Former:
    """The assembly before."""

    scans: Mapping[str, tuple[str, int, Placement]]
    """Station, part and placement of its scans, by scene id."""
    frames: Mapping[int, str]
    """Which frame each part lies in."""
    names: Names
    load: Callable[[str], PanelScan | None]
    """Fetches one of the scans by its scene id; None where the archive has it no more."""


def with_frames(assembly: Assembly, layout: PanelLayout, former: Former | None) -> Assembly:
    """The assembly in the frames of the one before where it is found again there, and each frame with a name."""
    parts: list[Part] = []
    for part in assembly.parts:
        if part.nominal:
            name = pattern_frame(layout)
            number = next((k for k, frame in former.frames.items() if frame == name), None) if former else None
            parts.append(replace(part, frame_id=name, former=number))
            continue
        found = _found_again(assembly.scans, part, former) if former else None
        if former and found:
            number, motion = found
            fit = part.fit.moved(motion)
            parts.append(replace(part, fit=fit, frame_id=former.frames[number], former=number))
        else:
            first = assembly.scans[part.numbers[0]].key.scene_id
            parts.append(replace(part, frame_id=own_frame(first, part.fit.placements[0])))
    lost = [
        "+".join(assembly.scans[k].key.station for k in part.numbers)
        for part in parts
        if part.former is None and not part.nominal
    ]
    said = [
        f"names and places of {', '.join(lost)} are not those of the assembly before: they were not found again in it"
    ]
    return replace(assembly, parts=tuple(parts), warnings=(*assembly.warnings, *(said if former and lost else ())))


def _found_again(scans: Sequence[PanelScan], part: Part, former: Former) -> tuple[int, Placement] | None:
    """The part of the former assembly that a part is of, and the motion into its frame."""
    placed = dict(zip(part.numbers, part.fit.placements, strict=True))
    for number, placement in placed.items():
        if known := former.scans.get(scans[number].key.scene_id):
            return known[1], _motion(placement, known[2])
    of_station = {station: scene for scene, (station, _, _) in former.scans.items()}
    tried = 0
    for number, placement in placed.items():
        scene = of_station.get(scans[number].key.station)
        old = former.load(scene) if scene and tried < _TRIED else None
        if scene is None or old is None:
            continue
        tried += 1
        pair = neighbours(old, scans[number])
        if pair is not None and pair.convincing:
            _, part_number, stood = former.scans[scene]
            stands = Placement(stood.R @ pair.placement.R, stood.R @ pair.placement.t + stood.t)
            return part_number, _motion(placement, stands)
    return None


def _motion(now: Placement, then: Placement) -> Placement:
    """From the frame in which a scan lies now to the one in which it lay then."""
    R = then.R @ now.R.T
    u, _, vt = np.linalg.svd(R)  # rounding of what was stored
    return Placement(u @ vt, then.t - u @ vt @ now.t)


def pattern_frame(layout: PanelLayout) -> str:
    """The name of a pattern's frame: another one where any nominal place is another."""
    places = [(r.rivet_id, r.position) for r in layout.rivets], [(s.seam_id, s.course) for s in layout.seams]
    return f"specification {_short(repr(places))}"


def own_frame(scene_id: str, placement: Placement) -> str:
    """The name of a frame that lies on the skin: it is known by where a scan lies in it."""
    place = " ".join(f"{value:.4f}" for value in [*placement.R.ravel(), *placement.t])
    return f"own {_short(f'{scene_id} {place}')}"


def _short(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def known_in(former: Former | None, kind: Kind, part: Part) -> dict[str, Known]:
    """What earlier assemblies named in the frame of a part."""
    if former is None or part.former is None:
        return {}
    return {name: each for name, each in former.names.get(kind.name, {}).items() if each.part == part.former}


def known_course(places: Array, known: Mapping[str, Known]) -> str | None:
    """The course of an earlier assembly along which places (n, 3) lie."""
    for name, each in known.items():
        course = each.places
        if len(course) < 2 or len(places) == 0:
            continue
        foot = foot_on(course[:, 1:], places)
        beside = (foot.s > 0) & (foot.s < course_length(course[:, 1:]))
        if beside.sum() >= _FEWEST_BESIDE and np.median(foot.distance[beside]) < _SAME_COURSE_MM:
            return name
    return None


def known_single(feature: PanelFeature, known: Mapping[str, Known]) -> str | None:
    """What a feature that is no course was called before: nearer than half its size."""
    row = feature.row
    if row.x_panel_mm is None or not known:
        return None
    place = np.array([row.x_panel_mm, row.y_panel_mm, row.z_panel_mm], float)
    names = list(known)
    away = np.linalg.norm(np.array([known[name].places[0, 1:] for name in names]) - place, axis=1)
    reach = max([LEAST_REACH_MM, *((getattr(row, column) or 0.0) / 2 for column in feature.kind.size)])
    nearest = int(away.argmin())
    return names[nearest] if away[nearest] < reach else None


def places_of(kind: Kind, rows: Sequence[object]) -> dict[str, Array]:
    """Places (n, 4) by name of what has any; of a course few enough to be remembered."""
    name, *position = kind.id_columns
    found: dict[str, list[tuple[float, ...]]] = {}
    for row in rows:
        place = [getattr(row, f"{axis}_panel_mm") for axis in "xyz"]
        if None not in place:
            s = float(getattr(row, position[0])) if position else 0.0
            found.setdefault(getattr(row, name), []).append((s, *map(float, place)))
    return {label: _sparse(np.array(sorted(places))) for label, places in found.items()}


def _sparse(places: Array) -> Array:
    """Some of a course's places, its ends among them."""
    keep = np.concatenate([[True], np.diff(np.floor((places[:, 0] - places[0, 0]) / _SPARSE_MM)) > 0])
    keep[-1] = True
    return np.asarray(np.round(places[keep], 3))


def remembered(
    assembly: Assembly, features: Mapping[str, Sequence[PanelFeature]], former: Former | None
) -> dict[str, dict[str, Known]]:
    """Names of earlier assemblies that this one has nothing for, in its parts: a station may be scanned again."""
    part_of = {part.former: number for number, part in reversed(list(enumerate(assembly.parts, 1))) if part.former}
    kept: dict[str, dict[str, Known]] = {}
    for kind in KINDS if former else ():
        there = {feature.name for feature in features[kind.name]}
        for name, known in (former.names if former else {}).get(kind.name, {}).items():
            if name not in there and known.part in part_of:
                kept.setdefault(kind.name, {})[name] = replace(known, part=part_of[known.part])
    return kept
