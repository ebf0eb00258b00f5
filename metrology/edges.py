"""Which pixels mix light from two sides of an edge, or got light that spilled over from a saturated neighbour.

A pixel averages phasors over the lens blur. Where brightness changes across it the average leans to the bright side
and the phase with it (Yue, Dantanarayana, Wu, Huntley 2018); where depth jumps it lies between both sides. Pixels
within two blur radii of such an edge are flagged EDGE: they have a value that no fit should use.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.cloud import DecodedView, PixelFlag
from metrology.jit import kernel, over_rows
from metrology.reconstruction_settings import ReconstructionSettings

_EDGE, _NONE = np.uint8(PixelFlag.EDGE), np.uint8(0)
# A second difference of the coordinate counts as a depth edge from this many of its standard deviations …
_CURVATURE_SIGMAS = np.float32(7.0)
# … and a brightness gradient if it exceeds edge_contrast by this many of its own, and zero by that many: noise alone
# would mark one pixel in a hundred at three, and a disc about each.
_GRADIENT_SIGMAS = np.float32(3.0)
_ZERO_SIGMAS = np.float32(5.0)
# Missing pixels among the nine about a pixel that noise alone may leave, without an edge.
_LONE = 3


def flag_neighbourhoods(view: DecodedView, frames: int, settings: ReconstructionSettings) -> DecodedView:
    """The view with EDGE and SATURATED_SAMPLES spread as far as the lens spreads their cause.

    EDGE marks the surroundings of reflectance and depth edges and of pixels that have no phase.

    Parameters
    ----------
    frames : int
        How many frames the texture is a mean of.
    """
    reach = int(np.ceil(2 * settings.blur_radius_px))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    disc = (x * x + y * y <= (reach + 0.5) ** 2).astype(np.uint8)
    flags = view.flags | _spread(_edges(view, frames, settings), disc)
    saturated = flags & np.uint16(PixelFlag.SATURATED | PixelFlag.SATURATED_SAMPLES)
    if saturated.any():
        flags |= _spread((saturated != 0) * np.uint8(PixelFlag.SATURATED_SAMPLES), disc)
    return replace(view, flags=flags)


def without_border(view: DecodedView) -> DecodedView:
    """The view without the phase of its outermost pixels: what filters pictures invents what lies beyond them."""
    coordinate, flags = view.coordinate.copy(), view.flags.copy()
    for border in np.s_[0, :], np.s_[-1, :], np.s_[:, 0], np.s_[:, -1]:
        flags[border][np.isfinite(coordinate[border])] |= np.uint16(PixelFlag.ORDER_RESIDUAL)
        coordinate[border] = np.nan
    return replace(view, coordinate=coordinate, flags=flags)


def _spread(mask: NDArray[np.uint8], disc: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The mask's largest value within the disc about every pixel."""
    return np.asarray(cv2.dilate(mask, disc), np.uint8)


def _edges(view: DecodedView, frames: int, settings: ReconstructionSettings) -> NDArray[np.uint8]:
    """(h, w) EDGE on reflectance and depth edges and beside missing pixels, else 0."""
    height, width = view.coordinate.shape
    mask = np.zeros((height, width), np.uint8)
    read, gain = (view.noise.read_variance, view.noise.gain) if view.noise else (0.0, 0.0)
    noise = (np.float32(read / frames), np.float32(gain / frames))
    contrast = np.float32(settings.edge_contrast)
    step = max(1, round(2 * settings.blur_radius_px))

    coordinate = _without_lone_gaps(view)

    def mark(first: int, end: int) -> None:
        _mark_rows(coordinate, view.sigma, view.texture, noise, contrast, step, first, end, mask)

    over_rows(mark, height, settings.threads)
    return mask


def _without_lone_gaps(view: DecodedView) -> NDArray[np.float32]:
    """The coordinate with pixels filled that noise alone lost, between neighbours that have theirs.

    A pixel whose fringe order noise has made doubtful is missing, but no edge; neighbours on two sides of an edge still
    show it. Saturated pixels stay missing.
    """
    gone = np.isnan(view.coordinate)
    around = cv2.boxFilter(gone.view(np.uint8), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    lone = gone & (around <= _LONE)
    lone[[0, -1]] = lone[:, [0, -1]] = False
    v, u = np.divmod(np.flatnonzero(lone), lone.shape[1])
    kept = (view.flags[v, u] & np.uint16(PixelFlag.SATURATED)) == 0
    v, u = v[kept], u[kept]
    if v.size == 0:
        return view.coordinate
    filled = view.coordinate.copy()
    sides = [0.5 * (filled[v, u - 1] + filled[v, u + 1]), 0.5 * (filled[v - 1, u] + filled[v + 1, u])]
    filled[v, u] = np.where(np.isfinite(sides[0]), sides[0], sides[1])
    return filled


@kernel
def _mark_rows(coordinate, sigma, texture, noise, contrast, step, first, end, mask):  # type: ignore[no-untyped-def]
    height, width = coordinate.shape
    read, gain = noise
    half = np.float32(0.5)
    bend = _CURVATURE_SIGMAS * np.float32(np.sqrt(6.0))
    inner = width - 2 * step
    for y in range(max(first, step), min(end, height - step)):
        bright = texture[y, step : step + inner]
        bright_left, bright_right = texture[y, step - 1 : step - 1 + inner], texture[y, step + 1 : step + 1 + inner]
        bright_up, bright_down = texture[y - 1, step : step + inner], texture[y + 1, step : step + inner]
        here = coordinate[y, step : step + inner]
        left, right = coordinate[y, :inner], coordinate[y, 2 * step : 2 * step + inner]
        up, down = coordinate[y - step, step : step + inner], coordinate[y + step, step : step + inner]
        spread = sigma[y, step : step + inner]
        marks = mask[y, step : step + inner]
        for x in range(inner):
            a = bright[x]
            du = half * (bright_right[x] - bright_left[x])
            dv = half * (bright_down[x] - bright_up[x])
            noise_here = np.sqrt(half * (read + gain * a))
            least = max(contrast * a + _GRADIENT_SIGMAS * noise_here, _ZERO_SIGMAS * noise_here)
            steep = np.sqrt(du * du + dv * dv) > least
            twice = here[x] + here[x]
            # A comparison with NaN is false: a missing neighbour marks the pixel.
            limit = bend * spread[x]
            smooth = (abs(left[x] + right[x] - twice) <= limit) & (abs(up[x] + down[x] - twice) <= limit)
            marks[x] = _EDGE if (steep | (not smooth)) & (twice == twice) else _NONE
