"""Step and width at stations along each seam (paper §4.2, Figs 5–8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.cloud import Reconstruction
from metrology.results import Rivet, SeamLine, SeamStation
from metrology.seams.gap import GapEdge, gap_width, midpoint, step_gradient, step_height
from metrology.seams.image_edges import Edge, image_edges
from metrology.seams.point_edges import point_edges
from metrology.seams.sections import Section, section_at, usable_points
from metrology.seams.settings import SeamSettings
from metrology.seams.tracks import Track, lay_on_skin, oriented
from metrology.seams.views import both_views

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Two-sided 95 % of a normal distribution.
_COVERAGE_95 = 1.96
# A rivet's rim and countersink reach this far beyond its ellipse, px.
_RIVET_GUARD_PX = 6.0
# A dark band (gap and chamfers) narrower than this shows its borders merged by the blur, px.
_LEAST_BAND_PX = 7.5
# Neighbouring points share pixels of the matched phase: their noise averages out more slowly than if they were
# independent.
_CORRELATION = 1.4


@dataclass(frozen=True)
class _Station:
    """Where a station stands, its section or the reason why there is none, and the limit if its gap is too narrow."""

    s_mm: float
    pixel: Array
    half_width_mm: float
    section: Section | str
    narrow_limit_mm: float | None = None


def measure_seams(
    lines: Sequence[SeamLine],
    reconstruction: Reconstruction,
    rivets: Sequence[Rivet],
    settings: SeamSettings | None = None,
) -> list[SeamStation]:
    """Stations of all seams that have relief.

    Parameters
    ----------
    lines : sequence of SeamLine
    reconstruction : Reconstruction
    rivets : sequence of Rivet
        Skin lines keep clear of them, and a station over one says so.
    settings : SeamSettings, optional

    Returns
    -------
    list of SeamStation
        One for every `station_step_mm` along every seam; what could not be measured is None, with the reason.
    """
    settings = settings or SeamSettings()
    usable = usable_points(reconstruction)
    heads = rivet_mask(rivets, usable.shape)
    usable &= ~heads
    tracks = {
        line.seam_id: lay_on_skin(oriented(line.centre_px), line.width_px, reconstruction, usable, settings.guard_px)
        for line in lines
        if line.relief
    }
    stations = []
    for seam_id, track in tracks.items():
        if track is not None:
            stations += _measure_seam(seam_id, track, reconstruction, usable, heads, settings)
    return stations


def rivet_mask(rivets: Sequence[Rivet], shape: tuple[int, ...]) -> Mask:
    """(h, w) pixels on rivet heads and close around them."""
    mask = np.zeros(shape, np.uint8)
    for rivet in rivets:
        axes = (rivet.major_px / 2 + _RIVET_GUARD_PX, rivet.minor_px / 2 + _RIVET_GUARD_PX)
        centre = (round(rivet.u_px), round(rivet.v_px))
        cv2.ellipse(mask, centre, (round(axes[0]), round(axes[1])), rivet.angle_deg, 0, 360, 1, -1)
    return mask.astype(bool)


def _measure_seam(
    seam_id: str, track: Track, reconstruction: Reconstruction, usable: Mask, heads: Mask, settings: SeamSettings
) -> list[SeamStation]:
    places = np.arange(0.0, track.length_mm + 1e-9, settings.station_step_mm)
    stations = [_place(track, float(s), reconstruction, usable, heads, settings) for s in places]
    sections = [station.section if isinstance(station.section, Section) else None for station in stations]
    if settings.edges == "points":
        widest = max(station.half_width_mm for station in stations)
        edges = point_edges(
            sections,
            reconstruction,
            reconstruction.valid & ~heads,
            settings.half_length_mm,
            widest + settings.skin_extent_mm,
            settings.tolerance_sigmas,
            np.deg2rad(settings.merge_angle_deg),
        )
    else:
        wide = [
            None if station.narrow_limit_mm is not None else s for station, s in zip(stations, sections, strict=True)
        ]
        edges = image_edges(
            wide,
            [station.half_width_mm for station in stations],
            both_views(reconstruction),
            settings.half_length_mm,
            settings.min_edge_snr,
        )
    return [_row(seam_id, station, a, b, reconstruction) for station, (a, b) in zip(stations, edges, strict=True)]


def _place(
    track: Track, s: float, reconstruction: Reconstruction, usable: Mask, heads: Mask, settings: SeamSettings
) -> _Station:
    """One station's section."""
    origin, direction, pixel, width_px = track.at(s)
    rig = reconstruction.rig
    towards_b = _towards_b(track, origin, direction)
    ahead = rig.left.project(np.stack([origin, origin + towards_b]))
    px_mm = float(np.linalg.norm(ahead[1] - ahead[0]))
    half = 0.5 * width_px / px_mm
    u, v = np.clip(np.round(pixel).astype(int), 0, np.array(heads.shape[::-1]) - 1)
    if heads[v, u]:
        return _Station(s, pixel, half, "over a rivet")
    inner = half + settings.guard_px / px_mm
    section = section_at(
        reconstruction,
        usable,
        origin,
        direction,
        towards_b,
        pixel,
        (inner, inner),
        (inner + settings.skin_extent_mm,) * 2,
        settings.half_length_mm,
        settings.min_points,
    )
    limit = _LEAST_BAND_PX / px_mm if width_px < _LEAST_BAND_PX else None
    return _Station(s, pixel, half, section, limit if settings.edges == "image" else None)


def _towards_b(track: Track, origin: Array, direction: Array) -> Array:
    """Unit vector across the seam to side B: right of a seam nearer to vertical in the left image, else below it."""
    chord = track.pixels[-1] - track.pixels[0]
    axis = np.array([1.0, 0, 0]) if abs(chord[1]) >= abs(chord[0]) else np.array([0, 1.0, 0])
    across = axis - (axis @ direction) * direction
    view = origin / np.linalg.norm(origin)
    across -= (across @ view) * view
    return np.asarray(across / np.linalg.norm(across))


def _row(
    seam_id: str, station: _Station, a: Edge | None, b: Edge | None, reconstruction: Reconstruction
) -> SeamStation:
    section = station.section
    u, v = (float(x) for x in station.pixel)
    if not isinstance(section, Section):
        return SeamStation(seam_id, station.s_mm, None, None, None, u, v, reason=section)
    n_left, n_right = section.a.n, section.b.n
    if station.narrow_limit_mm is not None:
        return _narrow_row(seam_id, station, section, station.narrow_limit_mm, reconstruction)
    if a is None or b is None:
        missing = " and ".join(name for name, edge in (("A", a), ("B", b)) if edge is None)
        return SeamStation(
            seam_id,
            station.s_mm,
            None,
            None,
            None,
            u,
            v,
            n_left=n_left,
            n_right=n_right,
            reason=f"edge {missing} not seen by a camera",
        )
    middle = midpoint(section, a.ideal_mm, b.ideal_mm)
    pixel = reconstruction.rig.left.project(middle)
    width_variance = sum(e.sigma_border_mm**2 + e.sigma_chamfer_mm**2 for e in (a, b))
    return SeamStation(
        seam_id,
        station.s_mm,
        float(middle[0]),
        float(middle[1]),
        float(middle[2]),
        float(pixel[0]),
        float(pixel[1]),
        step_mm=step_height(section, a.ideal_mm, b.ideal_mm),
        step_u95_mm=_step_u95(section, a.ideal_mm, b.ideal_mm),
        width_mm=gap_width(section, GapEdge(a.ideal_mm, a.depth_mm), GapEdge(b.ideal_mm, b.depth_mm)),
        width_u95_mm=_COVERAGE_95 * float(np.sqrt(width_variance)),
        n_left=n_left,
        n_right=n_right,
    )


def _narrow_row(
    seam_id: str, station: _Station, section: Section, limit_mm: float, reconstruction: Reconstruction
) -> SeamStation:
    """Only the step: it hardly depends on where exactly the edges are."""
    a, b = -station.half_width_mm, station.half_width_mm
    middle = midpoint(section, a, b)
    pixel = reconstruction.rig.left.project(middle)
    return SeamStation(
        seam_id,
        station.s_mm,
        float(middle[0]),
        float(middle[1]),
        float(middle[2]),
        float(pixel[0]),
        float(pixel[1]),
        step_mm=step_height(section, a, b),
        step_u95_mm=_step_u95(section, a, b),
        n_left=section.a.n,
        n_right=section.b.n,
        reason=f"too narrow for its width to be measured: gap and chamfers together under {limit_mm:.2f} mm",
    )


def _step_u95(section: Section, a: float, b: float) -> float:
    """Expanded uncertainty of the step, from the skin lines' covariance."""
    gradient = step_gradient(a, b)
    return _COVERAGE_95 * _CORRELATION * float(np.sqrt(gradient @ section.covariance @ gradient))
