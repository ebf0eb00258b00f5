"""A hole's rim: where the skin ends in both pictures, and where its height ends in the cloud.

A camera sees the rim as an edge where the hole's wall, or the dark in it, begins behind it. On the side that is nearer
to the camera the skin hides the wall, and what lies deeper may be as bright as the skin: there the other camera tells,
or the cloud, in which the height falls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.rig import Device
from metrology.rivets.bilinear import sample_image
from metrology.rivets.patch import Patch
from metrology.robust import fit_circle
from metrology.surfaces import Polynomial

Array = NDArray[np.float64]

DIRECTIONS = 72
_SPACING_PX = 0.25
_CONTRAST = 0.2  # of the skin's brightness: an edge; grain is a tenth of it
_PLATEAU_PX = 1.5  # behind an edge that must stay as dark, or blur moves its middle
_PLATEAU = 0.7
_FALL_MM = 0.25  # below the skin: over the rim
_EDGE_SD_PX = 0.08  # systematic: what the blur of a curved edge and a wall's shine move it by
_CLOUD_SD_PX = 0.5
_SHARED = 4.0  # neighbouring edges that are worth one
_NEAREST_PX = 0.02  # of an edge off its place: sampled profiles tell it no better


@dataclass(frozen=True)
class Edges:
    """Places of a rim on the skin.

    Attributes
    ----------
    x, y : (n,) ndarray
        mm, in the patch's frame.
    direction : (n,) ndarray of int
        In which of `DIRECTIONS` each lies.
    sd_px : float
        How far one may lie off its place systematically, px.
    """

    x: Array
    y: Array
    direction: NDArray[np.int64]
    sd_px: float

    @property
    def directions(self) -> int:
        """Different directions in which there is one."""
        return len(np.unique(self.direction))


@dataclass(frozen=True)
class RimCircle:
    """A circle on the skin, the standard deviation of its radius, mm, and in how many directions an edge is on it."""

    x: float
    y: float
    radius: float
    radius_sd: float
    directions: int


def picture_edges(
    patch: Patch,
    skin: Polynomial,
    views: tuple[tuple[Device, NDArray[np.float32]], ...],
    pixel_mm: float,
    start: float,
    outside: float,
    deeper: float = 0.0,
) -> Edges:
    """Edges of the skin along directions from the patch's centre, in either picture.

    Parameters
    ----------
    patch : Patch
    skin : Polynomial
    views : tuple of (Device, texture)
    pixel_mm : float
    start : float
        Radius from which profiles begin, mm.
    outside : float
        Radius beyond which all lies outside the rim, mm: there the profiles tell the brightness.
    deeper : float
        By how much the rim lies below the skin, mm.
    """
    radii = np.arange(start, 0.3 * outside, -_SPACING_PX * pixel_mm)  # from the skin inwards
    turn = np.arange(DIRECTIONS) * (2 * np.pi / DIRECTIONS)
    cosine, sine = np.cos(turn)[:, None], np.sin(turn)[:, None]
    x, y = cosine * radii, sine * radii
    places = patch.frame.rig(np.stack([x, y, skin.height(x, y) - deeper], axis=-1))
    found: list[tuple[int, float]] = []
    outer = radii > outside
    for device, texture in views:
        profiles = sample_image(texture, device.project(places))
        for k in np.flatnonzero(np.isfinite(profiles).all(axis=1)):
            at = _edge(np.abs(profiles[k] / np.median(profiles[k, outer]) - 1))
            if at is not None:
                found.append((int(k), float(np.interp(at, np.arange(len(radii)), radii))))
    which = np.array([k for k, _ in found], int)
    r = np.array([radius for _, radius in found])
    return Edges(r * np.cos(turn[which]), r * np.sin(turn[which]), which, _EDGE_SD_PX)


def _edge(departure: Array) -> float | None:
    """Where a profile's departure from the skin first reaches half of what it then stays at (index); None without."""
    beyond = np.flatnonzero(departure > _CONTRAST)
    if len(beyond) == 0:
        return None
    first = int(beyond[0])
    span = int(_PLATEAU_PX / _SPACING_PX)
    behind = departure[first : first + 4 * span]
    if len(behind) < 2 * span or (behind > _PLATEAU * behind.max()).sum() < span:
        return None
    half = 0.5 * float(behind.max())
    j = first + int(np.argmax(behind >= half)) if departure[first] < half else first
    while j > 0 and departure[j - 1] >= half:
        j -= 1
    if j == 0:
        return None
    low, high = departure[j - 1], departure[j]
    return j - 1 + float((half - low) / (high - low))


def cloud_edges(patch: Patch, height: Array, pixel_mm: float, within: float) -> Edges:
    """Edges where the cloud leaves the skin: half a pixel beyond the last point on it, by direction."""
    r, turn = np.hypot(patch.x, patch.y), np.arctan2(patch.y, patch.x)
    sector = ((turn + np.pi) / (2 * np.pi) * DIRECTIONS).astype(int) % DIRECTIONS
    x, y, directions = [], [], []
    for k in range(DIRECTIONS):
        here = (sector == k) & (r < within + 6 * pixel_mm) & (r > 0.3 * within)
        off, on = here & (height < -_FALL_MM), here & (np.abs(height) < _FALL_MM)
        if not on.any():
            continue
        inner = float(r[on].min())
        last = float(r[off & (r < inner + 2 * pixel_mm)].max(initial=0.0))
        edge = 0.5 * (inner + last) if inner - last < 2 * pixel_mm else inner - 0.5 * pixel_mm
        angle = (k + 0.5) * 2 * np.pi / DIRECTIONS - np.pi
        x.append(edge * np.cos(angle))
        y.append(edge * np.sin(angle))
        directions.append(k)
    return Edges(np.array(x), np.array(y), np.array(directions, int), _CLOUD_SD_PX)


def rim_circle(edges: Edges, pixel_mm: float) -> RimCircle | None:
    """The circle through edges, those that lie off it left out."""
    if len(edges.x) < 8:
        return None
    found = fit_circle(edges.x, edges.y, _NEAREST_PX * pixel_mm)
    if found is None:
        return None
    kept = found.weights > 0
    spread = float(np.sqrt(np.mean(found.off(edges.x, edges.y)[kept] ** 2)))
    away = np.stack([edges.x - found.x, edges.y - found.y], axis=1)[kept]
    rows = np.column_stack([away / np.linalg.norm(away, axis=1)[:, None], np.ones(len(away))])
    # Neighbouring edges share their pixels: a quarter of them is independent.
    by_noise = spread * np.sqrt(_SHARED * np.linalg.inv(rows.T @ rows + 1e-9 * np.eye(3))[2, 2])
    sd = float(np.hypot(by_noise, edges.sd_px * pixel_mm))
    return RimCircle(found.x, found.y, found.radius, sd, len(np.unique(edges.direction[kept])))
