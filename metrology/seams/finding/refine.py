"""A line's centre to hundredths of a pixel: the band's borders fitted at nodes, and the smooth middle between them.

The middle is free of the bias that unequal brightness on both sides gives Steger's points. Nodes whose borders
disagree with their neighbours' (a rivet, a highlight, another seam) do not count; the line runs on across them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.polynomial import polyfit, polyval

from metrology.arrays import Array, Float32, Mask
from metrology.robust import MAD
from metrology.seams.blur import EdgeResponse, PixelBlur
from metrology.seams.finding.band_kernel import borders_at_nodes
from metrology.seams.finding.medians import row_medians
from metrology.seams.polyline import normals, resample, smoothed, smoothest

# Nodes px apart, first to centre the windows, then for good; each looks so far along the line both ways that no two of
# them share pixels: their errors must not pass for the line's own shape.
_FIRST_STEP_PX = 24.0
_STEP_PX = 12.0
_HALF_PX = 6.0
# The window across reaches this far beyond the band, in line widths and px.
_REACH_WIDTHS = 0.5
_MOST_REACH_PX = 6.0
_REACH_PX = 7.0
# Borders at least twice this far apart (three times the blur of lens and pixel) are fitted one by one, each with this
# much of the band at most.
_APART_PX = 2.2
_INNER_PX = 4.0
# A typical lens, and a direction between rows and diagonals; the borders' middle depends on neither.
_BLUR = PixelBlur(lens_px=0.6, spill=0.0)
_DIRECTION = (float(np.cos(np.pi / 8)), float(np.sin(np.pi / 8)))
# Nodes are compared with so many neighbours on each side, and may depart so far from their median, px.
_NEIGHBOURS = 6
_DEPARTURE_PX = 1.5
# Of those, nodes off the smooth line by so many standard deviations are disturbed, if by so many px.
_DISTURBED_SIGMAS = 3.5
_DISTURBED_PX = 0.1
# A band with one border this much fainter than the other is a border alone: of a sticker, of a repair in another paint.
_ONE_SIDED = 0.2
# A node sees the same line where its contrast is at least this share of the usual, and its width at most so many times.
_LEAST_CONTRAST = 0.3
_MOST_WIDTH = 2.0
# The line is taken for a parabola over about ± this length: true to 0.005 px where it swings by 5 px in 800 px.
_SMOOTH_PX = 30.0
# The line is sought beyond its ends, so many nodes at a time: past a band 16 px wide that crosses it at 30° (five
# nodes) and as far again. It is looked for on the parabola through so many nodes behind, which a swing of 5 px in 800
# px leaves by 2 px over the first half: borders are caught from there.
_AHEAD = 12
_BEHIND = 20
_FEWEST_NODES = 4
_LEAST_SHARE = 0.3
# What the fit does not know of (a border's own roughness) spares no node, px.
_LEAST_SIGMA_PX = 0.01


@dataclass(frozen=True)
class Nodes:
    """Fitted cross-sections along a line."""

    centre: Array
    """(n, 2): u, v of the smooth middle."""
    width_px: Array
    """(n,): NaN where the borders could not be told."""
    contrasts: Array
    """(n,): brightness of the band relative to its surroundings, less one: negative for a dark line; NaN likewise."""
    good: Mask
    """(n,) of bool: where the borders were found and agree with their neighbours'."""

    @property
    def contrast(self) -> float:
        """The line's usual one."""
        return float(np.nanmedian(self.contrasts))

    def length_px(self, least_contrast: float) -> float:
        """Over how much of the line the contrast is at least so large."""
        return _STEP_PX * float(np.sum(np.abs(self.contrasts[self.good]) >= least_contrast))


@dataclass(frozen=True)
class _Fits:
    """Offset of the band's middle along the normal, its σ, width and contrast at each node (n,); NaN without a band."""

    offset: Array
    sigma: Array
    width: Array
    contrast: Array

    def weights(self, good: Mask) -> Array:
        """(n,) of good nodes: inverse variances, relative to the usual one; 0 of others."""
        usual = float(np.median(self.sigma[good]))
        return np.where(good, (usual / np.where(good, self.sigma, 1.0)) ** 2, 0.0)

    def consistent(self) -> Mask:
        """Nodes whose borders agree with their neighbours'."""
        good = np.isfinite(self.offset) & np.isfinite(self.contrast)
        if not good.any():
            return good
        usual = float(np.median(self.contrast[good]))
        good &= self.contrast * np.sign(usual) > _LEAST_CONTRAST * abs(usual)
        good &= self.width < _MOST_WIDTH * np.median(self.width[good]) if good.any() else good
        near = np.arange(len(good))[:, None] + np.arange(-_NEIGHBOURS, _NEIGHBOURS + 1)
        within = (near >= 0) & (near < len(good))
        near = np.clip(near, 0, len(good) - 1)
        departure = self.offset - row_medians(self.offset[near], within & good[near])
        return np.asarray(good & (np.abs(departure) < _DEPARTURE_PX))


def fit_nodes(relative: Float32, points: Array, width_px: float) -> Nodes | None:
    """The line's middle from its course to about a pixel (n, 2), and on beyond its ends; None if there is no band."""
    nodes = resample(points, max(_FIRST_STEP_PX, width_px))
    fits = _fit(relative, nodes, width_px)
    good = fits.consistent()
    if good.sum() < max(_FEWEST_NODES, _LEAST_SHARE * len(nodes)):
        return None
    width_px = float(np.median(fits.width[good]))
    nodes = smoothed(_moved(nodes, fits, good), _FIRST_STEP_PX, fits.weights(good))
    nodes = resample(nodes, _STEP_PX)
    for _ in range(2):
        nodes = _grown(relative, nodes, width_px)[::-1]
    fits = _fit(relative, nodes, width_px)
    good = fits.consistent()
    if good.sum() < max(_FEWEST_NODES, _LEAST_SHARE * len(nodes)):
        return None
    centre = _smooth_line(_moved(nodes, fits, good), fits.weights(good))
    first, last = np.flatnonzero(good)[[0, -1]]
    part = slice(first, last + 1)
    width, contrast = (np.where(good, values, np.nan)[part] for values in (fits.width, fits.contrast))
    return Nodes(centre[part], width, contrast, good[part])


def _smooth_line(points: Array, weights: Array) -> Array:
    """The smooth line through good nodes, without those that something beside the line pulls away from it."""
    line, good = smoothed(points, _SMOOTH_PX, weights), weights > 0
    away = np.linalg.norm(points - line, axis=1)
    sigmas = away * np.sqrt(weights)
    limit = _DISTURBED_SIGMAS * MAD * float(np.median(sigmas[good]))
    # What disturbs a node reaches into the next one's window.
    disturbed = np.convolve((sigmas > limit) & (away > _DISTURBED_PX), [1, 1, 1], "same") > 0
    return smoothest(points, np.where(disturbed, 0.0, weights))


def _grown(relative: Float32, nodes: Array, width_px: float) -> Array:
    """Nodes continued beyond the last one for as long as the band goes on there."""
    limit = np.array(relative.shape[::-1]) - 1
    while True:
        known = nodes[-_BEHIND:]
        index = np.arange(float(len(known) + _AHEAD))
        further = _parabola(index[: len(known)], known, index[len(known) :])
        within = ((further >= 0) & (further <= limit)).all(axis=1)
        further = further[: np.append(within, False).argmin()]
        if len(further) == 0:
            return nodes
        trial = np.concatenate([known, further])
        fits = _fit(relative, trial, width_px)
        good = fits.consistent()
        count = _following(good[len(known) :])
        until = len(known) + count
        good[until:] = False
        if count == 0 or good.sum() < _FEWEST_NODES:
            return nodes
        # The band's own middle leads on.
        middle = _moved(trial, fits, good)
        nodes = np.concatenate([nodes, _parabola(index[: len(trial)][good], middle[good], index[len(known) : until])])


def _parabola(index: Array, points: Array, at: Array) -> Array:
    """Points (m, 2) on the parabola through others (n, 2), each coordinate by least squares."""
    return np.asarray(polyval(at, polyfit(index, points, 2)).T)


def _following(good: Mask) -> int:
    """How many nodes ahead are the line's: it is interrupted where as many good ones follow in a row as are bad."""
    count = 0
    while good[count:].any():
        gap = int(good[count:].argmax())
        run = int(np.append(~good[count + gap :], True).argmax())
        if run < gap:
            break
        count += gap + run
    return count


def _moved(nodes: Array, fits: _Fits, good: Mask) -> Array:
    """Nodes on the band's middle; where it could not be told, between those of the neighbours."""
    index = np.arange(len(nodes))
    offset = np.interp(index, index[good], fits.offset[good])
    return np.asarray(nodes + normals(nodes) * offset[:, None])


def _fit(relative: Float32, nodes: Array, width_px: float) -> _Fits:
    """Cross-sections at nodes (n, 2): both borders of the band."""
    half = width_px / 2
    reach = half + min(_REACH_WIDTHS * width_px, _MOST_REACH_PX) + _REACH_PX
    # The floor of a gap is lit on one side and shadowed on the other: each border sees what is next to it.
    inner = half - min(half, _INNER_PX) if half > _APART_PX else -1.0
    response = EdgeResponse.along(_DIRECTION, _BLUR)
    table = np.stack([response.values, response.slopes])
    rows = np.empty((len(nodes), 7))
    borders_at_nodes(relative, nodes, normals(nodes), half, reach, _HALF_PX, inner, response.step, table, rows)
    near, far, variance, near_skin, far_skin, near_band, far_band = rows.T
    skin, band = 0.5 * (near_skin + far_skin), 0.5 * (near_band + far_band)
    near_jump, far_jump = near_band - near_skin, far_band - far_skin
    with np.errstate(invalid="ignore"):
        larger = np.maximum(np.abs(near_jump), np.abs(far_jump))
        two_sided = (np.sign(near_jump) == np.sign(far_jump)) & (
            np.minimum(np.abs(near_jump), np.abs(far_jump)) > _ONE_SIDED * larger
        )
        sound = (skin > 0) & (far > near) & two_sided
    offset, width = 0.5 * (near + far), far - near
    sigma = np.maximum(0.5 * np.sqrt(np.maximum(variance, 0.0)), _LEAST_SIGMA_PX)
    contrast = band / np.where(sound, skin, 1.0) - 1.0
    return _Fits(*(np.where(sound, values, np.nan) for values in (offset, sigma, width, contrast)))
