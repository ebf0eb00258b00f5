"""A line's centre to hundredths of a pixel: both borders of the band fitted at nodes, and the smooth middle between them.

The middle is free of the bias that unequal brightness on both sides gives Steger's points. Nodes whose borders
disagree with their neighbours' (a rivet, a highlight, another seam) do not count; the line runs on across them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.seams.bands import fit_bands
from metrology.seams.blur import EdgeResponse, PixelBlur
from metrology.seams.polyline import Array, normals, resample, smoothed
from metrology.seams.sampling import LocalMap, binned, sample

Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Nodes px apart, first to centre the windows, then for good; each looks so far along the line both ways.
_FIRST_STEP_PX = 24.0
_STEP_PX = 8.0
_HALF_PX = 7.0
# The window across reaches this far beyond the band, in line widths and px.
_REACH_WIDTHS = 0.5
_REACH_PX = 7.0
# A typical lens; the borders' middle does not depend on it.
_BLUR = PixelBlur(lens_px=0.6, spill=0.0)
# Pixels are binned across the line; fewer of them tell nothing.
_BIN_PX = 0.25
_MIN_PIXELS = 60
# Nodes are compared with so many neighbours on each side, and may depart so far from their median.
_NEIGHBOURS = 6
_DEPARTURE_PX = 1.5
# A node sees the same line where its contrast is at least this share of the usual, and its width at most so many times.
_LEAST_CONTRAST = 0.3
_MOST_WIDTH = 2.0
# The line is a parabola over about ± this length; at a bend of 1 px in 200 px that is true to 0.01 px.
_SMOOTH_PX = 20.0
# The line is sought beyond its ends, so many nodes at a time; so many bad ones in a run end it.
_AHEAD = 6
_FEWEST_NODES = 4
_LEAST_SHARE = 0.3


@dataclass(frozen=True)
class Nodes:
    """Fitted cross-sections along a line.

    Attributes
    ----------
    centre : (n, 2) ndarray
        u, v of the smooth middle.
    width_px : (n,) ndarray
        NaN where the borders could not be told.
    contrast : float
        Brightness of the band relative to its surroundings, less one: negative for a dark line.
    good : (n,) ndarray of bool
        Where the borders were found and agree with their neighbours'.
    """

    centre: Array
    width_px: Array
    contrast: float
    good: Mask


@dataclass(frozen=True)
class _Fits:
    """Offset of the band's middle along the normal, width and contrast at each node (n,); NaN where there is no band."""

    offset: Array
    width: Array
    contrast: Array

    def consistent(self) -> Mask:
        """Nodes whose borders agree with their neighbours'."""
        good = np.isfinite(self.offset) & np.isfinite(self.contrast)
        if not good.any():
            return good
        usual = float(np.median(self.contrast[good]))
        good &= self.contrast * np.sign(usual) > _LEAST_CONTRAST * abs(usual)
        good &= self.width < _MOST_WIDTH * np.median(self.width[good]) if good.any() else good
        kept = good.copy()
        for i in np.flatnonzero(good):
            near = slice(max(0, i - _NEIGHBOURS), i + _NEIGHBOURS + 1)
            median = np.median(self.offset[near][good[near]])
            kept[i] = abs(self.offset[i] - median) < _DEPARTURE_PX
        return kept


def fit_nodes(relative: Float32, points: Array, width_px: float) -> Nodes | None:
    """The line's middle from its course to about a pixel (n, 2), and on beyond its ends; None if there is no band."""
    nodes = resample(points, max(_FIRST_STEP_PX, width_px))
    fits = _fit(relative, nodes, width_px)
    good = fits.consistent()
    if good.sum() < max(_FEWEST_NODES, _LEAST_SHARE * len(nodes)):
        return None
    width_px = float(np.median(fits.width[good]))
    nodes = smoothed(_moved(nodes, fits, good), _FIRST_STEP_PX, good)
    nodes = resample(nodes, _STEP_PX)
    for _ in range(2):
        nodes = _grown(relative, nodes, width_px)[::-1]
    fits = _fit(relative, nodes, width_px)
    good = fits.consistent()
    if good.sum() < max(_FEWEST_NODES, _LEAST_SHARE * len(nodes)):
        return None
    centre = smoothed(_moved(nodes, fits, good), _SMOOTH_PX, good)
    first, last = np.flatnonzero(good)[[0, -1]]
    part = slice(first, last + 1)
    width = np.where(good, fits.width, np.nan)[part]
    return Nodes(centre[part], width, float(np.median(fits.contrast[good])), good[part])


def _grown(relative: Float32, nodes: Array, width_px: float) -> Array:
    """Nodes continued straight beyond the last one for as long as the band goes on there."""
    height, width = relative.shape
    limit = np.array([width - 1, height - 1])
    while True:
        ahead = nodes[-1] - nodes[max(0, len(nodes) - _AHEAD)]
        ahead /= np.linalg.norm(ahead) + 1e-12
        further = nodes[-1] + _STEP_PX * np.arange(1, _AHEAD + 1)[:, None] * ahead
        further = further[((further >= 0) & (further <= limit)).all(axis=1)]
        if len(further) < 2:
            return nodes
        known = nodes[-_AHEAD:]
        fits = _fit(relative, np.concatenate([known, further]), width_px)
        good = fits.consistent()[len(known) :]
        if not good.any():
            return nodes
        count = int(np.flatnonzero(good)[-1]) + 1
        nodes = np.concatenate([nodes, further[:count]])
        if count < len(further):
            return nodes


def _moved(nodes: Array, fits: _Fits, good: Mask) -> Array:
    """Nodes on the band's middle; where it could not be told, between those of the neighbours."""
    index = np.arange(len(nodes))
    offset = np.interp(index, index[good], fits.offset[good])
    return np.asarray(nodes + normals(nodes) * offset[:, None])


def _fit(relative: Float32, nodes: Array, width_px: float) -> _Fits:
    across = normals(nodes)
    # Unequal steps of `resample` and growing do not matter: each node stands for itself.
    fits = np.array([_borders(relative, node, normal, width_px) for node, normal in zip(nodes, across, strict=True)])
    return _Fits(*fits.T)


def _borders(relative: Float32, node: Array, normal: Array, width: float) -> tuple[float, float, float]:
    """Offset of the band's middle along the normal, its width and contrast; NaN where it is not there."""
    nothing = np.nan, np.nan, np.nan
    reach = (0.5 + _REACH_WIDTHS) * width + _REACH_PX
    local = LocalMap.in_image(node, normal)
    x, _, grey = sample(relative, local, -reach, reach, _HALF_PX)
    if len(x) < _MIN_PIXELS:
        return nothing
    x, grey, counts = binned(x, grey, _BIN_PX)
    fit = fit_bands(x, grey, [-width / 2, width / 2], EdgeResponse.along(local.gradient, _BLUR), counts=counts)
    if fit is None:
        return nothing
    outside = 0.5 * (fit.levels[0] + fit.levels[2])
    contrast = fit.levels[1] / outside - 1.0 if outside > 0 else np.nan
    return float(fit.edges.mean()), float(fit.edges[1] - fit.edges[0]), float(contrast)
