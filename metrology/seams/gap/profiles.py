"""Grey levels across a seam at its stations, as both cameras see them, ready for the fit of the gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.jit import kernel
from metrology.rig import Device
from metrology.seams.gap.levels import LEVEL_SCATTER
from metrology.seams.gap.model import LEVELS
from metrology.seams.gap.views import View, section_maps
from metrology.seams.sampling import LocalMap, binned, sample
from metrology.seams.skins.sections import Section

# Skin in view beyond each expected border, px: enough for its brightness and its slope.
_SKIN_PX = 8.0
# Beyond them a map of pixels holds, mm.
_SKIN_MM = 2.0
# A border's blur, and the error of where it is expected, reach this far onto the skin, px.
BLUR_PX = 3.0
_BIN_PX = 1.0 / 3.0
_MIN_BINS = 4
# Relative grey level below which the sensor's noise outweighs the grain.
_DARKEST = 0.05
# A station's scatter counts up to so many times the usual; beyond, what stands beside the gap is no skin but the end of
# the light or a hole, and the station is to look odd.
_MOST_SCATTER = 8.0


# Fields of `Profiles` that are not by station.
_OF_THE_SEAM = ("normals", "ambient", "chamfer_slope", "level_scatter")


@dataclass(frozen=True)
class Profiles:
    """Binned pixels of n stations in k cameras; bins beyond `sizes` are not in use."""

    stations: NDArray[np.int64]
    """(n,) of int: which of the seam's stations each is."""
    half_widths: Array
    """(n,): where the borders are expected, mm from the centre line."""
    places: Array
    """(n,): −1 at the seam's beginning to 1 at its end."""
    x: Array
    """(n, k, bins): on the reference curve, mm."""
    grey: Array
    variance: Array
    """grey, variance: (n, k, bins): grey level relative to the skin's, and its variance."""
    sizes: NDArray[np.int64]
    """(n, k) of int."""
    tilts: Array
    """(n, 2): height of skin A above the reference curve, and its slope."""
    eyes: Array
    """(n, k, 2): cameras' x and h in the section, mm."""
    lamps: Array
    """(n, 2): the projector's."""
    px_mm: Array
    """(n, k): pixels per mm across the seam."""
    normals: Array
    """(k, 2): unit vector across the seam in each image, mean of the stations."""
    ambient: Array
    """(k,): share of the skin's brightness that does not follow the fringes."""
    chamfer_slope: float
    """Tangent of the chamfers' angle against the skin."""
    courses: Array
    """(n, k, LEVELS): what a station's usual levels differ from the seam's."""
    level_scatter: Array
    """(LEVELS,): standard deviation of a station's own levels about them."""

    def at(self, which: NDArray[np.int64]) -> Profiles:
        """Some of the stations."""
        picked = {f.name: getattr(self, f.name)[which] for f in fields(self) if f.name not in _OF_THE_SEAM}
        return replace(self, **picked)


def collect(
    sections: Sequence[Section | None],
    half_widths: Sequence[float],
    views: tuple[View, View],
    projector: Device,
    half_length: float,
    chamfer_slope: float,
) -> Profiles | None:
    """Profiles of all stations that have a section and whose skin a camera sees; None where there is none."""
    there = [(i, section) for i, section in enumerate(sections) if section is not None]
    if not there:
        return None
    halves = np.array([half_widths[i] for i, _ in there])
    maps = [section_maps([s for _, s in there], view.device, halves + _SKIN_MM, half_length) for view in views]
    rows = []
    for (i, section), half, local in zip(there, halves, zip(*maps, strict=True), strict=True):
        seen = [_profile(one, half, view, half_length) for one, view in zip(local, views, strict=True)]
        if any(one is not None for one in seen):
            rows.append((i, section, half, seen))
    if not rows:
        return None
    most = max(len(one.x) for *_, seen in rows for one in seen if one is not None)
    n, k = len(rows), len(views)
    x, grey, counts = np.zeros((n, k, most)), np.zeros((n, k, most)), np.ones((n, k, most))
    sizes, px_mm, scatter = np.zeros((n, k), np.int64), np.ones((n, k)), np.full((n, k), np.nan)
    eyes, lamps, tilts = np.zeros((n, k, 2)), np.zeros((n, 2)), np.zeros((n, 2))
    normals = np.full((k, 2), 1e-9)
    for row, (_, section, _, seen) in enumerate(rows):
        tilts[row] = 0.5 * (section.a.coefficients - section.b.coefficients)[:2]
        lamps[row] = section.frame.local(projector.centre)[[0, 2]]
        for c, (view, one) in enumerate(zip(views, seen, strict=True)):
            eyes[row, c] = section.frame.local(view.device.centre)[[0, 2]]
            if one is None:
                continue
            size = sizes[row, c] = len(one.x)
            x[row, c, :size], grey[row, c, :size], counts[row, c, :size] = one.x, one.grey, one.counts
            px_mm[row, c], scatter[row, c] = one.px_mm, one.scatter
            normals[c] += one.gradient
    # Grain is the same stuff all along the seam, and a station alone tells its scatter poorly; but one whose skin
    # scatters more has a highlight's border or a scratch on it.
    usual = np.array([np.median(one[np.isfinite(one)]) if np.isfinite(one).any() else 1.0 for one in scatter.T])
    own = np.minimum(np.fmax(scatter, usual), _MOST_SCATTER * usual)
    expected = np.array([half for *_, half, _ in rows])
    stations = np.array([i for i, *_ in rows])
    return Profiles(
        stations=stations,
        half_widths=expected,
        places=2.0 * stations / max(len(sections) - 1, 1) - 1.0,
        x=x,
        grey=grey,
        # Grain is a share of the brightness: in the dark there is little of it.
        variance=own[:, :, None] * np.maximum(grey, _DARKEST) ** 2 / counts,
        sizes=sizes,
        tilts=tilts,
        eyes=eyes,
        lamps=lamps,
        px_mm=px_mm,
        normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
        ambient=np.array([view.ambient for view in views]),
        chamfer_slope=chamfer_slope,
        courses=np.zeros((n, k, LEVELS)),
        level_scatter=LEVEL_SCATTER,
    )


@dataclass(frozen=True)
class _Profile:
    """One station in one camera; `scatter` is the variance of a bin times its pixels."""

    x: Array
    grey: Array
    counts: Array
    px_mm: float
    gradient: tuple[float, float]
    scatter: float


def _profile(local: LocalMap, half: float, view: View, half_length: float) -> _Profile | None:
    """What one camera shows, relative to the skin's mean beyond the border; None without skin on both sides."""
    px_mm = local.px_per_unit
    reach = half + _SKIN_PX / px_mm
    x, _, grey = sample(view.texture, local, -reach, reach, half_length)
    if len(x) == 0:
        return None
    x, grey, counts = binned(x, grey, _BIN_PX / px_mm)
    level, scatter = _skin(x, grey, counts, half + BLUR_PX / px_mm)
    if not level > 0:
        return None
    return _Profile(x, grey / level, counts, px_mm, local.gradient, scatter)


@kernel
def _skin(x, grey, counts, border):  # type: ignore[no-untyped-def]
    """Brightness of the skin on both sides, and the variance of a bin times its pixels relative to it.

    What bins scatter about each side's straight line is grain and noise, correlated within a bin as they are. The
    brightness is NaN without enough bins on both sides, or where one of them is dark.
    """
    level = squares = 0.0
    freedom = 0
    for side in (-1.0, 1.0):
        n, mean_x, mean, moment, spread = 0, 0.0, 0.0, 0.0, 0.0
        for k in range(x.size):
            if side * x[k] > border:
                n += 1
                mean_x += x[k]
                mean += grey[k]
        if n < _MIN_BINS or not mean > 0.0:
            return np.nan, np.nan
        mean_x, mean = mean_x / n, mean / n
        for k in range(x.size):
            if side * x[k] > border:
                moment += (x[k] - mean_x) * (grey[k] - mean)
                spread += (x[k] - mean_x) ** 2
        for k in range(x.size):
            if side * x[k] > border:
                squares += (grey[k] - mean - (x[k] - mean_x) * moment / spread) ** 2 * counts[k]
        level += 0.5 * mean
        freedom += n - 2
    return level, squares / freedom / level**2
