"""A hole's rim: where the skin ends in both pictures, and where its height ends in the cloud.

A camera sees the rim as an edge where the hole's wall, or the dark in it, begins behind it. On the side that is nearer
to the camera the skin hides the wall, and what lies deeper may be as bright as the skin: there the other camera tells,
or the cloud, in which the height falls.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.rig import Device
from metrology.rivets.bilinear import sample_image
from metrology.rivets.patch import Patch
from metrology.robust import fit_circle, from_scratch
from metrology.surfaces import Polynomial

View = tuple[Device, NDArray[np.float32]]

DIRECTIONS = 72
_SPACING_PX = 0.25
_CONTRAST = 0.2  # of the skin's brightness: an edge; grain is a tenth of it
_PLATEAU_PX = 1.5  # behind an edge that must stay as dark, or blur moves its middle
_PLATEAU = 0.7
_QUARTER = 0.674  # standard deviations from a quarter of a blurred step to its half
_MOST_BLUR_PX = 1.25  # of a camera that sees sharply; a wider edge is a wall's shade
FALL_MM = 0.25
"""Below the skin: over the rim."""
EDGE_SD_PX = 0.08  # systematic: what the blur of a curved edge and a wall's shine move it by
CLOUD_SD_PX = 0.5
_SCATTER_PX = 0.2  # of a radius by its edges' scatter: they follow no one circle
_SHARED = 4.0  # neighbouring edges that are worth one
_SURE = 4.0  # standard deviations of a depth that is beyond doubt
_DEEPER_MM = 0.2  # than was taken: beyond noise on any rig
_TOLD, _BROKEN_MM = 2.5, 0.1  # standard deviations, and depth, from which on an edge is broken
_DRAWN = 0.5  # of their scatter may all edges be off to one side
_NEAREST_PX = 0.02  # of an edge off its place: sampled profiles tell it no better


@dataclass(frozen=True)
class Edges:
    """Places of a rim on the skin."""

    x: Array
    y: Array
    """x, y: (n,): mm, in the patch's frame."""
    direction: NDArray[np.int64]
    """(n,) of int: in which of `DIRECTIONS` each lies."""
    lean: Array
    """(n,): how far out it seems to lie for each mm that it lies deeper than was taken."""
    sd_px: float
    """How far one may lie off its place systematically, px."""
    blur_px: float = 0.0
    """Standard deviation of the blur over which it was found: that of a curved line lies too far inside."""

    def at(self, which: NDArray[np.bool_]) -> Edges:
        """Some of them."""
        some = {name: getattr(self, name)[which] for name in ("x", "y", "direction", "lean")}
        return replace(self, **some)

    @property
    def directions(self) -> int:
        """Different directions in which there is one."""
        return len(np.unique(self.direction))


@dataclass(frozen=True)
class RimCircle:
    """A circle of edges."""

    x: float
    y: float
    radius: float
    radius_sd: float
    """x, y, radius, radius_sd: mm."""
    directions: int
    """In how many of them an edge is on it."""
    deeper: float = 0.0
    """By how much it lies deeper than was taken, mm; 0 where that does not show."""
    broken: float = 0.0
    """The same where it shows, but may be no more than a broken edge, mm."""

    @property
    def below_broken_edge(self) -> RimCircle:
        """The bore below a broken edge of 45°: narrower by nothing to twice the depth at which the edge is seen."""
        sd = float(np.hypot(self.radius_sd, 0.5 * self.broken / np.sqrt(3)))
        return replace(self, radius=self.radius - 0.5 * self.broken, radius_sd=sd)


def picture_edges(
    patch: Patch,
    skin: Polynomial,
    views: tuple[View, ...],
    pixel_mm: float,
    start: float,
    outside: float,
    deeper: float = 0.0,
) -> Edges:
    """Edges of the skin along directions from the patch's centre, in either picture.

    Parameters
    ----------
    views : tuple of (Device, texture)
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
    found: list[tuple[int, float, float, Array]] = []
    outer = radii > outside
    for device, texture in views:
        profiles = sample_image(texture, device.project(places))
        eye = patch.frame.local(device.centre)
        for k in np.flatnonzero(np.isfinite(profiles).all(axis=1)):
            at = _edge(np.abs(profiles[k] / np.median(profiles[k, outer]) - 1))
            if at is not None:
                found.append((int(k), float(np.interp(at[0], np.arange(len(radii)), radii)), at[1], eye))
    if not found:
        return Edges(np.empty(0), np.empty(0), np.empty(0, int), np.empty(0), EDGE_SD_PX)
    which, r, blur, eyes = (np.array(column) for column in zip(*found, strict=True))
    lean = leans(r, turn[which], eyes)
    return Edges(
        r * np.cos(turn[which]),
        r * np.sin(turn[which]),
        which,
        lean,
        EDGE_SD_PX,
        min(float(np.median(blur)), _MOST_BLUR_PX),
    )


def leans(radius: Array, turn: Array, eye: Array) -> Array:
    """(n,) how far outwards places seem to move on the skin for each mm that they lie below it.

    Parameters
    ----------
    radius, turn : (n,) ndarray
        Of places on the skin, mm and radians.
    eye : (n, 3) or (3,) ndarray
        Where the camera is, in the patch's frame, mm.
    """
    return np.asarray((eye[..., 0] * np.cos(turn) + eye[..., 1] * np.sin(turn) - radius) / eye[..., 2])


def _edge(departure: Array) -> tuple[float, float] | None:
    """Where a profile's departure from the skin first reaches half of what it then stays at (index); None without.

    With the blur (px) that the way from a quarter to the half tells.
    """
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
    i = j
    while i > 0 and departure[i - 1] >= 0.5 * half:
        i -= 1
    if i == 0:
        return None
    at, before = (
        k - 1 + float((level - departure[k - 1]) / (departure[k] - departure[k - 1]))
        for k, level in ((j, half), (i, 0.5 * half))
    )
    return at, (at - before) * _SPACING_PX / _QUARTER


def cloud_edges(patch: Patch, height: Array, pixel_mm: float, within: float, fall_mm: float = FALL_MM) -> Edges:
    """Edges where the cloud leaves the skin: half a pixel beyond the last point on it, by direction."""
    r, turn = np.hypot(patch.x, patch.y), np.arctan2(patch.y, patch.x)
    sector = ((turn + np.pi) / (2 * np.pi) * DIRECTIONS).astype(int) % DIRECTIONS
    x, y, directions = [], [], []
    for k in range(DIRECTIONS):
        here = (sector == k) & (r < within + 6 * pixel_mm) & (r > 0.3 * within)
        off, on = here & (height < -fall_mm), here & (np.abs(height) < fall_mm)
        if not on.any():
            continue
        inner = float(r[on].min())
        last = float(r[off & (r < inner + 2 * pixel_mm)].max(initial=0.0))
        edge = 0.5 * (inner + last) if inner - last < 2 * pixel_mm else inner - 0.5 * pixel_mm
        angle = (k + 0.5) * 2 * np.pi / DIRECTIONS - np.pi
        x.append(edge * np.cos(angle))
        y.append(edge * np.sin(angle))
        directions.append(k)
    return Edges(np.array(x), np.array(y), np.array(directions, int), np.zeros(len(x)), CLOUD_SD_PX)


def rim_circle(edges: Edges, pixel_mm: float) -> RimCircle | None:
    """The circle through edges, those that lie off it left out; None where they follow none.

    Edges that lie deeper than was taken move outwards in one camera where they move inwards in the other. By how much
    they do tells how deep they lie, and how far the circle may be off where walls and shadows do the same. A blurred
    circle of radius r lies σ²/2r too far inside: that is taken off.
    """
    if len(edges.x) < 8:
        return None
    found = fit_circle(edges.x, edges.y, _NEAREST_PX * pixel_mm)
    if found is None:
        return None
    away = np.stack([edges.x - found.x, edges.y - found.y], axis=1)
    distance = np.linalg.norm(away, axis=1)
    kept = found.weights > 0
    off = distance - found.radius
    rows = np.column_stack([away / distance[:, None], np.ones(len(away))])
    spread, deviation = _uncertainty(off, rows, kept)
    # Neighbouring edges share their pixels, and what scatters far is drawn by shadows, all to one side.
    if deviation > _SCATTER_PX * pixel_mm:
        return None
    depth, depth_sd, by_depth = _depth(edges, off, rows, pixel_mm)
    deeper = depth if abs(depth) > max(_SURE * depth_sd, _DEEPER_MM) else 0.0
    broken = depth if depth > max(_TOLD * depth_sd, _BROKEN_MM) else 0.0
    sd = float(np.linalg.norm([deviation, edges.sd_px * pixel_mm, _DRAWN * spread, by_depth]))
    radius = found.radius + 0.5 * (edges.blur_px * pixel_mm) ** 2 / found.radius
    return RimCircle(found.x, found.y, radius, sd, len(np.unique(edges.direction[kept])), deeper, broken)


def _uncertainty(off: Array, rows: Array, kept: NDArray[np.bool_]) -> tuple[float, float]:
    """Scatter of what is kept, and the standard deviation of the radius (third unknown) that comes of it, mm."""
    spread = float(np.sqrt(np.mean(off[kept] ** 2)))
    normal = rows[kept].T @ rows[kept] + 1e-9 * np.eye(rows.shape[1])
    return spread, spread * float(np.sqrt(_SHARED * np.linalg.inv(normal)[2, 2]))


def _depth(edges: Edges, off: Array, rows: Array, pixel_mm: float) -> tuple[float, float, float]:
    """By how much edges lie deeper than was taken, its standard deviation, and how far it moves them, mm.

    One camera does not tell: there a circle that lies deeper is one that lies elsewhere. What is not told is 0.
    """
    nothing = 0.0, 0.0, 0.0
    lean = float(np.sqrt(np.mean(edges.lean**2)))
    if lean == 0:
        return nothing
    design = np.column_stack([rows, edges.lean])
    leaning = from_scratch(design, off, 8, 15, _NEAREST_PX * pixel_mm)
    if leaning is None:
        return nothing
    kept = leaning.weights > 0
    spread = float(np.sqrt(np.mean((off - design @ leaning.values)[kept] ** 2)))
    normal = design[kept].T @ design[kept] + 1e-9 * np.eye(4)
    depth, sd = float(leaning.values[3]), spread * float(np.sqrt(_SHARED * np.linalg.inv(normal)[3, 3]))
    return nothing if sd * lean > CLOUD_SD_PX * pixel_mm else (depth, sd, abs(depth) * lean)
