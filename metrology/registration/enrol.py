"""Enrolment: the first scan of a station becomes the pattern that later scans are recognised in."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.panel import NominalRivet, NominalSeam, PanelLayout, Placement
from metrology.registration.register import Registration
from metrology.registration.rows import placed
from metrology.results import Rivet, SeamStation
from metrology.skin_normal import skin_normal

_NORMAL_REACH = 1.5  # in diameters of the head
_COURSE_TOLERANCE_MM = 0.05
_SAMPLES = 20_000


def enrol(
    rivets: Sequence[Rivet],
    stations: Sequence[SeamStation],
    points: NDArray[np.float32],
    station: str,
    doubts: Sequence[str] = (),
) -> Registration:
    """Take a scan as its station's pattern.

    The panel frame's origin is on the skin in the middle of what was measured, z outward (towards the rig), x to
    the right of the left image and y up: as a viewer outside sees the panel.

    Parameters
    ----------
    rivets, stations
        With the ids that they are to keep. What is unconfirmed is no part of the pattern.
    points : (h, w, 3) array
        Organised cloud on the left image's pixels, rig frame, mm.
    doubts : sequence of str
        Why nobody can vouch for the scan; with any, or with neither rivets nor seams, it becomes no pattern.
    """
    placement = _facing(points)
    placed_rivets = [placed(rivet, placement) for rivet in rivets]
    placed_stations = [placed(item, placement) for item in stations]
    nominal = [
        NominalRivet(
            rivet.rivet_id,
            (rivet.x_panel_mm, rivet.y_panel_mm, rivet.z_panel_mm),
            rivet.diameter_mm,
            normal=_normal(rivet, points, placement),
        )
        for rivet in placed_rivets
        if rivet.decision != "unconfirmed"
        and rivet.x_panel_mm is not None
        and rivet.y_panel_mm is not None
        and rivet.z_panel_mm is not None
    ]
    seams = []
    for name in dict.fromkeys(item.seam_id for item in placed_stations):
        course = np.array(
            [
                (item.x_panel_mm, item.y_panel_mm, item.z_panel_mm)
                for item in placed_stations
                if item.seam_id == name and item.x_panel_mm is not None
            ],
            float,
        )
        if len(course) >= 2:
            corners = course[_corners(course, _COURSE_TOLERANCE_MM)]
            seams.append(NominalSeam(name, tuple((float(x), float(y), float(z)) for x, y, z in corners)))
    layout = PanelLayout(tuple(nominal), tuple(seams), {station: placement})
    if doubts or layout.empty:
        found = "; ".join(doubts) or "no rivet and no seam was found"
        warning = f"first scan of station {station}: not enrolled as the panel's pattern, since {found}; scan it again"
        return Registration("not enrolled", None, tuple(rivets), tuple(stations), warnings=(warning,))
    return Registration(
        "enrolled",
        placement,
        tuple(placed_rivets),
        tuple(placed_stations),
        matched=tuple(rivet.rivet_id for rivet in nominal),
        warnings=(
            f"first scan of station {station}: the rivets ({len(nominal)}) and seams ({len(seams)}) found in it were "
            "enrolled as the panel's pattern; check that none is missing",
        ),
        enrolled=layout,
    )


def _facing(cloud: NDArray[np.float32]) -> Placement:
    """The placement that has the panel frame on the measured skin, square to the rig's view of it."""
    points = cloud[np.isfinite(cloud[..., 2])]
    points = points[:: max(1, len(points) // _SAMPLES)].astype(float)
    origin = np.median(points, axis=0)
    outward = np.linalg.svd(points - points.mean(0), full_matrices=False)[2][2]
    outward *= -np.sign(outward[2])
    x = np.array([1.0, 0.0, 0.0]) - outward[0] * outward
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(outward, x), outward])
    return Placement(R, -R @ origin)


def _normal(rivet: Rivet, points: NDArray[np.float32], placement: Placement) -> tuple[float, float, float] | None:
    normal = skin_normal(points, rivet.u_px, rivet.v_px, _NORMAL_REACH * rivet.major_px)
    if normal is None:
        return None
    x, y, z = placement.R @ normal
    return float(x), float(y), float(z)


def _corners(course: Array, tolerance: float) -> list[int]:
    """Rows of a polyline (n, 3) that are enough to stay within a tolerance of the others (Douglas and Peucker 1973)."""
    last = len(course) - 1
    keep, todo = {0, last}, [(0, last)]
    while todo:
        start, stop = todo.pop()
        if stop - start < 2:
            continue
        leg = course[stop] - course[start]
        leg = leg / max(float(np.linalg.norm(leg)), 1e-12)
        offset = course[start + 1 : stop] - course[start]
        distance = np.linalg.norm(offset - (offset @ leg)[:, None] * leg, axis=1)
        if distance.max() > tolerance:
            split = start + 1 + int(distance.argmax())
            keep.add(split)
            todo += [(start, split), (split, stop)]
    return sorted(keep)
