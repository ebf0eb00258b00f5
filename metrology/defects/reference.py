"""The skin of one plate as it would be without its defects.

A plate is a paraboloid with a term in h² (which makes whole cylinders and spheres of it), a polynomial that has no wave
shorter than the largest defect's foot, and, beside a seam, a profile along it: sheets that are held unevenly at a seam
are bent by straight ruled lines across it, which is a step that changes along the seam and no dent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.polynomial.legendre import leg2poly, legvander
from numpy.typing import NDArray

from metrology.defects.ruled import BIN_MM, Ruled, bent_along, ruled_profiles
from metrology.defects.surface_kernel import depths, surface_heights
from metrology.robust import MAD, TUKEY, median, tukey
from metrology.surfaces import Frame

Array = NDArray[np.float64]

_PLAIN = 7  # terms of the paraboloid with h²: 1, x, y, x², xy, y², h²
_SQUARES = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))  # powers of x and y of those without h²
_ROUNDS = 5
_CONVERGED = 0.02  # change of the surface, standard deviations of a cell
_LEAST_DEGREE, _MOST_DEGREE = 4, 8  # a torus needs the fourth
_BEND_SD = 0.3  # of half the plate's extent over the diameter
_WAVE_SD_MM = 0.02  # of the polynomial's terms before the plate itself tells
_WAVE_RANGE_MM = (2e-4, 0.2)
_FIT_CELLS = 2000  # of a plate are enough for its surface
_UNTOLD = 25.0  # times the variance that is usual of it: hardly a cell tells a profile there
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
    """coefficients, covariance: (7 + m,), (…, …): of `design`, over the larger extent; for noise as the residuals show
    it."""
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
        design = self.design(x, y, self.smooth(x, y))
        by_surface = ((design @ self.covariance) * design).sum(axis=-1) * self.extent**2 * self.together
        return np.asarray(sum((profile.variance_at(x, y) for profile in self.ruled), by_surface))

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

    def told(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """(n,) where its cells tell every profile."""
        variances = [(profile.variance_at(x, y), float(np.median(profile.variance))) for profile in self.ruled]
        return np.all([at < _UNTOLD * usual for at, usual in variances], axis=0) if variances else np.ones(len(x), bool)

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
        Of more of the plate's cells: its frame, its terms and how large they are, and its profiles are this one's, too.
    """
    if len(points) < _LEAST_CELLS:
        return None
    part = slice(None, None, max(1, len(points) // _FIT_CELLS))
    shape = replace(like, ruled=()) if like else _shape(points[part], largest_mm)
    if shape is None:
        return None
    x, y, h = np.ascontiguousarray(shape.frame.local(points[part]).T)
    sd = shape.frame.height_sigma(points[part], sigma[part])
    # The paraboloid and the profiles first: waves would take part of the profiles.
    plain = replace(shape, waves=shape.waves[:0])
    fitted = _fitted(plain, x, y, h, sd)
    if like:
        directions = [profile.direction for profile in like.ruled]
    else:
        courses = [np.diff(shape.frame.local(np.stack(seam)), axis=0)[0, :2] for seam in seams]
        directions = bent_along(h - fitted.smooth(x, y), sd, x, y, courses)
    if not directions:
        return _fitted(shape, x, y, h, sd)
    for form in (plain, plain, shape):
        ruled = ruled_profiles(h - fitted.smooth(x, y), sd, x, y, directions)
        directions = [profile.direction for profile in ruled]
        form = replace(form, ruled=ruled)
        fitted = _fitted(form, x, y, h - form.ruled_height(x, y), sd)
    x, y, h = np.ascontiguousarray(shape.frame.local(points).T)
    sd = shape.frame.height_sigma(points, sigma)
    return replace(fitted, ruled=ruled_profiles(h - fitted.smooth(x, y), sd, x, y, directions))


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


def _fitted(shape: Reference, x: Array, y: Array, h: Array, sd: Array) -> Reference:
    """Reweighted least squares with Tukey's weights; how much the polynomial waves, the plate itself tells."""
    e = shape.extent
    design = shape.design(x, y, h) * (e / sd[:, None])
    target = h / sd
    wave_sd = shape.wave_sd or _WAVE_SD_MM
    weights = np.ones(len(x))
    noise, solution = 1.0, np.zeros(design.shape[1])
    for number in range(_ROUNDS):
        waves = np.full(len(shape.waves), (wave_sd / e) ** -2)
        prior = np.concatenate([np.zeros(_PLAIN - 1), [_BEND_SD**-2], waves])
        normal = design.T @ (design * weights[:, None]) + np.diag(prior * noise**2)
        inverse = np.linalg.inv(normal)
        updated = inverse @ (design.T @ (weights * target))
        change = np.abs(design @ (updated - solution)).max()
        solution = updated
        residual = np.abs(target - design @ solution)
        noise = MAD * median(residual) + 1e-9
        weights = tukey(residual / (TUKEY * noise))
        if number > 1 and change < _CONVERGED * noise:
            break
        if number > 0 and len(waves) and not shape.wave_sd:
            second = solution[_PLAIN:] ** 2 + noise**2 * np.diag(inverse)[_PLAIN:]
            wave_sd = float(np.clip(e * np.sqrt(second.mean()), *_WAVE_RANGE_MM))
    covariance = np.asarray(inverse * noise**2, float)
    return replace(shape, coefficients=solution, covariance=covariance, noise=noise, wave_sd=wave_sd)
