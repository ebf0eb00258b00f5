"""What the projector's optics make of an image, and what each camera pixel then receives.

The projector shows pixels of a few bits; its lens blurs them. The blurred light is tabulated finely once, so that a
sample at any sub-pixel projector coordinate is a short look-up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from metrology.arrays import Float32
from metrology.errors import SpecError
from metrology.fringe import FringeCode
from simulator.compiled import entry
from simulator.relief import Floats
from simulator.trace import Hits

_FINE = 32  # table entries per projector pixel, stripes
_COARSE = 4  # the same for images
_MARGIN = 12  # projector pixels of darkness kept around


@dataclass(frozen=True)
class Beamer:
    """How the projector turns values into light."""

    gamma: float = 1.0
    """Light = value^gamma; 1 is linear."""
    blur_px: float = 0.8
    """Standard deviation of its lens's blur on the panel, projector pixels."""
    bits: int = 8
    """Bits per pixel of what it shows; 0 shows any value."""
    black: float = 0.002
    """Light of a black pixel, relative to a white one."""
    fill: float = 1.0
    """Share of a pixel's width and height that is lit: below 1 the gaps between pixels show."""

    def __post_init__(self) -> None:
        if self.gamma <= 0:
            raise SpecError(f"projector gamma: found {self.gamma}, expected a positive number")
        if self.blur_px < 0:
            raise SpecError(f"projector blur_px: found {self.blur_px}, expected 0 or more")
        if not 0 <= self.bits <= 16:
            raise SpecError(f"projector bits: found {self.bits}, expected 0 to 16")
        if not 0 <= self.black < 1:
            raise SpecError(f"projector black: found {self.black}, expected 0 to below 1")
        if not 0.25 <= self.fill <= 1:
            raise SpecError(f"projector fill: found {self.fill}, expected 0.25 to 1")

    def light(self, values: Floats) -> Floats:
        """Relative light of pixel values in [0, 1]."""
        if self.bits:
            top = 2**self.bits - 1
            values = np.rint(values * top) / top
        return self.black + (1 - self.black) * values**self.gamma

    def lit(self, fine: int, pixels: int) -> Floats:
        """(pixels · fine,) light across a row of pixels, `fine` places in each: their mean stays 1."""
        middle = np.abs((np.arange(fine) + 0.5) / fine - 0.5)
        one = np.clip((0.5 * self.fill - middle) * fine + 0.5, 0.0, 1.0)
        return np.tile(one / one.mean(), pixels)


@dataclass(frozen=True)
class Stripes:
    """Fringe patterns as projected: they vary along one axis only."""

    along: str
    """"x" or "y"."""
    light: Float32
    """(frames, n) float32: light along the axis, `_FINE` entries per pixel, first entry at −0.5 − _MARGIN (entry
    centres)."""
    aperture: Float32
    """(m,) float32: the same for the other axis: 1 inside the projector's field."""


def project_stripes(code: FringeCode, width: int, height: int, beamer: Beamer) -> Stripes:
    """The light of all frames of a fringe code."""
    patterns = code.patterns(width, height)
    lines = patterns[:, 0, :] if code.axis == "x" else patterns[:, :, 0]
    other = height if code.axis == "x" else width
    return Stripes(code.axis, _spread(beamer.light(lines), beamer), _spread(np.ones((1, other)), beamer)[0])


def _spread(lines: Floats, beamer: Beamer) -> Float32:
    """Lines of pixels after the lens, tabulated."""
    padded = np.pad(lines, ((0, 0), (_MARGIN, _MARGIN)))
    fine = np.repeat(padded, _FINE, axis=1)
    if beamer.fill < 1:
        fine = fine * beamer.lit(_FINE, padded.shape[1])
    if beamer.blur_px > 0:
        fine = gaussian_filter1d(fine, beamer.blur_px * _FINE, axis=1, mode="constant", truncate=5)
    return np.ascontiguousarray(fine, np.float32)


def project_image(image: NDArray[np.generic], beamer: Beamer) -> Float32:
    """The light of any image, tabulated `_COARSE` times finer.

    Parameters
    ----------
    image : (h, w) float in [0, 1]
    """
    light = np.pad(beamer.light(np.asarray(image, float)), _MARGIN)
    fine = np.repeat(np.repeat(light, _COARSE, axis=0), _COARSE, axis=1).astype(np.float32)
    if beamer.fill < 1:
        fine *= np.outer(beamer.lit(_COARSE, light.shape[0]), beamer.lit(_COARSE, light.shape[1])).astype(np.float32)
    if beamer.blur_px > 0:
        fine = gaussian_filter(fine, beamer.blur_px * _COARSE, mode="constant", truncate=5)
    return np.ascontiguousarray(fine)


@entry
def _stripes(first, along, across, direct, ambient, light, aperture, fine, margin, shifts, ambients, totals, out):  # type: ignore[no-untyped-def]
    frames, size, height = light.shape[0], light.shape[1], aperture.size
    for i in range(first.size - 1):
        for f in range(frames):
            totals[f] = 0.0
        for k in range(first[i], first[i + 1]):
            for f in range(frames):
                totals[f] += ambient[k] * ambients[f]
            if direct[k] <= 0.0:
                continue
            b = (across[k] + 0.5 + margin) * fine - 0.5
            if not (b >= 0.0 and b < height - 1):
                continue
            j = int(b)
            gate = direct[k] * (aperture[j] + (b - j) * (aperture[j + 1] - aperture[j]))
            for f in range(frames):
                a = (along[k] + shifts[f] + 0.5 + margin) * fine - 0.5
                if a >= 0.0 and a < size - 1:
                    m = int(a)
                    totals[f] += gate * (light[f, m] + (a - m) * (light[f, m + 1] - light[f, m]))
        share = 1.0 / (first[i + 1] - first[i])
        for f in range(frames):
            out[f, i] = totals[f] * share


@entry
def _image(first, column, row, direct, ambient, light, fine, margin, out):  # type: ignore[no-untyped-def]
    height, width = light.shape
    for i in range(first.size - 1):
        total = 0.0
        for k in range(first[i], first[i + 1]):
            total += ambient[k]
            u, v = (column[k] + 0.5 + margin) * fine - 0.5, (row[k] + 0.5 + margin) * fine - 0.5
            if direct[k] > 0.0 and u >= 0.0 and u < width - 1 and v >= 0.0 and v < height - 1:
                m, n = int(u), int(v)
                a, b = u - m, v - n
                top = light[n, m] + a * (light[n, m + 1] - light[n, m])
                bottom = light[n + 1, m] + a * (light[n + 1, m + 1] - light[n + 1, m])
                total += direct[k] * (top + b * (bottom - top))
        out[i] = total / (first[i + 1] - first[i])


def receive_stripes(
    hits: Hits, stripes: Stripes, shifts_px: Floats | None = None, ambients: Floats | None = None
) -> Float32:
    """Light on a camera under each fringe frame.

    Parameters
    ----------
    shifts_px : (frames,) array, optional
        How far the pattern has moved on the panel in each frame (a shaking projector), projector pixels.
    ambients : (frames,) array, optional
        Ambient light in each frame, relative.

    Returns
    -------
    (frames, h, w) float32
        Grey levels at exposure 1.
    """
    frames = len(stripes.light)
    shifts = np.zeros(frames) if shifts_px is None else np.asarray(shifts_px, float)
    ambients = np.ones(frames) if ambients is None else np.asarray(ambients, float)
    along, across = (hits.column, hits.row) if stripes.along == "x" else (hits.row, hits.column)
    out = np.empty((frames, hits.height * hits.width), np.float32)
    _stripes(hits.first, along, across, hits.direct, hits.ambient, stripes.light, stripes.aperture, _FINE, _MARGIN,
             shifts, ambients, np.empty(frames), out)  # fmt: skip
    return out.reshape(frames, hits.height, hits.width)


def receive_image(hits: Hits, light: Float32) -> Float32:
    """Light on a camera, (h, w) grey levels at exposure 1, under an image from `project_image`."""
    out = np.empty(hits.height * hits.width, np.float32)
    _image(hits.first, hits.column, hits.row, hits.direct, hits.ambient, light, _COARSE, _MARGIN, out)
    return out.reshape(hits.height, hits.width)
