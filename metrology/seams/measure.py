"""Step and width at seam stations along each seam (paper §4.2, Figs 5–8): skin lines, gap, rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from metrology.arrays import Array, Mask
from metrology.cloud import Reconstruction
from metrology.fits import FittedStation, SectionFit
from metrology.plausibility import plausible_station
from metrology.results import COVERAGE_95, RivetDetection, SeamLine, SeamStation
from metrology.seams.gap.find import find_gaps
from metrology.seams.gap.width import Gap, gap_width
from metrology.seams.places import head_mask
from metrology.seams.settings import SeamSettings
from metrology.seams.sides import is_upright, oriented, towards_b
from metrology.seams.skins.neighbours import smoothed_sections
from metrology.seams.skins.one_sided import stand_out, with_one_sided_bends
from metrology.seams.skins.other_seams import coarse_course, gap_mask
from metrology.seams.skins.sections import Section, section_at, usable_points
from metrology.seams.skins.step import step_height, step_u95, with_unresolved_bends
from metrology.seams.skins.track import Track, lay_on_skin

# "Under … mm" says something of a gap up to here.
_WIDEST_BOUND_MM = 1.0
# A rivet's rim and countersink reach this far beyond its ellipse, px.
_RIVET_GUARD_PX = 6.0


@dataclass(frozen=True)
class _Place:
    """Where a seam station stands, where its skin begins, and its section or the reason why there is none."""

    s_mm: float
    pixel: Array
    half_width_mm: float
    inner_mm: float
    section: Section | str


@dataclass(frozen=True)
class _Ground:
    """What a seam is measured on."""

    reconstruction: Reconstruction
    clear: Mask
    """(h, w) of bool: points that may carry a skin line, off rivets and other seams."""
    heads: Mask
    """(h, w) of bool: rivet heads and what is close around them."""
    other_courses: list[Array]
    """list of (m, 2): of the other seams, left image."""
    upright: bool
    """Whether the seam is nearer to vertical in the left image, see `sides`."""
    settings: SeamSettings


def measure_seams(
    lines: Sequence[SeamLine],
    reconstruction: Reconstruction,
    rivets: Sequence[RivetDetection],
    settings: SeamSettings | None = None,
) -> list[SeamStation]:
    """Seam stations of all seams that have relief.

    Parameters
    ----------
    rivets : sequence of RivetDetection
        Skin lines keep clear of them, and a seam station over one says so.

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
    masks = [gap_mask(line, settings.guard_px, usable.shape) for line in lines] if len(lines) > 1 else []
    stations = []
    for seam in seams:
        others = [other for other in seams if other is not seam]
        clear = usable.copy()
        # What lies on the skin is no skin, nor is what a flush seam is sealed with.
        for other, mask in zip(lines, masks, strict=False):
            if other is not seam:
                clear &= ~mask
        track = lay_on_skin(oriented(seam.centre_px), seam.width_px, reconstruction, clear, settings.guard_px)
        if track is not None:
            courses = [coarse_course(other) for other in others]
            ground = _Ground(reconstruction, clear, heads, courses, is_upright(seam.centre_px), settings)
            stations += _measure_seam(seam, track, ground)
    return stations


def _measure_seam(seam: SeamLine, track: Track, ground: _Ground) -> list[SeamStation]:
    """Skin lines, then the gap between them, then what both say of each place along the seam."""
    settings = ground.settings
    s_mm = np.arange(0.0, track.length_mm + 1e-9, settings.station_step_mm)
    places = _without_outliers(_places(track, s_mm, ground))
    own = [_section(place) for place in places]
    sections = smoothed_sections(own, s_mm, settings.half_length_mm)
    half_widths = [place.half_width_mm for place in places]
    gaps, joint = find_gaps(sections, half_widths, seam.joint, ground.reconstruction, ground.heads, settings)
    rows = [
        _row(seam.seam_id, place, section, gap, ground).changed(joint=joint)
        for place, section, gap in zip(places, sections, gaps, strict=True)
    ]
    rows = with_unresolved_bends(rows, settings.station_step_mm, settings.half_length_mm)
    rows = with_one_sided_bends(rows, own, [_edges(place, gap) for place, gap in zip(places, gaps, strict=True)])
    return [plausible_station(row) for row in rows]


def _places(track: Track, s_mm: Array, ground: _Ground) -> list[_Place]:
    """Every seam station's section."""
    settings = ground.settings
    origins, directions, pixels, widths_px = track.at(s_mm)
    across = towards_b(directions, origins, ground.upright)
    ahead = ground.reconstruction.rig.left.project(np.stack([origins, origins + across]))
    px_mm = np.linalg.norm(ahead[1] - ahead[0], axis=-1)
    halves = 0.5 * widths_px / px_mm
    inner = halves + settings.guard_px / px_mm
    u, v = np.clip(np.round(pixels).astype(int), 0, np.array(ground.heads.shape[::-1]) - 1).T
    over_a_rivet = ground.heads[v, u]

    def section(k: int) -> Section | str:
        if over_a_rivet[k]:
            return "over a rivet"
        return section_at(
            ground.reconstruction,
            ground.clear,
            origins[k],
            directions[k],
            across[k],
            pixels[k],
            float(inner[k]),
            float(inner[k]) + settings.skin_extent_mm,
            settings.half_length_mm,
            settings.min_points,
            ground.other_courses,
        )

    return [_Place(float(s_mm[k]), pixels[k], float(halves[k]), float(inner[k]), section(k)) for k in range(len(s_mm))]


def _section(place: _Place) -> Section | None:
    return place.section if isinstance(place.section, Section) else None


def _without_outliers(places: Sequence[_Place]) -> list[_Place]:
    """Seam stations without the sections that something on the skin has turned."""
    turned = stand_out([_section(place) for place in places])
    reason = "skin lines meet at another angle than beside: something lies on the skin"
    return [replace(place, section=reason) if off else place for place, off in zip(places, turned, strict=True)]


def _edges(place: _Place, gap: Gap | str) -> tuple[float, float]:
    """x of the ideal edges; of the line's borders where those are unknown."""
    return (gap.a.ideal_mm, gap.b.ideal_mm) if isinstance(gap, Gap) else (-place.half_width_mm, place.half_width_mm)


def _row(seam_id: str, place: _Place, section: Section | None, gap: Gap | str, ground: _Ground) -> SeamStation:
    u, v = (float(x) for x in place.pixel)
    if section is None:
        why = str(place.section)
        return SeamStation(seam_id, place.s_mm, x_mm=None, y_mm=None, z_mm=None, u_px=u, v_px=v, reason=why)
    # Without its edges a gap still has a step, which hardly depends on where exactly they are.
    a, b = _edges(place, gap)
    middle = section.midpoint(a, b)
    pixel = ground.reconstruction.rig.left.project(middle)
    row = FittedStation(
        seam_id,
        place.s_mm,
        x_mm=float(middle[0]),
        y_mm=float(middle[1]),
        z_mm=float(middle[2]),
        u_px=float(pixel[0]),
        v_px=float(pixel[1]),
        step_mm=step_height(section, a, b),
        step_u95_mm=step_u95(section, a, b),
        n_left=section.a.n,
        n_right=section.b.n,
        reason=gap if isinstance(gap, str) else None,
        fit=_kept(place, section, (a, b), ground.settings),
    )
    if isinstance(gap, str):
        return row
    width, u95 = gap_width(section, gap.a, gap.b), COVERAGE_95 * gap.sigma_width_mm
    if width < u95 <= _WIDEST_BOUND_MM:
        limit = max(width, 0.0) + u95
        return row.changed(reason=f"too narrow for its width to be measured: under {limit:.2f} mm")
    fit = replace(row.fit, depths_mm=(gap.a.depth_mm, gap.b.depth_mm)) if row.fit else None
    return row.changed(width_mm=width, width_u95_mm=u95, fit=fit)


def _kept(place: _Place, section: Section, edges: tuple[float, float], settings: SeamSettings) -> SectionFit:
    """What a seam station's values rest on."""
    outer = place.inner_mm + settings.skin_extent_mm
    return SectionFit(section.frame, section.a, section.b, edges, None, place.inner_mm, outer, settings.half_length_mm)
