"""A scan as the assembly of a panel sees it: its features, its skin on a thinned image grid, and its rig."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from metrology.arrays import Array
from metrology.panel import Placement
from metrology.registration.rows import has_position, positions
from metrology.registration.search import PointPattern
from metrology.registration.view import in_view
from metrology.results import Features, Rivet, SceneKey, SeamStation, of_type
from metrology.rig import Rig
from metrology.skin_normal import skin_normal

STRIDE = 4
"""Pixels of the left image from one sample of a thinned cloud to the next."""
_NORMAL_REACH = 1.5  # in diameters of the head


@dataclass(frozen=True)
class Skin:
    """Points of the left image's grid, every STRIDE-th row and column."""

    points: NDArray[np.float32]
    """(h, w, 3) float32: rig frame, mm; NaN where none."""
    sigma: NDArray[np.float32]
    """(h, w) float32: standard deviation of a point's depth, mm."""

    @classmethod
    def thinned(cls, points: NDArray[np.float32], sigma: NDArray[np.float32]) -> Skin:
        """Of an organised cloud (h, w, 3) and its σ (h, w)."""
        return cls(points[::STRIDE, ::STRIDE].copy(), sigma[::STRIDE, ::STRIDE].copy())

    @cached_property
    def normals(self) -> NDArray[np.float32]:
        """(h, w, 3) unit normals towards the rig from neighbours two samples away; NaN where one is missing."""
        normals = np.full_like(self.points, np.nan)
        p = self.points
        across, down = p[2:-2, 4:] - p[2:-2, :-4], p[4:, 2:-2] - p[:-4, 2:-2]
        cross = np.cross(across, down)
        with np.errstate(invalid="ignore", divide="ignore"):
            cross /= np.linalg.norm(cross, axis=2, keepdims=True)
        normals[2:-2, 2:-2] = np.where(cross[..., 2:] > 0, -cross, cross)
        return normals

    @cached_property
    def middle(self) -> Array:
        """(3,) median of the points."""
        return np.asarray(np.nanmedian(self.points.reshape(-1, 3), axis=0), float)

    def under(self, pixels: Array) -> Array:
        """Distance along the ray, as depth, of the skin at raw pixels (n, 2) of the left image; NaN where unknown.

        Interpolated on the grid: for a smooth skin it is exact to a micrometre.
        """
        depth = self.points[..., 2].astype(float)
        place = np.stack([pixels[:, 1], pixels[:, 0]]) / STRIDE
        return np.asarray(map_coordinates(depth, place, order=1, mode="constant", cval=np.nan))


@dataclass(frozen=True)
class PanelScan:
    """A scan of a panel."""

    key: SceneKey
    rig: Rig
    skin: Skin
    features: Features
    """As stored, by the names of the kinds."""
    across: Mapping[tuple[str, float], Array] = field(default_factory=dict)
    """mapping of (str, float) to (3,): from side A to side B of seam positions (seam_id, s_mm), rig frame, where it is
    kept."""
    nominal: Placement | None = None
    """In the frame of the specification's pattern, where the scan was recognised in it."""
    expected: Placement | None = None
    """Where the station should stand: good enough to know which scans cannot overlap."""

    @cached_property
    def heads(self) -> tuple[Rivet, ...]:
        """Rivets that were found beyond doubt and have a place."""
        return tuple(r for r in of_type(self.features, Rivet) if has_position(r) and r.is_found)

    @cached_property
    def pattern(self) -> PointPattern:
        """The heads as points with the skin's normals; NaN where those are unknown."""
        normals = np.full((len(self.heads), 3), np.nan)
        for k, head in enumerate(self.heads):
            reach = _NORMAL_REACH * head.major_px / STRIDE
            normal = skin_normal(self.skin.points, head.u_px / STRIDE, head.v_px / STRIDE, reach)
            if normal is not None:
                normals[k] = normal
        diameters = np.array([head.diameter_mm for head in self.heads], float)
        return PointPattern(positions(self.heads), normals, diameters)

    @cached_property
    def heights(self) -> Array:
        """(n, 2) height and its U95 of each head, mm; NaN where not measured."""
        return np.array([(h.height_mean_mm, h.height_u95_mm) for h in self.heads], float).reshape(-1, 2)

    @cached_property
    def seams(self) -> dict[str, list[SeamStation]]:
        """Positions that have a place, by seam, in their order along it."""
        found: dict[str, list[SeamStation]] = {}
        for row in sorted(of_type(self.features, SeamStation), key=lambda row: row.s_mm):
            if has_position(row) and row.is_found:
                found.setdefault(row.seam_id, []).append(row)
        return {name: rows for name, rows in found.items() if len(rows) > 1}

    def sees(self, points: Array, radius_mm: Array | float = 0.0) -> NDArray[np.bool_]:
        """Which places (n, 3) of its rig frame lie in its field, on skin that it measured."""
        seen = in_view(self.rig, points, radius_mm)
        if seen.any():
            seen[seen] = np.isfinite(self.skin.under(self.rig.left.project(points[seen])))
        return seen
