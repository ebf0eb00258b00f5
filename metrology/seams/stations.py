"""Step and width at stations along each seam (paper §4.2, Figs 5–8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import Reconstruction
from metrology.fits import FittedStation, SectionFit
from metrology.plausibility import plausible_station
from metrology.results import COVERAGE_95, RivetDetection, SeamLine, SeamStation
from metrology.seams.gap import Gap, gap_width, midpoint, step_gradient, step_height
from metrology.seams.image_edges import image_edges
from metrology.seams.leaning import steadied
from metrology.seams.places import head_mask
from metrology.seams.plates import coarse_course, gap_mask
from metrology.seams.point_edges import point_edges
from metrology.seams.sections import Section, section_at, usable_points
from metrology.seams.settings import SeamSettings
from metrology.seams.sides import is_upright, oriented, towards_b
from metrology.seams.skin_lines import CLUMPING_MEDIAN
from metrology.seams.tracks import Track, lay_on_skin

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# "Under … mm" says something of a gap up to here.
_WIDEST_BOUND_MM = 1.0
# A rivet's rim and countersink reach this far beyond its ellipse, px.
_RIVET_GUARD_PX = 6.0


@dataclass(frozen=True)
class _Station:
    """Where a station stands, where its skin begins, and its section or the reason why there is none."""

    s_mm: float
    pixel: Array
    half_width_mm: float
    inner_mm: float
    section: Section | str


@dataclass(frozen=True)
class _Ground:
    """What a seam is measured on.

    Attributes
    ----------
    reconstruction : Reconstruction
    clear : (h, w) ndarray of bool
        Points that may carry a skin line, off rivets and other seams.
    heads : (h, w) ndarray of bool
        Rivet heads and what is close around them.
    other_courses : list of (m, 2) ndarray
        Of the other seams, left image.
    upright : bool
        Whether the seam is nearer to vertical in the left image, see `sides`.
    settings : SeamSettings
    """

    reconstruction: Reconstruction
    clear: Mask
    heads: Mask
    other_courses: list[Array]
    upright: bool
    settings: SeamSettings


def measure_seams(
    lines: Sequence[SeamLine],
    reconstruction: Reconstruction,
    rivets: Sequence[RivetDetection],
    settings: SeamSettings | None = None,
) -> list[SeamStation]:
    """Stations of all seams that have relief.

    Parameters
    ----------
    lines : sequence of SeamLine
    reconstruction : Reconstruction
    rivets : sequence of RivetDetection
        Skin lines keep clear of them, and a station over one says so.
    settings : SeamSettings, optional

    Returns
    -------
    list of SeamStation
        One for every `station_step_mm` along every seam; what could not be measured is None, with the reason.
    """
    settings = settings or SeamSettings()
    usable = usable_points(reconstruction)
    heads = head_mask(rivets, usable.shape, _RIVET_GUARD_PX)
    usable &= ~heads
    seams = [line for line in lines if line.relief]
    stations = []
    for seam in seams:
        others = [other for other in seams if other is not seam]
        clear = usable.copy() if others else usable
        for other in others:
            clear &= ~gap_mask(other, settings.guard_px, usable.shape)
        track = lay_on_skin(oriented(seam.centre_px), seam.width_px, reconstruction, clear, settings.guard_px)
        if track is not None:
            courses = [coarse_course(other) for other in others]
            ground = _Ground(reconstruction, clear, heads, courses, is_upright(seam.centre_px), settings)
            stations += _measure_seam(seam.seam_id, track, ground)
    return stations


def _measure_seam(seam_id: str, track: Track, ground: _Ground) -> list[SeamStation]:
    settings, reconstruction = ground.settings, ground.reconstruction
    places = np.arange(0.0, track.length_mm + 1e-9, settings.station_step_mm)
    stations = [_place(track, float(s), ground) for s in places]
    sections = _sections(stations, places, settings.half_length_mm)
    half_widths = [station.half_width_mm for station in stations]
    if settings.edges == "points":
        gaps = point_edges(
            sections,
            reconstruction,
            reconstruction.valid & ~ground.heads,
            settings.half_length_mm,
            max(half_widths) + settings.skin_extent_mm,
            settings.tolerance_sigmas,
            np.deg2rad(settings.merge_angle_deg),
        )
    else:
        gaps = image_edges(sections, half_widths, reconstruction, settings.half_length_mm, settings.chamfer_deg)
    rows = [
        _row(seam_id, station, section, gap, ground)
        for station, section, gap in zip(stations, sections, gaps, strict=True)
    ]
    rows = _with_unevenness(rows, settings.station_step_mm, settings.half_length_mm)
    return [plausible_station(row) for row in rows]


def _with_unevenness(rows: list[SeamStation], station_step: float, half_length: float) -> list[SeamStation]:
    """What a station's strip does not resolve, added to the step's uncertainty.

    The mean over ±ε_d of a step that bends along the seam by h″ is off by ``h″ ε_d²/6``; the nearest stations before
    and behind that share no point with it tell h″.
    """
    apart = int(np.ceil(2 * half_length / station_step))
    step = np.array([np.nan if row.step_mm is None else row.step_mm for row in rows])
    bend = np.zeros(len(rows))
    bend[apart:-apart] = step[2 * apart :] - 2 * step[apart:-apart] + step[: -2 * apart]
    missed = np.nan_to_num(bend) / (apart * station_step) ** 2 * half_length**2 / 6
    return [
        replace(row, step_u95_mm=float(np.hypot(row.step_u95_mm, COVERAGE_95 * off))) if row.step_u95_mm else row
        for row, off in zip(rows, missed, strict=True)
    ]


def _sections(stations: Sequence[_Station], s_mm: Array, half_length: float) -> list[Section | None]:
    """The stations' sections, steadied by one another; None where there is none."""
    sections = [station.section if isinstance(station.section, Section) else None for station in stations]
    # How neighbouring points' errors go together is the same all along; one section tells it poorly, and one with dirt
    # in it wrongly.
    clumpings = [section.clumping for section in sections if section is not None]
    clumping = max(1.0, float(np.median(clumpings or [1.0])) / CLUMPING_MEDIAN)
    scaled = [replace(section, covariance=clumping * section.covariance) if section else None for section in sections]
    return steadied(scaled, s_mm, half_length)


def _place(track: Track, s: float, ground: _Ground) -> _Station:
    """One station's section."""
    settings = ground.settings
    origin, direction, pixel, width_px = track.at(s)
    across = towards_b(direction, origin, ground.upright)
    ahead = ground.reconstruction.rig.left.project(np.stack([origin, origin + across]))
    px_mm = float(np.linalg.norm(ahead[1] - ahead[0]))
    half = 0.5 * width_px / px_mm
    inner = half + settings.guard_px / px_mm
    u, v = np.clip(np.round(pixel).astype(int), 0, np.array(ground.heads.shape[::-1]) - 1)
    if ground.heads[v, u]:
        return _Station(s, pixel, half, inner, "over a rivet")
    section = section_at(
        ground.reconstruction,
        ground.clear,
        origin,
        direction,
        across,
        pixel,
        (inner, inner),
        (inner + settings.skin_extent_mm,) * 2,
        settings.half_length_mm,
        settings.min_points,
        ground.other_courses,
    )
    return _Station(s, pixel, half, inner, section)


def _row(seam_id: str, station: _Station, section: Section | None, gap: Gap | str, ground: _Ground) -> SeamStation:
    u, v = (float(x) for x in station.pixel)
    if section is None:
        why = str(station.section)
        return SeamStation(seam_id, station.s_mm, x_mm=None, y_mm=None, z_mm=None, u_px=u, v_px=v, reason=why)
    # Without its edges a gap still has a step, which hardly depends on where exactly they are.
    half = station.half_width_mm
    a, b = (gap.a.ideal_mm, gap.b.ideal_mm) if isinstance(gap, Gap) else (-half, half)
    middle = midpoint(section, a, b)
    pixel = ground.reconstruction.rig.left.project(middle)
    row = FittedStation(
        seam_id,
        station.s_mm,
        x_mm=float(middle[0]),
        y_mm=float(middle[1]),
        z_mm=float(middle[2]),
        u_px=float(pixel[0]),
        v_px=float(pixel[1]),
        step_mm=step_height(section, a, b),
        step_u95_mm=_step_u95(section, a, b),
        n_left=section.a.n,
        n_right=section.b.n,
        reason=gap if isinstance(gap, str) else None,
        fit=_kept(station, section, (a, b), ground.settings),
    )
    if isinstance(gap, str):
        return row
    width, u95 = gap_width(section, gap.a, gap.b), COVERAGE_95 * gap.sigma_width_mm
    if width < u95 <= _WIDEST_BOUND_MM:
        limit = max(width, 0.0) + u95
        return replace(row, reason=f"too narrow for its width to be measured: under {limit:.2f} mm")
    fit = replace(row.fit, depths_mm=(gap.a.depth_mm, gap.b.depth_mm)) if row.fit else None
    return replace(row, width_mm=width, width_u95_mm=u95, fit=fit)


def _kept(station: _Station, section: Section, edges: tuple[float, float], settings: SeamSettings) -> SectionFit:
    """What a station's values rest on."""
    outer = station.inner_mm + settings.skin_extent_mm
    return SectionFit(
        section.frame, section.a, section.b, edges, None, station.inner_mm, outer, settings.half_length_mm
    )


def _step_u95(section: Section, a: float, b: float) -> float:
    """Expanded uncertainty of the step, from the skin lines' covariance."""
    gradient = step_gradient(a, b)
    return COVERAGE_95 * float(np.sqrt(gradient @ section.covariance @ gradient))
