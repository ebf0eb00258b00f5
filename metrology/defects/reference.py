"""The skin of one plate as it would be without its defects.

A plate is a paraboloid with a term in h² (which makes whole cylinders and spheres of it), a polynomial that has no wave
shorter than the largest defect's foot, and, beside a seam, a profile along it: sheets that are held unevenly at a seam
are bent by straight ruled lines across it, which is a step that changes along the seam and no dent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.polynomial.legendre import leg2poly, legvander
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs

from metrology.arrays import Array
from metrology.defects.ruled import BIN_MM, Ruled, bent_along, medians_along, turned
from metrology.defects.ruled_kernel import add_polylines, stiffest
from metrology.defects.surface_kernel import depths, surface_heights
from metrology.robust import MAD, TUKEY, median, tukey
from metrology.surfaces import Frame

_PLAIN = 7  # terms of the paraboloid with h²: 1, x, y, x², xy, y², h²
_SQUARES = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))  # powers of x and y of those without h²
_ROUNDS = 5
_CONVERGED = 0.02  # change of the surface, standard deviations of a cell
_LEAST_DEGREE, _MOST_DEGREE = 4, 8  # a torus needs the fourth
_BEND_SD = 0.3  # of half the plate's extent over the diameter
_WAVE_SD_MM = 0.02  # of the polynomial's terms before the plate itself tells
_WAVE_RANGE_MM = (2e-4, 0.2)
_FIT_CELLS = 2000  # of a plate are enough for its surface
_STIFFEST_MM = 1e-5  # standard deviation of a profile's second differences at least; at most ten thousand times that
_PROFILE_SD_MM = 1.0  # of a profile's heights beforehand: what they share with the surface is the surface's
_LEAST_CELLS = 100
_THINNEST = 0.02  # of its extent: narrower strips tell no surface


@dataclass(frozen=True)
class Reference:
    """A plate without defects."""

    frame: Frame
    """With its origin in the middle of the plate."""
    extents: Array
    """(2,): half the plate's size along x and y, mm."""
    waves: NDArray[np.int64]
    """(m, 2) of int: degrees in x and y of the polynomial's terms."""
    coefficients: Array
    covariance: Array
    """coefficients, covariance: (7 + m,), (7 + m + nodes, …): of `design`, and of the heights of `ruled` behind it,
    over the larger extent; for noise as the residuals show it."""
    ruled: tuple[Ruled, ...] = ()
    noise: float = 1.0
    """Residuals over the cells' own standard deviation."""
    wave_sd: float = 0.0
    """Standard deviation of the polynomial's terms, mm; 0 until the plate has told it."""
    density: float = 0.0
    """Cells that it was fitted to, for each mm² of the plate."""
    together: float = 1.0
    """By how much the skin's waves raise the variance that independent cells would leave."""

    @property
    def extent(self) -> float:
        """The larger one, mm."""
        return float(self.extents.max())

    def height(self, x: Array, y: Array) -> Array:
        """Heights in the plate's frame, mm."""
        return np.asarray(self.smooth(x, y) + self.ruled_height(x, y))

    def smooth(self, x: Array, y: Array) -> Array:
        """(n,) heights without the ruled profiles, mm."""
        out = np.empty(len(x))
        bend = self.coefficients[_PLAIN - 1]
        surface_heights(x / self.extents[0], y / self.extents[1], self._powers(), bend, out)
        return out * self.extent

    def ruled_height(self, x: Array, y: Array) -> Array:
        """What is bent along seams alone, mm."""
        return np.asarray(sum((profile.at(x, y) for profile in self.ruled), np.zeros_like(x)))

    def variance(self, x: Array, y: Array) -> Array:
        """Of `height`, mm², by noise of the cells and waves of the skin."""
        design = np.zeros((len(x), len(self.covariance)))
        first = len(self.coefficients)
        design[:, :first] = self.design(x, y, self.smooth(x, y))
        every = np.arange(len(x))
        for profile in self.ruled:
            low, share = profile.nodes(x, y)
            design[every, first + low], design[every, first + low + 1] = 1 - share, share
            first += len(profile.heights)
        return np.asarray(((design @ self.covariance) * design).sum(axis=-1) * self.extent**2 * self.together)

    def depths(self, points: Array, member: NDArray[np.bool_], out: Array) -> None:
        """Write how far points (rows, columns, 3) of the rig frame lie below it along its normal, mm, for members."""
        ruled = np.array([[*p.direction, p.start, len(p.heights)] for p in self.ruled]).reshape(-1, 4)
        heights = np.zeros((len(self.ruled), max([len(p.heights) for p in self.ruled], default=0)))
        for row, profile in zip(heights, self.ruled, strict=True):
            row[: len(profile.heights)] = profile.heights
        frame = self.frame
        surface = self.extents, self.coefficients, self._powers(), ruled, heights
        depths(points, member, frame.origin, np.ascontiguousarray(frame.axes), *surface, BIN_MM, out)

    def _powers(self) -> Array:
        """(d + 1, d + 1) coefficients of u^i v^j of all explicit terms."""
        c, most = self.coefficients, int(self.waves.sum(axis=1).max(initial=2))
        powers = np.zeros((most + 1, most + 1))
        for value, (i, j) in zip(c, _SQUARES, strict=False):
            powers[i, j] = value
        legendre = np.zeros_like(powers)
        legendre[tuple(self.waves.T)] = c[_PLAIN:]
        by_power = _legendre_powers(most)
        return np.asarray(powers + by_power.T @ legendre @ by_power)

    def tangent(self, point: Array) -> Frame:
        """Frame of its tangent plane at the foot of a point (3,) of the rig frame; profiles and waves are flat."""
        x, y = self.frame.local(point)[:2]
        c, (ex, ey), e = self.coefficients, self.extents, self.extent
        slope_x = (c[1] + 2 * c[3] * x / ex + c[4] * y / ey) * e / ex
        slope_y = (c[2] + c[4] * x / ex + 2 * c[5] * y / ey) * e / ey
        height = float(self.height(np.array([x]), np.array([y]))[0])
        normal = np.array([-slope_x, -slope_y, 1.0]) @ self.frame.axes
        return Frame.on_plane(self.frame.rig([x, y, height]), normal)

    def with_waves(self, waves: float, cell_sd: float, largest_mm: float) -> Reference:
        """With the uncertainty that waves of the skin bring, since cells on one of them err together.

        The longest wave that the reference does not follow has a half-wave L of `largest_mm`; under its correlation,
        about exp(−(π d / L)² / 2), lies an area of 2 L² / π.

        Parameters
        ----------
        waves : float
            Their standard deviation, mm.
        cell_sd : float
            Of a cell's own noise, mm.
        """
        cells = self.density * 2 / np.pi * largest_mm**2
        return replace(self, together=1 + cells * (waves / cell_sd) ** 2)

    def spans(self, points: Array) -> list[tuple[float, float]]:
        """From where to where points (n, 3) of the rig frame lie along each profile, bins."""
        x, y = self.frame.local(points)[:, :2].T
        places = [profile.places(x, y) for profile in self.ruled]
        return [(float(place.min()), float(place.max())) for place in places]

    def design(self, x: Array, y: Array, h: Array) -> Array:
        """(n, k) the paraboloid's terms and h², then the polynomial's (Legendre's), of coordinates over the extents."""
        x, y, h = x / self.extents[0], y / self.extents[1], h / self.extent
        columns = [np.ones_like(x), x, y, x * x, x * y, y * y, h * h]
        if len(self.waves):
            most = int(self.waves.max())
            by_x, by_y = (legvander(axis, most).T for axis in (x, y))
            columns += [by_x[i] * by_y[j] for i, j in self.waves]
        return np.stack(columns, axis=-1)


@cache
def _legendre_powers(most: int) -> Array:
    """(most + 1, most + 1) coefficients of the powers in Legendre's polynomials, a row each."""
    return np.stack([np.pad(leg2poly(row), (0, most + 1))[: most + 1] for row in np.eye(most + 1)])


def fit_reference(
    points: Array,
    sigma: Array,
    seams: Sequence[tuple[Array, Array]],
    largest_mm: float,
    like: Reference | None = None,
    dents_known: bool = True,
) -> Reference | None:
    """The reference of a plate; None where its cells lie too unevenly.

    Parameters
    ----------
    points : (n, 3) ndarray
        Its sound cells that no defect covers, rig frame, mm.
    sigma : (n,) ndarray
        Standard deviation of their z for independent pixels, mm.
    seams : sequence of ((3,), (3,)) ndarray
        Two points on the course of each seam beside it, rig frame.
    largest_mm : float
        Length of the largest defect of interest.
    like : Reference
        Of much the same cells: its frame, its terms, and how large they are where it says so, and its lines are this
        one's.
    dents_known : bool
        Whether dents are left out. Before, only what is bent along a seam in all of its parts is taken for bent.
    """
    if len(points) < _LEAST_CELLS:
        return None
    part = slice(None, None, max(1, len(points) // _FIT_CELLS))
    shape = like or _shape(points[part], largest_mm)
    if shape is None:
        return None
    x, y, h = np.ascontiguousarray(shape.frame.local(points[part]).T)
    sd = shape.frame.height_sigma(points[part], sigma[part])
    if like:
        return _fitted(like, x, y, h, sd)
    # The paraboloid and the profiles first: waves would take part of the profiles.
    fitted = _fitted(replace(shape, waves=shape.waves[:0]), x, y, h, sd)
    rest = h - fitted.smooth(x, y)
    directions = [np.diff(shape.frame.local(np.stack(seam)), axis=0)[0, :2] for seam in seams]
    if not dents_known:
        directions = bent_along(rest, sd, x, y, directions)
    if not directions:
        return _fitted(shape, x, y, h, sd)
    fitted = _fitted(replace(fitted, ruled=medians_along(rest, x, y, directions)), x, y, h, sd)
    rest = h - fitted.height(x, y)
    ruled = tuple(turned(profile, rest, x, y) for profile in fitted.ruled)
    return _fitted(replace(shape, ruled=ruled, coefficients=fitted.coefficients), x, y, h, sd)


def fit_contour(points: Array, sigma: Array) -> Reference | None:
    """A plate's paraboloid alone, which waves and dents lie over; None where its cells lie too unevenly.

    Parameters as of `fit_reference`.
    """
    if len(points) < _LEAST_CELLS:
        return None
    part = slice(None, None, max(1, len(points) // _FIT_CELLS))
    shape = _shape(points[part], np.inf)
    if shape is None:
        return None
    x, y, h = np.ascontiguousarray(shape.frame.local(points[part]).T)
    return _fitted(replace(shape, waves=shape.waves[:0]), x, y, h, shape.frame.height_sigma(points[part], sigma[part]))


def _shape(points: Array, largest_mm: float) -> Reference | None:
    """Frame, extents and waves of a plate's reference; None of a strip that is too narrow."""
    middle = points.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov((points - middle).T))
    frame = Frame.on_plane(middle, axes[:, 0])
    local = frame.local(points)[:, :2]
    low, high = local.min(axis=0), local.max(axis=0)
    extents = 0.5 * (high - low)
    if extents.min() < _THINNEST * extents.max():
        return None
    centred = Frame(frame.rig([*(0.5 * (low + high)), 0.0]), frame.axes)
    density = len(points) / float(4 * extents.prod())
    most = np.clip(2 * extents // largest_mm, _LEAST_DEGREE, _MOST_DEGREE).astype(int)
    waves = [(i, j) for i in range(most[0] + 1) for j in range(most[1] + 1) if 3 <= i + j <= most.max()]
    terms = np.array(waves, np.int64).reshape(-1, 2)
    return Reference(centred, extents, terms, np.zeros(0), np.zeros((0, 0)), density=density)


@dataclass(frozen=True)
class _Polylines:
    """Profiles as columns behind the surface's in normal equations."""

    low: NDArray[np.int64]
    share: Array
    """low, share: (p, n): column of the node before each cell, and share of the way to the next."""
    lever: Array
    """(n,): by which a height over the extent counts in a cell."""
    parts: list[slice]
    """Columns of each profile."""

    @classmethod
    def of(cls, shape: Reference, x: Array, y: Array, lever: Array) -> _Polylines:
        """Those of a plate's profiles."""
        ends = _PLAIN + len(shape.waves) + np.cumsum([0, *(len(profile.heights) for profile in shape.ruled)])
        nodes = [profile.nodes(x, y) for profile in shape.ruled]
        low = np.array([before + first for (before, _), first in zip(nodes, ends, strict=False)], np.int64)
        share = np.array([part for _, part in nodes])
        parts = [slice(*pair) for pair in pairwise(ends)]
        return cls(low.reshape(-1, len(x)), share.reshape(-1, len(x)), lever, parts)

    def at(self, solution: Array) -> Array:
        """(n,) their sum at the cells."""
        values = solution[self.low] * (1 - self.share) + solution[self.low + 1] * self.share
        return np.asarray(self.lever * values.sum(axis=0))

    def hold(self, normal: Array, right: Array, solution: Array, noise: float, extent: float) -> None:
        """Add to symmetric normal equations how stiff each profile is, which its own values tell."""
        rest = right - normal @ solution
        for part in self.parts:
            block = normal[part, part]
            own, shared = block.diagonal().copy(), np.append(block.diagonal(1), 0.0)
            told = rest[part] + block @ solution[part]
            own += (noise * extent / _PROFILE_SD_MM) ** 2
            stiffness = stiffest(own, shared, told, noise, _STIFFEST_MM / extent)
            block += stiffness * _bending(len(block)) + np.diag(own - block.diagonal())


@cache
def _bending(count: int) -> Array:
    """(count, count) of the sum of squared second differences."""
    bends = np.diff(np.eye(count), 2, axis=0)
    return np.asarray(bends.T @ bends)


def _factor(normal: Array) -> Array:
    """(k, k) Cholesky's factor of normal equations, above the diagonal; by LAPACK's own call, as many are small.

    Raises
    ------
    numpy.linalg.LinAlgError
        They are not positive definite.
    """
    factor, failed = dpotrf(normal, clean=0)
    if failed:
        raise np.linalg.LinAlgError(f"normal equations are not positive definite at row {failed}")
    return np.asarray(factor)


def _fitted(shape: Reference, x: Array, y: Array, h: Array, sd: Array) -> Reference:
    """Reweighted least squares with Tukey's weights, of the surface and the profiles at once.

    How much the polynomial waves, and how stiff the profiles are, the plate itself tells. Coefficients and profiles
    that the shape has are near already.
    """
    e, terms = shape.extent, _PLAIN + len(shape.waves)
    lines = _Polylines.of(shape, x, y, e / sd)
    design = shape.design(x, y, h) * (e / sd[:, None])
    target = h / sd
    solution = np.zeros(lines.parts[-1].stop if lines.parts else terms)
    weights, noise, wave_sd = np.ones(len(x)), 1.0, shape.wave_sd or _WAVE_SD_MM
    if len(shape.coefficients):
        solution[: len(shape.coefficients)] = shape.coefficients
        solution[terms:] = np.concatenate([np.zeros(0), *(profile.heights for profile in shape.ruled)]) / e
        residual = np.abs(target - design @ solution[:terms] - lines.at(solution))
        noise = MAD * median(residual) + 1e-9
        weights = tukey(residual / (TUKEY * noise))
    predicted = np.zeros(len(x))
    for number in range(_ROUNDS):
        waves = np.full(len(shape.waves), (wave_sd / e) ** -2)
        prior = np.concatenate([np.zeros(_PLAIN - 1), [_BEND_SD**-2], waves])
        normal, right = np.zeros((len(solution), len(solution))), np.zeros(len(solution))
        normal[:terms, :terms] = design.T @ (design * weights[:, None]) + np.diag(prior * noise**2)
        right[:terms] = design.T @ (weights * target)
        if lines.parts:
            add_polylines(lines.low, lines.share, lines.lever, design, weights, target, normal, right)
            normal = np.triu(normal) + np.triu(normal, 1).T
            lines.hold(normal, right, solution, noise, e)
        factor = _factor(normal)
        solution = dpotrs(factor, right)[0]
        before, predicted = predicted, design @ solution[:terms] + lines.at(solution)
        residual = np.abs(target - predicted)
        noise = MAD * median(residual) + 1e-9
        weights = tukey(residual / (TUKEY * noise))
        if number > 1 and np.abs(predicted - before).max() < _CONVERGED * noise:
            break
        if number > 0 and len(waves) and not shape.wave_sd:
            variance = noise**2 * np.diag(dpotrs(factor, np.eye(len(normal), terms))[0])
            second = solution[_PLAIN:terms] ** 2 + variance[_PLAIN:]
            wave_sd = float(np.clip(e * np.sqrt(second.mean()), *_WAVE_RANGE_MM))
    ruled = tuple(
        replace(profile, heights=solution[part] * e) for profile, part in zip(shape.ruled, lines.parts, strict=True)
    )
    upper = np.triu(dpotri(factor)[0])
    covariance = noise**2 * (upper + np.triu(upper, 1).T)
    return replace(
        shape, coefficients=solution[:terms], ruled=ruled, covariance=covariance, noise=noise, wave_sd=wave_sd
    )
