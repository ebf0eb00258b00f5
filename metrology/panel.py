"""A panel's nominal pattern: where its rivets and seams should be, and where the rig stands to see them.

Panel frame: millimetres, of the specification's own choosing (usually the drawing's); positions are 3-D, so curved
panels need no unrolling. Patterns enrolled from a scan have x to the right and y up for a viewer outside, z outward.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from metrology.arrays import Array
from metrology.errors import SpecError


@dataclass(frozen=True)
class Placement:
    """Where the rig stands before a panel: a point x of the rig frame is at R x + t in the panel frame."""

    R: Array
    """(3, 3)."""
    t: Array
    """(3,): the left camera's centre in the panel frame, mm."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "R", np.array(self.R, float))
        object.__setattr__(self, "t", np.array(self.t, float))
        if self.R.shape != (3, 3) or self.t.shape != (3,):
            raise SpecError(f"placement: found shapes {self.R.shape} and {self.t.shape}, expected (3, 3) and (3,)")
        if np.abs(self.R @ self.R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(self.R) < 0:
            raise SpecError("placement: found R that is not a rotation, expected orthonormal rows and determinant +1")

    def to_panel(self, points: ArrayLike) -> Array:
        """Points (..., 3) of the rig frame in the panel frame."""
        return np.asarray(points, float) @ self.R.T + self.t

    def to_rig(self, points: ArrayLike) -> Array:
        """Points (..., 3) of the panel frame in the rig frame."""
        return (np.asarray(points, float) - self.t) @ self.R


@dataclass(frozen=True)
class NominalRivet:
    """A rivet as the panel should have it."""

    rivet_id: str
    position: tuple[float, float, float]
    """(x, y, z): centre of the head, panel frame, mm."""
    diameter_mm: float | None = None
    zone: str = "default"
    """Tolerance zone."""
    normal: tuple[float, float, float] | None = None
    """(x, y, z) or None: outward direction of the skin there; helps where rivets stand in one row."""
    row: str | None = None
    """Row that acceptance rules count it in."""
    location: str | None = field(default=None, compare=False)
    """Where it is on the aircraft, as people there say it (frame, stringer); nothing follows from it."""


@dataclass(frozen=True)
class NominalSeam:
    """A seam as the panel should have it."""

    seam_id: str
    course: tuple[tuple[float, float, float], ...]
    """tuple of (x, y, z): corners of the polyline along its middle, panel frame, mm; `s_mm` counts from the first."""
    zone: str = "default"
    """Tolerance zone."""
    airflow: tuple[float, float, float] | None = None
    """(x, y, z) or None: direction in which the air flows over the seam, panel frame; tells steps into the wind from
    those out of it."""
    stretches: tuple[tuple[float, float, str], ...] = ()
    """tuple of (from, to, zone): where along the seam, mm, another zone's limits hold."""

    def zone_at(self, s_mm: float) -> str:
        """The tolerance zone at a position along the seam."""
        return next((zone for start, end, zone in self.stretches if start <= s_mm <= end), self.zone)

    def __post_init__(self) -> None:
        corners = np.array(self.course, float)
        if corners.ndim != 2 or len(corners) < 2 or (np.linalg.norm(np.diff(corners, axis=0), axis=1) == 0).any():
            raise SpecError(
                f"seam {self.seam_id}: found a course of {len(self.course)} points, expected two or more different ones"
            )


@dataclass(frozen=True)
class PanelLayout:
    """The nominal pattern of a panel; empty where the specification gives none."""

    rivets: tuple[NominalRivet, ...] = ()
    seams: tuple[NominalSeam, ...] = ()
    stations: Mapping[str, Placement] = field(default_factory=dict)
    """Nominal placements of the rig by station."""

    def __post_init__(self) -> None:
        for kind, ids in (
            ("rivet", [rivet.rivet_id for rivet in self.rivets]),
            ("seam", [seam.seam_id for seam in self.seams]),
        ):
            twice = sorted(name for name, count in Counter(ids).items() if count > 1)
            if twice:
                raise SpecError(f"{kind} {twice[0]}: found it twice in the pattern, expected each id once")

    @property
    def empty(self) -> bool:
        """Whether there is nothing to recognise."""
        return not self.rivets and not self.seams


@dataclass(frozen=True)
class Foot:
    """The nearest places on a polyline to n points."""

    s: Array
    """(n,): arc length from the polyline's start, mm; negative or beyond its length where a point lies past an end."""
    offset: Array
    """(n, 3): from the polyline to the point, mm; the line is taken to go on straight past its ends."""
    tangent: Array
    """(n, 3): unit direction of the polyline there."""

    @property
    def distance(self) -> Array:
        """(n,) mm."""
        return np.asarray(np.linalg.norm(self.offset, axis=1))


def foot_on(course: ArrayLike, points: ArrayLike) -> Foot:
    """Feet of points (n, 3) on a polyline (m, 3)."""
    corners, points = np.asarray(course, float), np.asarray(points, float).reshape(-1, 3)
    legs = np.diff(corners, axis=0)
    lengths = np.linalg.norm(legs, axis=1)
    along = legs / lengths[:, None]
    s = np.einsum("nmk,mk->nm", points[:, None] - corners[:-1], along)
    low, high = np.zeros(len(legs)), lengths.copy()
    low[0], high[-1] = -np.inf, np.inf  # the end legs go on straight
    s = np.clip(s, low, high)
    offset = points[:, None] - corners[:-1] - s[..., None] * along
    nearest = np.linalg.norm(offset, axis=2).argmin(1)
    rows = np.arange(len(points))
    start = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
    return Foot(s[rows, nearest] + start[nearest], offset[rows, nearest], along[nearest])


def points_along(course: ArrayLike, s: Array) -> Array:
    """(n, 3) points of a polyline (m, 3) at arc lengths s (n,) within its length."""
    corners = np.asarray(course, float)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    return np.column_stack([np.interp(s, arc, corners[:, k]) for k in range(3)])


def course_length(course: ArrayLike) -> float:
    """Length of a polyline (m, 3), mm."""
    return float(np.linalg.norm(np.diff(np.asarray(course, float), axis=0), axis=1).sum())
