"""How deep every cell of a scan lies below the skin as it would be without defects, and where it lies off it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array, Mask
from metrology.defects.cells import CellMap, cell_map
from metrology.defects.reference import Reference, fit_contour, fit_reference
from metrology.defects.settings import DefectSettings
from metrology.defects.split import bottoms
from metrology.registration.rows import has_position, positions
from metrology.results import SeamStation, of_type
from metrology.robust import MAD, median
from metrology.sighted import Sighted

_ROUNDS = 4  # of finding what lies off the skin, and fitting the skin to the rest
_DOUBTFUL_ROUNDS = 2  # at first, in which a dent may have bent the reference beside it
_UNCHANGED = 5e-3  # of a plate's cells: what is left out has stayed the same
_SMOOTH_CELLS = 1.5
_ENOUGH = 12000  # cells that tell a plate's reference, its profiles and its scatter
_WAVES_CELLS = 8.0  # over which the skin's own waviness is told from noise
_START, _GO_ON = 5.0, 2.5  # standard deviations of the smoothed depth
_LEAST_CELLS = 8
_MARGIN = 0.25  # of a defect's radius round it is not taken for skin
_WIDE_MARGIN = 0.5  # of it left out to see how well the rest tells the skin under it
_FEW = 50  # places of a bottom tell how well the skin under it is known
_NEAR = 0.05  # of a Gaussian's weight must be known


@dataclass(frozen=True)
class Region:
    """Cells that lie off the skin together, to the same side."""

    plate: int
    sign: int
    """Below or above."""
    rows: slice
    columns: slice
    """rows, columns: its window."""
    cells: Mask
    """(…): its cells in the window."""
    doubt: float = 0.0
    """By how much more than noise makes it its depth changes if more round it is not taken for skin, mm."""
    bend: float = 0.0
    """By how much the skin under it is then bent otherwise, mm: what may look like a defect, and be none."""
    followed: float = 0.0
    """By how much the skin under it is bent towards it, more than beside it and than a paraboloid would be, mm."""


@dataclass(frozen=True)
class SkinMap:
    """A scan against its skin."""

    cells: CellMap
    references: Mapping[int, Reference]
    """By plate."""
    depth: Array
    """(rows, columns): below the skin along its normal, mm; NaN where there is none."""
    smoothed: Array
    sd: Array
    """smoothed, sd: (rows, columns): depth smoothed over neighbours, fasteners bridged, and its standard deviation on
    bare skin, mm."""
    waves: Mapping[int, float]
    """Standard deviation of the bare skin over many cells about the reference, by plate, mm."""
    regions: tuple[Region, ...]

    def depth_at(self, plate: int, places: Array) -> Array:
        """(n,) smoothed depth at places (n, 2), column and row in cells; NaN off a plate."""
        u, v = np.rint(places).astype(int).T
        rows, columns = self.depth.shape
        inside = (u >= 0) & (v >= 0) & (u < columns) & (v < rows)
        u, v = np.where(inside, u, 0), np.where(inside, v, 0)
        return np.where(inside & (self.cells.plate[v, u] == plate), self.smoothed[v, u], np.nan)


def skin_map(sighted: Sighted, settings: DefectSettings) -> SkinMap:
    """Fit the skin and find what lies off it, in turn until what lies off it stays the same."""
    cells = cell_map(sighted)
    seams = _seam_courses(of_type(sighted.features, SeamStation))
    depth = np.full(cells.sigma.shape, np.nan)
    sound = np.isfinite(cells.sigma)
    covered = np.zeros(depth.shape, bool)
    references: dict[int, Reference] = {}
    due: Sequence[int] = cells.plates
    for number in range(_ROUNDS):
        for plate in due:
            on_plate = (cells.plate == plate) & sound
            depth[on_plate] = np.nan
            before = references.pop(plate, None)
            like = replace(before, wave_sd=0.0) if before and number > 1 else None
            reference = _reference(cells, plate, covered, seams, settings, like, dents_known=number > 0)
            if reference is not None:
                reference.depths(cells.points, on_plate, depth)
                references[plate] = reference
        smoothed, sd, waves = _smoothed(depth, cells, covered)
        regions = _regions(smoothed, sd, cells, settings)
        left_out = _undisputed(regions, smoothed, cells, references) if number < _DOUBTFUL_ROUNDS else regions
        added = _footprints(left_out, covered.shape, _MARGIN) & ~covered
        changed, covered = added & cells.free, covered | added
        areas = {p: cells.plate == p for p in cells.plates}
        due = [p for p, area in areas.items() if changed[area].sum() > _UNCHANGED * area.sum()]
        if not number:  # At first only what is bent plainly was taken for bent, and the rest of it may hide a defect.
            hide = {p for p, wave in waves.items() if _START * wave > settings.least_depth_mm}
            due = sorted(hide | {region.plate for region in regions})
        if number == _ROUNDS - 1 or (not due and len(left_out) == len(regions)):
            break
    regions = tuple(part for region in regions for part in _parts(region, smoothed, sd))
    wide = _footprints(regions, covered.shape, _WIDE_MARGIN)
    others = {
        p: _reference(cells, p, covered | wide, seams, settings, references[p]) for p in {r.plate for r in regions}
    }
    contours = {p: fit_contour(*_bare(cells, p, wide)) for p in others}
    followed = (_followed(r, depth, smoothed, cells, contours[r.plate]) for r in regions)
    doubted = tuple(_doubted(r, depth, cells, references[r.plate], others[r.plate]) for r in followed)
    told = {p: _with_waves(r, cells, p, waves.get(p, 0.0), settings) for p, r in references.items()}
    return SkinMap(cells, told, depth, smoothed, sd, waves, doubted)


def _with_waves(reference: Reference, cells: CellMap, plate: int, waves: float, settings: DefectSettings) -> Reference:
    """A plate's reference with the uncertainty that its waves add."""
    typical = reference.noise * float(np.nanmedian(cells.sigma[cells.plate == plate]))
    return reference.with_waves(waves, typical, settings.largest_mm)


def _parts(region: Region, smoothed: Array, sd: Array) -> list[Region]:
    """A region for each bottom."""
    window = region.rows, region.columns
    depth = region.sign * np.nan_to_num(smoothed[window])
    parts = bottoms(depth, region.cells, _START * sd[window], _LEAST_CELLS)
    return [replace(region, cells=part) for part in parts]


def _reference(
    cells: CellMap,
    plate: int,
    covered: Mask,
    seams: list[tuple[Array, Array]],
    settings: DefectSettings,
    like: Reference | None = None,
    dents_known: bool = True,
) -> Reference | None:
    """The skin of a plate by its bare cells."""
    points, sigma = _bare(cells, plate, covered)
    return fit_reference(points, sigma, seams, settings.largest_mm, like, dents_known)


def _bare(cells: CellMap, plate: int, covered: Mask) -> tuple[Array, Array]:
    """(n, 3) points and (n,) their sigma: enough cells of a plate's bare skin."""
    use = np.flatnonzero((cells.plate == plate) & cells.free & ~covered)
    return cells.chosen(use[:: max(1, len(use) // _ENOUGH)])


def _doubted(region: Region, depth: Array, cells: CellMap, own: Reference, other: Reference | None) -> Region:
    """A region with what a reference of fewer cells makes of it.

    Of two estimates, one of a part of the other's values, the difference has by noise alone the difference of their
    variances: what is beyond it is a reference that the defect has bent.
    """
    here = np.where(region.cells, depth[region.rows, region.columns], np.nan)
    known = np.isfinite(here)
    if other is None or not known.any():
        return region
    again = np.full(here.shape, np.nan)
    points = cells.points[region.rows, region.columns]
    other.depths(points, known, again)
    off = again - here
    middle = np.abs(here) > 0.7 * np.abs(here[known]).max()
    row, column = np.nonzero(known)
    plane = np.column_stack([np.ones(len(row)), row, column])
    bent = off[known] - plane @ np.linalg.lstsq(plane, off[known], rcond=None)[0]
    x, y = other.frame.local(points[middle])[:: max(1, int(middle.sum()) // _FEW), :2].T
    noise = float((other.variance(x, y) - own.variance(x, y)).mean())
    doubt = np.sqrt(max(float(np.abs(off[middle]).mean()) ** 2 - max(noise, 0.0), 0.0))
    return replace(region, doubt=float(doubt), bend=float(np.sqrt(np.mean(bent**2))))


def _followed(region: Region, depth: Array, smoothed: Array, cells: CellMap, contour: Reference | None) -> Region:
    """A region with how far the reference is bent towards it.

    A dent that is large for its plate, and fades out slowly, leaves of itself in the skin round it what the polynomial
    takes for the skin's own bend, and goes on under the dent. A paraboloid cannot.
    """
    own = np.zeros(depth.shape, bool)
    own[region.rows, region.columns] = region.cells
    known = np.isfinite(depth) & (cells.plate == region.plate)
    beside = _footprints([region], depth.shape, _WIDE_MARGIN) & known & ~own
    own &= known
    if contour is None or not own.any() or not beside.any():
        return region
    deepest = np.unravel_index(int(np.where(own, region.sign * smoothed, -np.inf).argmax()), depth.shape)
    below = np.full(depth.shape, np.nan)
    contour.depths(cells.points, own | beside, below)
    bent = region.sign * (below - depth)
    return replace(region, followed=max(float(bent[deepest] - bent[beside].mean()), 0.0))


def _seam_courses(stations: Sequence[SeamStation]) -> list[tuple[Array, Array]]:
    """Two points on the course of each seam."""
    courses: dict[str, list[SeamStation]] = {}
    for row in filter(has_position, stations):
        courses.setdefault(row.seam_id, []).append(row)
    ends = [positions([course[0], course[-1]]) for course in courses.values() if len(course) > 1]
    return [(first, last) for first, last in ends]


def _smoothed(depth: Array, cells: CellMap, covered: Mask) -> tuple[Array, Array, dict[int, float]]:
    """Depth smoothed over neighbours, its standard deviation by noise and by the skin's own waves, and these alone."""
    known = np.isfinite(depth) & cells.free
    on_skin = cells.plate > 0
    values = np.where(known, depth, 0.0).astype(np.float32)
    smooth = _normalised(values, known, _SMOOTH_CELLS, on_skin)
    bare = known & ~covered
    broad = _normalised(values, bare, _WAVES_CELLS, on_skin)
    noise, waves, typical = (np.full(len(cells.plates) + 1, np.nan) for _ in range(3))
    for plate in cells.plates:
        on_plate = np.flatnonzero((cells.plate == plate) & bare)
        if not len(on_plate):
            continue
        on_plate = on_plate[:: max(1, len(on_plate) // _ENOUGH)]
        sigma, wave = cells.sigma.ravel()[on_plate], broad.ravel()[on_plate]
        noise[plate] = MAD * median(np.abs(smooth.ravel()[on_plate] - wave) / sigma)
        waves[plate] = MAD * median(np.abs(wave))
        typical[plate] = median(sigma)
    sigma = np.where(known, cells.sigma, typical[cells.plate])
    sd = np.sqrt((noise[cells.plate] * sigma) ** 2 + waves[cells.plate] ** 2)
    told = {plate: float(waves[plate]) for plate in cells.plates if np.isfinite(waves[plate])}
    return np.where(on_skin, smooth, np.nan), sd, told


def _normalised(values: NDArray[np.float32], known: Mask, sigma: float, where: Mask) -> NDArray[np.float32]:
    """(rows, columns) Gaussian mean of the known values; wider where hardly any is near: a head is bridged."""
    both = np.dstack([values * known, known.astype(np.float32)])
    size = values.shape[::-1]
    result = np.full(values.shape, np.nan, np.float32)
    for _ in range(4):
        coarse = max(1, int(sigma // 2))
        small = (
            both
            if coarse == 1
            else cv2.resize(both, (-(-size[0] // coarse), -(-size[1] // coarse)), interpolation=cv2.INTER_AREA)
        )
        blurred = cv2.GaussianBlur(small, (0, 0), sigma / coarse, borderType=cv2.BORDER_CONSTANT)
        total = blurred[..., 1]
        mean = np.where(total > _NEAR, blurred[..., 0] / np.maximum(total, _NEAR), np.float32(np.nan))
        if coarse > 1:
            mean = cv2.resize(mean, size, interpolation=cv2.INTER_LINEAR)
        result = np.where(np.isfinite(result), result, mean)
        if np.isfinite(result[where]).all():
            break
        sigma *= 3
    return np.nan_to_num(result)


def _regions(smoothed: Array, sd: Array, cells: CellMap, settings: DefectSettings) -> tuple[Region, ...]:
    """Connected cells beyond the lower threshold that reach the upper one somewhere (hysteresis)."""
    found = []
    for sign in (1, -1):
        depth = sign * smoothed  # NaN off the plates is beyond nothing
        sure = cells.free & (depth > _START * sd) & (depth > settings.least_depth_mm)
        if not sure.any():
            continue
        off = depth > _GO_ON * sd
        _, labels, stats, _ = cv2.connectedComponentsWithStats(off.astype(np.uint8), connectivity=4)
        for k in np.unique(labels[sure]):
            u, v, width, height, area = (int(s) for s in stats[k])
            if area < _LEAST_CELLS:
                continue
            rows, columns = slice(v, v + height), slice(u, u + width)
            member = labels[rows, columns] == k
            plate = int(np.bincount(cells.plate[rows, columns][member]).argmax())
            found.append(Region(plate, sign, rows, columns, member))
    return tuple(found)


def _undisputed(
    regions: Sequence[Region], smoothed: Array, cells: CellMap, references: Mapping[int, Reference]
) -> list[Region]:
    """Regions without those that the profile along a seam makes: what lies off the skin lifts it on its whole line.

    Of regions to either side of the skin on the same line across a seam, the strongest is the cause.
    """
    kept: list[tuple[Region, list[tuple[float, float]]]] = []
    strength = [float(np.abs(smoothed[r.rows, r.columns][r.cells]).max()) for r in regions]
    for k in np.argsort(strength)[::-1]:
        region = regions[k]
        reference = references.get(region.plate)
        points = cells.points[region.rows, region.columns][region.cells]
        points = points[np.isfinite(points[:, 2])]
        spans = [] if reference is None or not len(points) else reference.spans(points)
        disputed = any(
            other.plate == region.plate
            and other.sign != region.sign
            and any(low < end and start < high for (low, high), (start, end) in zip(spans, taken, strict=True))
            for other, taken in kept
        )
        if not disputed:
            kept.append((region, spans))
    return [region for region, _ in kept]


def _footprints(regions: Sequence[Region], shape: tuple[int, ...], margin: float) -> Mask:
    """What is not to be taken for skin: all regions, with a margin in radii of theirs."""
    mask = np.zeros(shape, np.uint8)
    for region in regions:
        reach = 2 + round(margin * np.sqrt(region.cells.sum() / np.pi))
        padded = np.pad(region.cells.astype(np.uint8), reach)
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
        wide = cv2.dilate(padded, disc)
        v, u = region.rows.start - reach, region.columns.start - reach
        top, left = max(v, 0), max(u, 0)
        part = wide[top - v : shape[0] - v, left - u : shape[1] - u]
        mask[top : top + part.shape[0], left : left + part.shape[1]] |= part.astype(np.uint8)
    return mask > 0
