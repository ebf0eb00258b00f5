"""The assembled panel: every feature once, named and judged."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np

from metrology.assembly.assemble import Assembly, Part
from metrology.assembly.carried import Former, Known, known_course, known_in, known_single
from metrology.assembly.features import PanelFeature, Sighting, single_features
from metrology.assembly.runs import Piece, course_features
from metrology.assembly.scan import PanelScan
from metrology.kinds import KINDS, Kind
from metrology.limits import PanelSpec
from metrology.panel import PanelLayout, Placement
from metrology.registration.rows import has_position, placed
from metrology.results import COVERAGE_95, Feature
from metrology.tolerance import judge

PanelFeatures = Mapping[str, Sequence[PanelFeature]]
"""The features of a panel, by the names of the kinds."""

# Standard deviation of a single feature's own place, beside that of its scan's placement.
_OWN_PLACE_MM = 0.02


@dataclass(frozen=True)
class _Seen:
    """A scan in its part."""

    number: int
    scan: PanelScan
    placement: Placement
    part: Part
    members: Sequence[PanelScan]
    index: int

    def sighting(self, row: Feature) -> Sighting:
        """A row of the scan in the panel's frame."""
        row = placed(row, self.placement)
        if not has_position(row):
            return Sighting(self.number, row)
        point = np.array([row.x_panel_mm, row.y_panel_mm, row.z_panel_mm], float)
        covariance = self.part.fit.place_covariance(self.members, self.index, point)
        return Sighting(
            self.number,
            row,
            float(COVERAGE_95 * np.sqrt(np.linalg.eigvalsh(covariance).max() + _OWN_PLACE_MM**2)),
        )


def panel_features(
    assembly: Assembly, spec: PanelSpec, layout: PanelLayout | None = None, former: Former | None = None
) -> PanelFeatures:
    """Every feature of an assembled panel once, by kind, named and judged.

    Parameters
    ----------
    assembly : Assembly
        Its scans hold rows as measured, not judged.
    layout : PanelLayout, optional
        The specification's pattern, whose names stay.
    former : Former, optional
        The assembly before, whose names stay where its frame does.
    """
    return {kind.name: _of_kind(kind, assembly, spec, layout, former) for kind in KINDS}


def _of_kind(
    kind: Kind, assembly: Assembly, spec: PanelSpec, layout: PanelLayout | None, former: Former | None
) -> list[PanelFeature]:
    listed = _listed(layout)
    found: list[list[PanelFeature]] = []  # those of one name together
    for number, part in enumerate(assembly.parts, 1):
        seen = _seen(assembly, part)
        if kind.is_course:
            pieces = [piece for each in seen for piece in _pieces(kind, each, listed)]
            found += course_features(kind, number, pieces, layout, known_in(former, kind, part))
        else:
            rows = [each.sighting(row) for each in seen for row in each.scan.features.get(kind.name, ())]
            found += [[feature] for feature in _in_order(single_features(kind, number, rows))]
    features = [feature for group in _named(kind, found, assembly, listed, former) for feature in group]
    judged = judge(kind, [feature.row for feature in features], spec)
    return [replace(feature, row=row) for feature, row in zip(features, judged, strict=True)]


def _seen(assembly: Assembly, part: Part) -> list[_Seen]:
    members = [assembly.scans[k] for k in part.numbers]
    return [
        _Seen(number, members[index], placement, part, members, index)
        for index, (number, placement) in enumerate(zip(part.numbers, part.fit.placements, strict=True))
    ]


def _pieces(kind: Kind, seen: _Seen, listed: set[str]) -> list[Piece]:
    label, position = kind.id_columns
    rows: dict[str, list[Feature]] = {}
    for row in sorted(seen.scan.features.get(kind.name, ()), key=lambda row: getattr(row, position)):
        rows.setdefault(getattr(row, label), []).append(row)
    pieces = []
    for name, of_name in rows.items():
        directions = [
            seen.scan.across.get((name, getattr(row, position)))
            for row in of_name
            if has_position(row) and not row.is_missing
        ]
        known = np.array([np.full(3, np.nan) if d is None else d for d in directions]).reshape(-1, 3)
        across = known @ seen.placement.R.T if np.isfinite(known).any() else None
        is_listed = seen.scan.nominal is not None and name in listed
        pieces.append(Piece(seen.number, name, tuple(seen.sighting(row) for row in of_name), across, is_listed))
    return pieces


def _listed(layout: PanelLayout | None) -> set[str]:
    """Names of the specification's pattern."""
    if layout is None:
        return set()
    return {rivet.rivet_id for rivet in layout.rivets} | {seam.seam_id for seam in layout.seams}


def _in_order(features: Iterable[PanelFeature]) -> list[PanelFeature]:
    """From one end of the panel to the other, upper ones first."""
    return sorted(features, key=lambda f: (round(f.row.x_panel_mm or 0.0, -1), -(f.row.y_panel_mm or 0.0)))


def _named(
    kind: Kind, groups: Sequence[Sequence[PanelFeature]], assembly: Assembly, listed: set[str], former: Former | None
) -> list[list[PanelFeature]]:
    """Names of the specification and of the assembly before stay; others get the next number behind their letters."""
    known = {number: known_in(former, kind, part) for number, part in enumerate(assembly.parts, 1)}
    # A name that stood for something else would be taken for it: none of the assembly before is given anew.
    carried = any(part.former for part in assembly.parts)
    taken = listed.union(former.names.get(kind.name, {}) if former and carried else ())
    given: set[str] = set()
    numbers: dict[str, Iterable[int]] = {}
    named = []
    for group in groups:
        first = group[0]
        name = first.name
        before = _name_before(kind, group, known[first.part])
        if name in listed and assembly.scans[first.best].nominal is not None:
            pass
        elif before and before not in given:
            name = before
        else:
            letters = re.match(r"[^\d]*", name)[0]  # type: ignore[index]
            free = numbers.setdefault(letters, count(1))
            name = next(label for k in free if (label := f"{letters}{k:02d}") not in taken)
            taken.add(name)
        given.add(name)
        changed: dict[str, Any] = {kind.id_columns[0]: name}
        named.append([replace(feature, row=replace(feature.row, **changed)) for feature in group])
    return named


def _name_before(kind: Kind, group: Sequence[PanelFeature], known: Mapping[str, Known]) -> str | None:
    """What the assembly before called it."""
    if not kind.is_course:
        return known_single(group[0], known)
    places = [(f.row.x_panel_mm, f.row.y_panel_mm, f.row.z_panel_mm) for f in group if f.row.x_panel_mm is not None]
    return known_course(np.array(places, float).reshape(-1, 3), known)
