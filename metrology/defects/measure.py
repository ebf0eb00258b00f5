"""Dents, bumps, creases and scratches of a scan, measured against the skin as it would be without them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from metrology.arrays import Array
from metrology.defects.bottom import Bottom, bottom_of
from metrology.defects.cells import STEEPEST
from metrology.defects.form import form_of
from metrology.defects.nature import nature_of
from metrology.defects.outline import Outline, outline_at
from metrology.defects.patch import Patch, cut_patch
from metrology.defects.row import HiddenBy
from metrology.defects.settings import DefectSettings
from metrology.defects.skin_map import Region, SkinMap, skin_map
from metrology.defects.straight_edge import sections
from metrology.defects.surroundings import distances, is_pull_in, pull_in
from metrology.fits import FittedDefect
from metrology.results import COVERAGE_95, Rivet, SeamStation, of_type
from metrology.sighted import Sighted

_SURE = 2.5  # U95 of the skin that a defect must be deep: five standard deviations
_SURE_AT_END = 7.5  # where it deepens up to the end of the view: beyond the skin's last points nothing holds it
_CLIFF = 1.0  # slope of all of a flank, which no dent has that the view cuts
_OPEN = 0.25  # share of such an outline that lies there
_FOOT = 0.1  # of its depth
_SHOULDER = 1.5  # times as deep within its outline lies another's bottom, whose flank it is on
_FOOT_SDS = 2.5
_CUT = 0.04  # share of an outline that may lie elsewhere
_MOST_OF_PLATE = 0.4  # of a plate that a defect may cover for the rest to tell the skin
_LEAST_VIEW_MM = 15.0  # what is cut by the view and smaller may be a fastener
_EDGES = 6  # directions in which a straight-edge is laid
_VAGUE = 0.5  # of a scratch's depth that its U95 may be
_GRID = 0.3  # of a grid step, standard deviation of an extent beside that of its levels
_RESTS = 2.0  # standard deviations of the smoothed surface is the highest of its points about
_HIDDEN: dict[HiddenBy, str] = {
    "view": "it runs out of view: its depth and extents are at least these",
    "fastener": "its deepest point lies under a fastener: its depth is at least this",
    "points": "there are no points where it is deepest: its depth and extents are at least these",
    "seam": "its deepest point lies at a seam: its depth on this plate is at least this",
    "reference": "it fades out too slowly for the skin round it to tell where it ends: its depth and extents are at "
    "least these",
}
_VAGUE_RADIUS = 0.5  # of the bottom's radius that its U95 may be: a point or a fold is smaller than points show
_FOLLOWED = (
    0.1  # of its depth by which less skin round it moves that, or the skin is bent: the reference follows its foot
)
_ENDS_AT_SEAM = "its outline ends at a seam: its length and width are at least these"


@dataclass(frozen=True)
class _Found:
    """A region as it was measured.

    `seen` is its greatest smoothed depth, mm: whether it is one does not hang on how well its bottom is known.
    """

    region: Region
    patch: Patch
    bottom: Bottom
    outline: Outline
    spread_px: float
    depth_sd: float
    seen: float
    seen_sd: float


def measure_defects(sighted: Sighted, settings: DefectSettings | None = None) -> list[FittedDefect]:
    """The defects of a scan, numbered D01 … from the top of the left image down."""
    settings = settings or DefectSettings()
    skin = skin_map(sighted, settings)
    rivets = of_type(sighted.features, Rivet)
    usual = pull_in(skin, rivets)
    rows = []
    for region in skin.regions:
        found = _found(region, skin, sighted)
        if found is None or not _stands_out(found, settings):
            continue
        if not is_pull_in(found.outline, found.bottom.depth, found.patch, rivets, usual, settings.pull_in_mm):
            rows.append(_row(found, skin, sighted, settings))
    rows.sort(key=lambda row: (row.v_px, row.u_px))
    return [replace(row, defect_id=f"D{k:02d}") for k, row in enumerate(rows, 1)]


def _found(region: Region, skin: SkinMap, sighted: Sighted) -> _Found | None:
    patch = cut_patch(region, skin, sighted.reconstruction)
    if not patch.step_mm > 0:  # hardly a point of the region is left, and too few to lay a grid by
        return None
    spread = patch.spread_px(0.0)
    depth = patch.smoothed(spread)
    at = _deepest(patch, depth)
    outline = outline_at(patch, depth, 0.5 * float(depth[at]), at, patch.crossing_sd(spread))
    if outline is None or depth[outline.cells].max() > _SHOULDER * depth[at]:
        return None
    radii = 0.5 * outline.length, 0.5 * outline.width, outline.angle
    bottom = bottom_of(patch, outline.cells, at, radii)
    if bottom is None:
        return None
    radius = 0.5 * float(np.sqrt(outline.length * outline.width))
    narrower = patch.spread_px(radius, 0.5 * bottom.depth)
    again = outline_at(patch, patch.smoothed(narrower), 0.5 * bottom.depth, at, patch.crossing_sd(narrower))
    outline, spread = (again, narrower) if again else (outline, spread)
    x, y = (np.array([c]) for c in patch.reference.frame.local(patch.frame.rig([bottom.x, bottom.y, 0.0]))[:2])
    by_reference = float(patch.reference.variance(x, y)[0])
    window = region.rows, region.columns
    smoothed = np.where(region.cells, region.sign * skin.smoothed[window], -np.inf)
    place = np.unravel_index(int(smoothed.argmax()), smoothed.shape)
    seen = float(smoothed[place])
    if bottom.depth < seen:  # a form that does not follow its points
        bottom = replace(bottom, depth=seen, sd=float(np.hypot(bottom.sd, seen - bottom.depth)))
    # What makes its depth at least that is said, and not part of its uncertainty.
    followed = 0.0 if _follows(region, bottom) else region.followed
    skin_variance = by_reference + region.doubt**2 + followed**2
    sd = np.sqrt(bottom.sd**2 + skin.waves[region.plate] ** 2 + skin_variance)
    # Whether it is one hangs on how the skin may be bent there, and not on how high it lies.
    seen_sd = np.sqrt(skin.sd[window][place] ** 2 + by_reference / patch.reference.together + region.bend**2)
    return _Found(region, patch, bottom, outline, spread, float(sd), seen, float(seen_sd))


def _follows(region: Region, bottom: Bottom) -> bool:
    """Whether the reference may follow its foot by more than a small part of its depth."""
    return float(np.hypot(region.doubt, region.followed)) > _FOLLOWED * bottom.depth


def _deepest(patch: Patch, depth: Array) -> tuple[int, int]:
    seen = patch.own & patch.skin
    inside = np.where(seen if seen.any() else patch.own, depth, -np.inf)
    row, column = np.unravel_index(int(inside.argmax()), inside.shape)
    return int(row), int(column)


def _stands_out(found: _Found, settings: DefectSettings) -> bool:
    """Whether it is one for certain; what the view cuts may be the rim of a head, or the skin that curls there."""
    cut = found.outline.cut_by_view
    # What lies behind the panel's end is deep for its width, or has a cliff in view, however wide it is.
    steepest = (STEEPEST if cut < _CUT else _CLIFF) * 0.5 * found.outline.width
    cliff = found.region.sign > 0 and 0.5 * found.bottom.depth > steepest * found.outline.by_level
    if found.bottom.depth > steepest or cliff:
        return False
    # Beyond the view's end nothing tells how high the skin lies.
    sd = float(np.hypot(found.seen_sd, found.region.doubt)) if cut > _CUT else found.seen_sd
    sure = COVERAGE_95 * sd * (_SURE_AT_END if cut > _OPEN and found.bottom.hidden else _SURE)
    if found.seen < max(settings.least_depth_mm, sure):
        return False
    return cut < _CUT or found.outline.length > _LEAST_VIEW_MM


def _row(found: _Found, skin: SkinMap, sighted: Sighted, settings: DefectSettings) -> FittedDefect:
    patch, bottom, outline = found.patch, found.bottom, found.outline
    place = patch.frame.rig([bottom.x, bottom.y, _height(found)])
    u, v = sighted.reconstruction.rig.left.project(place)
    nature = nature_of(patch, bottom, outline, found.region.sign, settings)
    row = FittedDefect(
        "", x_mm=float(place[0]), y_mm=float(place[1]), z_mm=float(place[2]), u_px=float(u), v_px=float(v), kind=nature
    )
    own = skin.cells.plate == found.region.plate
    covered = float(found.region.cells.sum() / own.sum())
    if covered > _MOST_OF_PLATE:
        reason = f"it covers {covered:.0%} of the skin in view, so that the rest does not tell where the skin would be"
        return replace(row, decision="not measured", reason=reason)
    return _with_extents(_with_depth(row, found, settings), found, skin, sighted, settings)


def _height(found: _Found) -> float:
    """Of its deepest point over the tangent plane at the reference, about the negative depth, mm."""
    reference, frame = found.patch.reference, found.patch.frame
    x, y = (np.array([c]) for c in reference.frame.local(frame.rig([found.bottom.x, found.bottom.y, 0.0]))[:2])
    skin = reference.frame.rig([float(x[0]), float(y[0]), float(reference.height(x, y)[0])])
    return float(frame.local(skin)[2]) - found.region.sign * found.bottom.depth


def _with_depth(row: FittedDefect, found: _Found, settings: DefectSettings) -> FittedDefect:
    """Depth with its U95, and whether all of the defect was seen."""
    pixels = found.patch.true_pixels(found.outline.width, found.spread_px)
    if row.kind == "scratch" and pixels < settings.scratch_pixels:
        reason = f"line without measurable depth: narrower than the {settings.scratch_pixels:g} pixels that tell one"
        return replace(row, decision="not measured", reason=reason)
    if row.kind == "scratch" and COVERAGE_95 * found.depth_sd > _VAGUE * found.bottom.depth:
        reason = f"line without measurable depth: its points leave ±{COVERAGE_95 * found.depth_sd:.3f} mm"
        return replace(row, decision="not measured", reason=reason)
    u95 = COVERAGE_95 * found.depth_sd
    if u95 > found.bottom.depth:
        reason = f"its depth is told to ±{u95:.3f} mm alone"
        return replace(row, decision="not measured", reason=reason)
    hidden = _hidden_by(found)
    return replace(
        row,
        depth_mm=found.region.sign * found.bottom.depth,
        depth_u95_mm=u95,
        hidden_by=hidden,
        reason=_HIDDEN[hidden] if hidden else _ENDS_AT_SEAM if found.outline.cut_by_seam > _CUT else None,
    )


def _hidden_by(found: _Found) -> HiddenBy | None:
    if found.outline.cut_by_view > _CUT:
        return "view"
    if _follows(found.region, found.bottom):
        return "reference"
    if not found.bottom.hidden:
        return None
    patch, bottom = found.patch, found.bottom
    missing = np.flatnonzero(~patch.skin)
    away = np.hypot(patch.x.ravel()[missing] - bottom.x, patch.y.ravel()[missing] - bottom.y)
    nearest = missing[int(away.argmin())]
    if not patch.plate.ravel()[nearest]:
        return "seam"
    return "fastener" if patch.covered.ravel()[nearest] else "points"


def _with_extents(
    row: FittedDefect, found: _Found, skin: SkinMap, sighted: Sighted, settings: DefectSettings
) -> FittedDefect:
    """Extents, what follows from them and the depth, and distances."""
    patch, bottom, outline = found.patch, found.bottom, found.outline
    share = found.depth_sd / bottom.depth
    grid = _GRID * patch.step_mm
    length_u95, width_u95 = (
        COVERAGE_95 * float(np.linalg.norm([outline.by_level * share * extent, grid, sd]))
        for extent, sd in ((outline.length, outline.length_sd), (outline.width, outline.width_sd))
    )
    whole = outline.cut_by_seam <= _CUT  # what lies beyond the seam is another plate's
    away = distances(outline, patch.frame, of_type(sighted.features, Rivet), of_type(sighted.features, SeamStation))
    direction, major, minor = _in_image(found, sighted)
    row = replace(
        row,
        length_mm=outline.length,
        length_u95_mm=length_u95 if whole else None,
        width_mm=outline.width,
        width_u95_mm=width_u95 if whole else None,
        direction_deg=direction,
        major_px=major,
        minor_px=minor,
        area_mm2=outline.area,
        fastener_distance_mm=away.fastener,
        seam_distance_mm=away.seam,
        distance_u95_mm=width_u95,
    )
    return row if row.depth_mm is None else _with_shape(row, found, skin, sighted, settings)


def _with_shape(
    row: FittedDefect, found: _Found, skin: SkinMap, sighted: Sighted, settings: DefectSettings
) -> FittedDefect:
    """What needs a depth: ratios, the foot, volume, the bottom's radius, depth under a straight-edge, and its form."""
    patch, bottom, outline = found.patch, found.bottom, found.outline
    row = _with_radius(row, bottom)
    if row.hidden_by is None:  # of two that are at least these nothing is known of one over the other
        width = _over_depth(found, row.width_mm, row.width_u95_mm)
        length = _over_depth(found, row.length_mm, row.length_u95_mm)
        row = replace(
            row,
            width_to_depth=width[0],
            width_to_depth_u95=width[1],
            length_to_depth=length[0],
            length_to_depth_u95=length[1],
        )
    radius = 0.5 * float(np.sqrt(outline.length * outline.width))
    spread = patch.spread_px(radius)
    depth = patch.smoothed(spread)
    level = max(_FOOT * bottom.depth, _FOOT_SDS * found.depth_sd)
    foot = outline_at(patch, depth, level, _deepest(patch, depth), patch.crossing_sd(spread))
    if foot is not None:
        volume = float(depth[foot.cells].sum()) * patch.cell_mm2 * patch.sign
        row = replace(row, foot_length_mm=foot.length, foot_width_mm=foot.width, volume_mm3=volume)
    turns = outline.angle + np.linspace(0, np.pi, _EDGES, endpoint=False)
    at, edge = (bottom.x, bottom.y), settings.straight_edge_mm
    lines = sections(patch, depth, skin, sighted.reconstruction, at, turns, edge)
    if patch.sign > 0:
        gap = max(line.gap(0.5 * outline.length) for line in lines)
        gap += max(bottom.depth - float(depth[_deepest(patch, depth)]), 0.0)  # smoothing has filled it
        # An edge rests on what noise has raised.
        u95 = COVERAGE_95 * float(np.hypot(bottom.sd, _RESTS * patch.smoothed_sd(spread)))
        row = replace(row, straight_edge_depth_mm=gap, straight_edge_depth_u95_mm=u95)
    return replace(row, form=form_of(patch, sighted.reconstruction, bottom, outline, lines[0], lines[_EDGES // 2]))


def _with_radius(row: FittedDefect, bottom: Bottom) -> FittedDefect:
    u95 = COVERAGE_95 * bottom.radius_sd
    if u95 <= _VAGUE_RADIUS * bottom.radius:
        return replace(row, bottom_radius_mm=bottom.radius, bottom_radius_u95_mm=u95)
    reason = "bottom radius not measured: it may be sharper than the points show"
    return replace(row, reason=f"{row.reason}; {reason}" if row.reason else reason)


def _over_depth(found: _Found, extent: float | None, u95: float | None) -> tuple[float, float]:
    """An extent over the depth, and its U95."""
    ratio = (extent or 0.0) / found.bottom.depth
    shares = COVERAGE_95 * found.depth_sd / found.bottom.depth, (u95 or 0.0) / max(extent or 0.0, 1e-9)
    return ratio, ratio * float(np.hypot(*shares))


def _in_image(found: _Found, sighted: Sighted) -> tuple[float, float, float]:
    """Direction of its length, degrees, and extents of its outline along it and across, px, in the left image."""
    outline, frame, project = found.outline, found.patch.frame, sighted.reconstruction.rig.left.project
    along = np.array([np.cos(outline.angle), np.sin(outline.angle), 0.0])
    start, end = project(frame.rig(np.stack([-along, along])))
    way = (end - start) / np.linalg.norm(end - start)
    border = project(frame.rig(np.stack([outline.x, outline.y, np.zeros_like(outline.x)], axis=1)))
    major, minor = np.ptp(border @ way), np.ptp(border @ [-way[1], way[0]])
    turn = float(np.degrees(np.arctan2(way[1], way[0])) % 180)
    return turn, float(major), float(minor)
