"""From scans to parts of a panel: which scans belong together, and where each of them lies in the panel's frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise

import numpy as np

from metrology.arrays import Array
from metrology.assembly.adjust import Adjusted, NominalTie, Tie, adjusted
from metrology.assembly.overlap import head_partners, heads_expected, seam_ties, skin_ties
from metrology.assembly.pairing import ENOUGH, Neighbours, judged_at, neighbours
from metrology.assembly.scan import PanelScan
from metrology.panel import PanelLayout, Placement
from metrology.results import COVERAGE_95

_ROUNDS = 2
_MARGIN_MM = 60.0  # fields whose boxes are farther apart, by the nominal placements, share nothing
_TORN_MM = 0.3  # median distance of a tie's heads after the joint adjustment, beyond which it was none
_FEWEST_DISPUTED = 2
_NOMINAL_REACH_MM = 3.0


@dataclass(frozen=True)
class Part:
    """Scans in one frame."""

    numbers: tuple[int, ...]
    """Of the scans."""
    fit: Adjusted
    """Placements to the panel's frame, in the order of `numbers`."""
    nominal: bool = False
    """Whether the frame is the specification's."""
    ties: int = 0
    """Overlaps that hold it together."""
    frame_id: str = ""
    """Names its frame; parts of other assemblies with the same name lie in the same one."""
    former: int | None = None
    """The part of the assembly before whose frame it is in."""


@dataclass(frozen=True)
class Assembly:
    """A panel put together."""

    scans: tuple[PanelScan, ...]
    parts: tuple[Part, ...]
    """Those in the specification's frame first, then the largest first; no part's frame says where another lies."""
    left_out: dict[int, str] = field(default_factory=dict)
    """Scans that contradict the others, and why."""
    warnings: tuple[str, ...] = ()

    def placed(self) -> Iterator[tuple[int, int, Placement]]:
        """Number of the part, from 1, number of the scan, and its placement."""
        for part_number, part in enumerate(self.parts, 1):
            for number, placement in zip(part.numbers, part.fit.placements, strict=True):
                yield part_number, number, placement


def assembled(scans: Sequence[PanelScan], layout: PanelLayout | None = None) -> Assembly:
    """Put scans of a panel into one frame: by the nominal pattern where it has them, and by what overlaps share.

    Parameters
    ----------
    scans : sequence of PanelScan
        One for each station.
    layout : PanelLayout, optional
        The specification's pattern, in which scans with a `nominal` placement were recognised.
    """
    pairs = _pairs(scans)
    left_out = _contradicting(scans, pairs)
    kept = {p: found for p, found in pairs.items() if found.convincing and not left_out.keys() & set(p)}
    groups = _groups([k for k in range(len(scans)) if k not in left_out], kept, scans)
    warnings: list[str] = []
    parts = [_part(scans, group, kept, layout, warnings) for group in groups]
    parts.sort(key=lambda part: (not part.nominal, -len(part.numbers), part.numbers))
    if len(parts) > 1:
        warnings.append(_apart(scans, parts, pairs))
    warnings += [f"{scans[k].key.station} left out: {why}" for k, why in left_out.items()]
    return Assembly(tuple(scans), tuple(parts), left_out, tuple(warnings))


def _pairs(scans: Sequence[PanelScan]) -> dict[tuple[int, int], Neighbours]:
    """What any two scans that may overlap have in common."""
    found = {}
    for i, j in combinations(range(len(scans)), 2):
        near = _expected(scans[i], scans[j])
        there = near or _expected(scans[i], scans[j], roughly=True)
        if there is not None and not _may_overlap(scans[i], scans[j], there):
            continue
        pair = neighbours(scans[i], scans[j], near)
        if pair is not None:
            found[i, j] = pair
    return found


def _expected(first: PanelScan, second: PanelScan, roughly: bool = False) -> Placement | None:
    """Where the second scan should lie in the first one's rig frame, by their nominal placements."""
    one, two = ((scan.expected if roughly else scan.nominal) for scan in (first, second))
    return None if one is None or two is None else between(one, two)


def between(first: Placement, second: Placement) -> Placement:
    """The placement from the second one's rig frame to the first one's."""
    return Placement(first.R.T @ second.R, first.R.T @ (second.t - first.t))


def _may_overlap(first: PanelScan, second: PanelScan, near: Placement) -> bool:
    def box(points: Array) -> tuple[Array, Array]:
        return np.nanmin(points, axis=0), np.nanmax(points, axis=0)

    (low, high), (other_low, other_high) = (
        box(first.skin.points[::8, ::8].reshape(-1, 3).astype(float)),
        box(near.to_panel(second.skin.points[::8, ::8].reshape(-1, 3))),
    )
    return bool((low - _MARGIN_MM < other_high).all() and (other_low - _MARGIN_MM < high).all())


def _contradicting(scans: Sequence[PanelScan], pairs: dict[tuple[int, int], Neighbours]) -> dict[int, str]:
    """Scans whose features are not those that their neighbours see at the same places of the panel."""
    disputed: set[tuple[int, int]] = set()
    for (i, j), pair in pairs.items():
        near = _expected(scans[i], scans[j])
        if near is None or pair.convincing:
            continue
        expected = heads_expected(scans[i], scans[j], near)
        there = judged_at(scans[i], scans[j], near)
        if there and there.evidence < -ENOUGH and min(side.sum() for side in expected) >= _FEWEST_DISPUTED:
            disputed.add((i, j))
    left_out: dict[int, str] = {}
    while disputed:
        counts = {k: sum(k in pair for pair in disputed) for k in {k for pair in disputed for k in pair}}
        agreeing = {k: sum(k in p and found.convincing for p, found in pairs.items()) for k in counts}
        worst = max(counts, key=lambda k: (counts[k], -agreeing[k], scans[k].key.captured_at))
        others = sorted(scans[k].key.station for pair in disputed if worst in pair for k in pair if k != worst)
        left_out[worst] = (
            f"found other heads and steps than {', '.join(others)} at the same places, expected one skin; "
            "is it of another aircraft or another place?"
        )
        disputed = {pair for pair in disputed if worst not in pair}
    return left_out


def _groups(
    numbers: Sequence[int], pairs: dict[tuple[int, int], Neighbours], scans: Sequence[PanelScan]
) -> list[list[int]]:
    """Scans that hang together by pairs, or by the specification's frame."""
    group = {k: k for k in numbers}

    def root(k: int) -> int:
        while group[k] != k:
            k = group[k]
        return k

    nominal = [k for k in numbers if scans[k].nominal is not None]
    for i, j in [*pairs, *pairwise(nominal)]:
        group[root(j)] = root(i)
    found: dict[int, list[int]] = {}
    for k in numbers:
        found.setdefault(root(k), []).append(k)
    return list(found.values())


def _part(
    scans: Sequence[PanelScan], group: Sequence[int], pairs: dict[tuple[int, int], Neighbours],
    layout: PanelLayout | None, warnings: list[str],
) -> Part:  # fmt: skip
    """Adjust the scans of a group jointly, with every overlap between them."""
    members = [scans[k] for k in group]
    placements = _start(group, pairs, scans)
    torn: set[tuple[int, int]] = set()
    fit, ties = Adjusted(tuple(placements), np.zeros((6 * len(group),) * 2), 1.0), []
    for _ in range(_ROUNDS):
        ties = [tie for tie in _ties(members, fit.placements) if (tie.first, tie.second) not in torn]
        fit = adjusted(members, fit.placements, ties, _nominal_ties(members, fit.placements, layout))
        bad = [tie for tie in ties if _is_torn(members, fit.placements, tie)]
        torn |= {(tie.first, tie.second) for tie in bad}
    for i, j in sorted(torn):
        warnings.append(
            f"{members[i].key.station} and {members[j].key.station}: found their shared heads more than {_TORN_MM} mm "
            "apart in the joint placement, expected them together; their overlap was not used"
        )
    nominal = any(scan.nominal is not None for scan in members)
    if not nominal:
        fit = fit.moved(_to_own_frame(members, fit.placements))
    return Part(tuple(group), fit, nominal, len(ties))


def _start(
    group: Sequence[int], pairs: dict[tuple[int, int], Neighbours], scans: Sequence[PanelScan]
) -> list[Placement]:
    """Placements from the nominal ones, and from the most convincing pairs, one after the other."""
    inside = [pair for pair in pairs if set(pair) <= set(group)]
    known: dict[int, Placement] = {}
    while len(known) < len(group):
        open_ends = [pair for pair in inside if len(known.keys() & set(pair)) == 1]
        if not open_ends:
            waiting = [k for k in group if k not in known]
            first = max(waiting, key=lambda k: (scans[k].nominal is not None, sum(k in pair for pair in inside)))
            known[first] = scans[first].nominal or Placement(np.eye(3), np.zeros(3))
            continue
        i, j = max(open_ends, key=lambda p: pairs[p].evidence)
        to_first = pairs[i, j].placement
        if i in known:
            known[j] = Placement(known[i].R @ to_first.R, known[i].R @ to_first.t + known[i].t)
        else:
            R = known[j].R @ to_first.R.T
            known[i] = Placement(R, known[j].t - R @ to_first.t)
    return [known[k] for k in group]


def _ties(members: Sequence[PanelScan], placements: Sequence[Placement]) -> list[Tie]:
    """What every two scans share where they lie now."""
    ties = []
    for i, j in combinations(range(len(members)), 2):
        near = between(placements[i], placements[j])
        if not _may_overlap(members[i], members[j], near):
            continue
        skin = skin_ties(members[i], members[j], near)
        heads = head_partners(members[i], members[j], near)
        if len(skin) >= 3 or len(heads):
            ties.append(Tie(i, j, heads, skin, seam_ties(members[i], members[j], near)))
    return ties


def _nominal_ties(
    members: Sequence[PanelScan], placements: Sequence[Placement], layout: PanelLayout | None
) -> list[NominalTie]:
    """Heads beside their nominal places, in a part that is in the specification's frame."""
    if layout is None or not any(scan.nominal is not None for scan in members):
        return []
    places = np.array([rivet.position for rivet in layout.rivets], float).reshape(-1, 3)
    ties = []
    for k, scan in enumerate(members):
        if len(places) == 0 or len(scan.pattern) == 0:
            continue
        at = placements[k].to_panel(scan.pattern.positions)
        distance = np.linalg.norm(at[:, None] - places, axis=2)
        nearest = distance.argmin(1)
        near = distance.min(1) < _NOMINAL_REACH_MM
        ties.append(NominalTie(k, scan.pattern.positions[near], places[nearest[near]]))
    return ties


def _is_torn(members: Sequence[PanelScan], placements: Sequence[Placement], tie: Tie) -> bool:
    if len(tie.heads) < _FEWEST_DISPUTED:
        return False
    one = placements[tie.first].to_panel(members[tie.first].pattern.positions[tie.heads[:, 0]])
    two = placements[tie.second].to_panel(members[tie.second].pattern.positions[tie.heads[:, 1]])
    return float(np.median(np.linalg.norm(one - two, axis=1))) > _TORN_MM


def _to_own_frame(members: Sequence[PanelScan], placements: Sequence[Placement]) -> Placement:
    """Into a frame on the skin: origin in its middle, z outward, x along its length and to the right for the rigs."""
    points = np.concatenate(
        [
            placement.to_panel(scan.skin.points[::8, ::8].reshape(-1, 3))
            for scan, placement in zip(members, placements, strict=True)
        ]
    )
    points = points[np.isfinite(points[:, 2])]
    origin = points.mean(0)
    axes = np.linalg.svd(points - origin, full_matrices=False)[2]
    outward = axes[2] * -np.sign(np.mean([placement.R[:, 2] for placement in placements], axis=0) @ axes[2])
    right = np.mean([placement.R[:, 0] for placement in placements], axis=0)
    x = axes[0] * (1.0 if axes[0] @ right >= 0 else -1.0)
    R = np.stack([x, np.cross(outward, x), outward])
    return Placement(R, -R @ origin)


def _apart(scans: Sequence[PanelScan], parts: Sequence[Part], pairs: dict[tuple[int, int], Neighbours]) -> str:
    """That the panel is in parts, and what would join them."""
    names = ["+".join(scans[k].key.station for k in part.numbers) for part in parts]
    unsure = sorted(
        f"{scans[i].key.station} and {scans[j].key.station}"
        for (i, j), pair in pairs.items()
        if pair.evidence >= ENOUGH and pair.ambiguous
    )
    more = f"; {', '.join(unsure)} fit together in several ways" if unsure else ""
    return (
        f"found {len(parts)} parts that nothing joins ({', '.join(names)}){more}, expected one: scan between them with "
        "an overlap that shows three fasteners and more, or give nominal positions; is each scan of this panel?"
    )


def place_u95(part: Part, scans: Sequence[PanelScan], index: int) -> float:
    """U95 of a scan's placement, mm: of the worst place of its field, in any direction."""
    members = [scans[k] for k in part.numbers]
    points = members[index].skin.points[::8, ::8].reshape(-1, 3).astype(float)
    points = part.fit.placements[index].to_panel(points[np.isfinite(points[:, 2])])
    ends = {int(f(points[:, axis])) for axis in range(3) for f in (np.argmin, np.argmax)}
    worst = max(np.linalg.eigvalsh(part.fit.place_covariance(members, index, points[end])).max() for end in ends)
    return float(COVERAGE_95 * np.sqrt(worst))
