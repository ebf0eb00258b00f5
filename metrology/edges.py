"""Which pixels mix light from two sides of an edge.

A pixel averages phasors over the lens blur. Where brightness changes across it the average leans to the bright side and
the phase with it (Yue, Dantanarayana, Wu, Huntley 2018); where depth jumps it lies between both sides. Pixels within two
blur radii of such an edge are flagged EDGE: they have a value that no fit should use.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.cloud import DecodedView, PixelFlag
from metrology.jit import kernel, over_rows
from metrology.reconstruction_settings import ReconstructionSettings

# A second difference of the coordinate counts as a depth edge from this many of its standard deviations.
_CURVATURE_SIGMAS = 7.0
# … and a brightness gradient if it exceeds edge_contrast by this many of its own.
_GRADIENT_SIGMAS = 3.0


def flag_edges(view: DecodedView, frames: int, settings: ReconstructionSettings) -> DecodedView:
    """The view with EDGE set near reflectance and depth edges, and near pixels that have no phase.

    Parameters
    ----------
    view : DecodedView
    frames : int
        How many frames the texture is a mean of.
    settings : ReconstructionSettings
    """
    height, width = view.coordinate.shape
    mask = np.zeros((height, width), np.uint8)
    read, gain = (view.noise.read_variance, view.noise.gain) if view.noise else (0.0, 0.0)
    noise = (np.float32(read / frames), np.float32(gain / frames))
    limits = (np.float32(settings.edge_contrast), np.float32(_GRADIENT_SIGMAS), np.float32(_CURVATURE_SIGMAS))
    step = max(1, round(2 * settings.blur_radius_px))

    def mark(first: int, end: int) -> None:
        _mark_rows(view.coordinate, view.sigma, view.texture, noise, limits, step, first, end, mask)

    over_rows(mark, height, settings.threads)
    guard = int(np.ceil(2 * settings.blur_radius_px))
    wide = cv2.dilate(mask, _disc(guard))
    flags = view.flags | np.where(wide > 0, np.uint16(PixelFlag.EDGE), np.uint16(0))
    return replace(view, flags=flags)


def _disc(radius: int) -> NDArray[np.uint8]:
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    return (x * x + y * y <= (radius + 0.5) ** 2).astype(np.uint8)


@kernel
def _mark_rows(coordinate, sigma, texture, noise, limits, step, first, end, mask):  # type: ignore[no-untyped-def]
    """1 where brightness or phase changes abruptly, or where a neighbour has no phase."""
    height, width = coordinate.shape
    read, gain = noise
    contrast, gradient_sigmas, curvature_sigmas = limits
    root6 = np.float32(np.sqrt(6.0))
    half = np.float32(0.5)
    for y in range(max(first, step), min(end, height - step)):
        up, here, down = texture[y - 1], texture[y], texture[y + 1]
        c = coordinate[y]
        c_up, c_down = coordinate[y - step], coordinate[y + step]
        for x in range(step, width - step):
            a = here[x]
            du = half * (here[x + 1] - here[x - 1])
            dv = half * (down[x] - up[x])
            gradient = np.sqrt(du * du + dv * dv)
            spread = np.sqrt(half * (read + gain * a))
            bright = gradient > contrast * a + gradient_sigmas * spread
            along = abs(c[x + step] + c[x - step] - c[x] - c[x])
            across = abs(c_up[x] + c_down[x] - c[x] - c[x])
            # A comparison with NaN is false: a missing neighbour marks the pixel.
            bound = curvature_sigmas * root6 * sigma[y, x]
            smooth = (along <= bound) & (across <= bound)
            mask[y, x] = 1 if (bright | (not smooth)) & (c[x] == c[x]) else 0
