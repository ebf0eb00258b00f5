"""The skin round one defect, on a grid as fine as the defect needs, in the tangent plane at its deepest point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array, Mask
from metrology.cloud import Reconstruction
from metrology.defects.cells import BAD, SIZE, means
from metrology.defects.reference import Reference
from metrology.defects.skin_map import Region, SkinMap
from metrology.surfaces import Frame

_MARGIN = 0.4  # of the region's size round it
_MARGIN_CELLS = 6
_SPIKE, _SPIKE_SHARE = 8.0, 0.15  # standard deviations of a point, and share of the depth
_RADIUS = 14.0  # grid steps that a defect's radius at half depth should have
_OUTLINE_SMOOTH = 0.11  # of a defect's radius: what noise is smoothed over, within the bounds below
_SMOOTH_PX = (3.2, 11.0)
_CLEAR = 0.01  # of an outline's level may noise be: what is smoothed over more moves corners and hides nothing else
_LEAST_SMOOTH_STEPS = 0.7
_BRIDGED = 0.02  # weight of a cell without sound skin beside those with it: the ground of a scratch has gaps
_NARROW = 2.5  # times as large is the radius of an area as its greatest inner one: it is a line
_FINEST_CELLS = 400_000  # of a grid of single pixels
_FWHM = 2.355  # of a Gaussian, standard deviations
_TWICE_FWHM = 2.03  # of a mean with the mean of what it left put back: 2 g − g ∗ g
_TWICE_SD = 0.382  # of it on white noise, over that of a cell and the smoothing's standard deviation in cells
_ENOUGH = 1000  # points that tell how pixels map onto the skin
SUPPORT_PX = 1.4
"""Standard deviation of the area that a point is a mean of."""
CORRELATED = 1.3
"""Standard deviation of means over areas, over what the grid's cells alone would leave: neighbours err together."""


@dataclass(frozen=True)
class Patch:
    """A window of the scan."""

    number: int
    """Of its plate."""
    sign: int
    """The defect's side: below or above."""
    reference: Reference
    frame: Frame
    """Its x, y is the tangent plane of the reference at the defect's deepest cell."""
    x: Array
    y: Array
    """x, y: (rows, columns): mm in the frame, at every step of the grid."""
    depth: Array
    """(rows, columns): to the defect's side, mm; smoothed values where no sound skin is."""
    sigma: Array
    """(rows, columns): standard deviation of it if pixels were independent, mm."""
    own: Mask
    """(rows, columns): the region's."""
    others: Mask
    """(rows, columns): of other defects on the plate to the same side, which it runs into."""
    skin: Mask
    """(rows, columns): sound skin."""
    plate: Mask
    """(rows, columns): where the plate is, fasteners on it included."""
    covered: Mask
    """(rows, columns): where a fastener or a hole is."""
    view: Mask
    """(rows, columns): where it ends at what was not seen, and not at a seam."""
    step_px: int
    step_mm: float
    """step_px, step_mm: of the grid."""
    corner_px: tuple[int, int]
    """(u, v): first pixel of its first cell."""

    @property
    def cell_mm2(self) -> float:
        """Area of a grid cell in the tangent plane."""
        return self.step_mm**2

    def true_pixels(self, width_mm: float, spread_px: float) -> float:
        """Pixels that a narrow line is wide, less what smoothing has added to its outline."""
        pixels = width_mm / self.step_mm * self.step_px
        added = np.hypot(_TWICE_FWHM * spread_px, _FWHM * SUPPORT_PX)
        return float(np.sqrt(max(pixels**2 - added**2, 0.0)))

    def grid_of(self, pixels: Array) -> Array:
        """(n, 2) column and row of pixels (n, 2) of the left image."""
        return np.asarray((pixels - self.corner_px - 0.5 * (self.step_px - 1)) / self.step_px)

    def spread_px(self, radius_mm: float, level_mm: float = 0.0) -> float:
        """Standard deviation of what noise is smoothed over, pixels: no more than a defect's radius and noise ask for.

        Parameters
        ----------
        radius_mm : float
            Of the defect; 0 for the least.
        level_mm : float
            Depth at which the outline is taken.
        """
        pixels = self.step_px
        most = float(np.clip(_OUTLINE_SMOOTH * radius_mm / self.step_mm * pixels, *_SMOOTH_PX))
        if level_mm <= 0:
            return most
        told = self.smoothed_sd(pixels) * pixels / (_CLEAR * level_mm)
        return float(np.clip(told, min(_LEAST_SMOOTH_STEPS * pixels, most), most))

    def smoothed(self, spread_px: float) -> Array:
        """Depth as its outline is taken from."""
        weight = np.where(self.skin, 1.0, _BRIDGED) * self.plate
        both = np.dstack([np.where(self.plate, self.depth, 0.0) * weight, weight])
        sigma = spread_px / self.step_px
        total, weights = cv2.split(cv2.GaussianBlur(both, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT))
        weights = np.maximum(weights, 1e-4)
        once = total / weights
        # What the mean has flattened, and gaps have shifted, is put back.
        rest = cv2.GaussianBlur(both[..., 0] - once * weight, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
        return np.asarray(once + rest / weights)

    def smoothed_sd(self, spread_px: float) -> float:
        """Standard deviation of that by noise, mm."""
        return self._cell_sd * _TWICE_SD * self.step_px / spread_px

    @cached_property
    def _cell_sd(self) -> float:
        """Standard deviation of a cell's depth by noise, mm."""
        return float(np.nanmedian(self.sigma)) * self.reference.noise * CORRELATED

    def crossing_sd(self, spread_px: float) -> float:
        """Standard deviation of `smoothed` at a crossing of an outline, as if crossings were independent, mm.

        4/π of them lie on a grid step, and what is smoothed over s of these is correlated over 2 √π s.
        """
        return self.smoothed_sd(spread_px) * float(np.sqrt(8 / np.sqrt(np.pi) * spread_px / self.step_px))


def cut_patch(region: Region, skin: SkinMap, reconstruction: Reconstruction) -> Patch:
    """The window round a region."""
    cells = skin.cells
    rows, columns = _window(region, cells.plate.shape)
    depth = region.sign * skin.smoothed[rows, columns]
    own, others = np.zeros((2, *cells.plate.shape), bool)
    own[region.rows, region.columns] = region.cells
    for other in skin.regions:
        if other.plate == region.plate and other.sign == region.sign:
            others[other.rows, other.columns] |= other.cells
    own, others = own[rows, columns], (others & ~own)[rows, columns]
    peak = float(np.where(own, depth, -np.inf).max())
    core = (own & (depth > 0.5 * peak)).astype(np.uint8)
    radius = float(np.sqrt(core.sum() / np.pi))
    inner = float(cv2.distanceTransform(np.pad(core, 1), cv2.DIST_L2, 3).max())
    step = _step(inner if radius > _NARROW * inner else radius)
    if step == 1 and core.size * SIZE**2 > _FINEST_CELLS:
        step = 2
    return _patch(region, (own, others), skin, reconstruction, (rows, columns), step)


def _step(radius: float) -> int:
    """Pixels of a grid step, for a radius in cells."""
    return max(1, SIZE >> max(0, int(np.ceil(np.log2(_RADIUS / max(radius, 0.5))))))


def _window(region: Region, shape: tuple[int, ...]) -> tuple[slice, slice]:
    height, width = region.cells.shape
    reach = _MARGIN_CELLS + int(_MARGIN * max(height, width))
    return (
        slice(max(0, region.rows.start - reach), min(shape[0], region.rows.stop + reach)),
        slice(max(0, region.columns.start - reach), min(shape[1], region.columns.stop + reach)),
    )


def _patch(
    region: Region,
    masks: tuple[Mask, Mask],
    skin: SkinMap,
    reconstruction: Reconstruction,
    window: tuple[slice, slice],
    step: int,
) -> Patch:
    reference, cells = skin.references[region.plate], skin.cells
    fine = SIZE // step
    pixels = tuple(slice(SIZE * part.start, SIZE * part.stop) for part in window)
    shape = tuple((part.stop - part.start) * fine for part in window)
    points, sigma = np.empty((*shape, 3)), np.empty(shape)
    flags = reconstruction.flags[pixels]
    means(reconstruction.points[pixels], reconstruction.sigma_z[pixels], flags, BAD, step, 0.5, points, sigma)

    def finer(cell_values: NDArray[np.generic]) -> NDArray[np.generic]:
        return np.repeat(np.repeat(cell_values, fine, axis=0), fine, axis=1)

    plate = np.asarray(finer(cells.plate[window] == region.plate), bool)
    # A hole's cell may have too few points for a mean, and yet some.
    covered = np.asarray(finer((cells.covered | ~cells.free & np.isfinite(cells.sigma))[window]), bool)
    known = np.isfinite(sigma) & plate & ~covered
    depth = np.full(shape, np.nan)
    reference.depths(points, known, depth)
    smooth = np.asarray(finer(np.nan_to_num(skin.smoothed[window])), float)
    smooth = np.asarray(cv2.GaussianBlur(smooth, (0, 0), 0.5 * fine)) if fine > 1 else smooth
    known &= ~_spikes(np.where(known, depth, smooth), sigma * reference.noise, smooth)
    depth = region.sign * np.where(known, depth, smooth)
    frame = _tangent(region, skin, reference)
    x, y = _everywhere(points, known, frame)
    across, down = (float(np.median(np.hypot(*(np.diff(a[::4, ::4], axis=k) for a in (x, y))))) / 4 for k in (1, 0))
    view = np.asarray(finer(((cells.plate == 0) & ~cells.seam)[window]), bool)
    return Patch(
        number=region.plate,
        sign=region.sign,
        reference=reference,
        frame=frame,
        x=x,
        y=y,
        depth=depth,
        sigma=sigma,
        own=np.asarray(finer(masks[0]), bool),
        others=np.asarray(finer(masks[1]), bool),
        skin=known,
        plate=plate,
        covered=covered,
        view=view,
        step_px=step,
        step_mm=float(np.sqrt(across * down)),
        corner_px=(pixels[1].start, pixels[0].start),
    )


def _spikes(depth: Array, sigma: Array, smooth: Array) -> Mask:
    """Points that stand out from their neighbours as no bottom does: matched by chance."""
    around = cv2.medianBlur(depth.astype(np.float32), 5)
    most = np.maximum(_SPIKE * np.nan_to_num(sigma), _SPIKE_SHARE * float(np.abs(smooth).max()))
    return np.asarray(np.abs(depth - around) > most)


def _tangent(region: Region, skin: SkinMap, reference: Reference) -> Frame:
    """Tangent frame of the reference at a region's deepest cell."""
    depth = np.where(region.cells, region.sign * skin.smoothed[region.rows, region.columns], -np.inf)
    points = skin.cells.points[region.rows, region.columns]
    depth = np.where(np.isfinite(points[..., 2]), depth, -np.inf)
    deepest = points[np.unravel_index(int(depth.argmax()), depth.shape)]
    return reference.tangent(deepest)


def _everywhere(points: Array, known: Mask, frame: Frame) -> tuple[Array, Array]:
    """x, y of all grid cells, from quadratics through the known ones: pixels map smoothly onto the skin."""
    rows, columns = known.shape
    part = np.flatnonzero(known)
    part = part[:: max(1, len(part) // _ENOUGH)]
    u, v = (np.arange(n) / max(rows, columns) - 0.5 for n in (columns, rows))
    pu, pv = u[part % columns], v[part // columns]
    design = np.stack([np.ones_like(pu), pu, pv, pu * pu, pu * pv, pv * pv], axis=-1)
    solved, *_ = np.linalg.lstsq(design, frame.local(points.reshape(-1, 3)[part])[:, :2])
    v = v[:, None]
    x, y = ((c[0] + c[2] * v + c[5] * v * v) + (c[1] + c[4] * v) * u + c[3] * u * u for c in solved.T)
    return x, y
