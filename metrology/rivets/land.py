"""The land of a small recessed head: a plane through its points between recess and rim, all of which blur has touched.

A point near an edge is mixed with what lies beyond. How much of each it has follows from the pictures' blur and from
the pixels of the right one that matching fits together: what lies beyond, spread by both, is its share *w*. With the
recess's floor d below the land and the skin k above it,

    h(x, y) = plane(x, y) − d w_recess(x, y) + k w_outside(x, y)

for the points of which no more than a part lies beyond: a tenth where those are enough. d and k are known to half
of themselves beforehand, and they may differ by as much from one side of the head to the other: walls are lit on one
side, and what one camera sees of them the other does not. What that leaves unknown of the plane is in its covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from metrology.arrays import Array, Mask
from metrology.rivets.patch import Patch
from metrology.robust import MAD, TUKEY, from_scratch, tukey
from metrology.surfaces import Polynomial

_MATCHED_PX = (5, 3)  # along a row and across it, that matching fits together
# Of a point that lies beyond an edge. What is reckoned of it is wrong by a part, so as little as leaves enough points.
_MOST_SHARES, _ENOUGH = (0.1, 0.15), 30
_REACH = 1.6  # radii: points farther from the centre have no part in it
_NEAR_RIM = 0.6  # of the radius: recesses hardly reach farther
_OPEN = 0.8  # of the radius: what has no points there is recess
_ROUNDS = 4
_DEEP = 5.0  # standard deviations below the land is recess
_DEPTH = 0.9  # quantile of what is: walls are less deep
_KNOWN_TO, _LEAST_MM = 0.5, 0.01  # depth and height are known to a share of themselves, and to so much
# Of what edges take off in the mean, what may be left in the height, and in the slope over the radius: their shares are
# reckoned, and walls lit from one side are neither land nor floor.
_HEIGHT_LEFT, _SLOPE_LEFT = 0.1, 0.3
_FEWEST = 12
_UNKNOWNS = 9  # three of the plane, and of each edge


@dataclass(frozen=True)
class _Land:
    """A head's points and pixels."""

    patch: Patch
    skin: Polynomial
    sigma_px: float
    at: tuple[Array, Array]
    """Rows and columns of the points."""
    ratio: Array
    """(rows, columns): distance from the centre over the radius."""
    design: Array
    """(n, 3): 1, x, y of the points."""
    outside: Array
    """(n,): how much of each point lies outside the head."""
    free: Mask
    """(n,): points of the head that may tell it."""

    def clear(self, inside: Array) -> Mask:
        """(n,): those that are little mixed with what lies outside, and of which `inside` (n,) lies in the recess."""
        share = np.maximum(inside, self.outside)
        few, more = (self.free & (share < most) for most in _MOST_SHARES)
        return few if few.sum() >= _ENOUGH else more


def land_surface(patch: Patch, skin: Polynomial, sigma_px: float) -> tuple[Polynomial, Mask] | str:
    """The plane of a head's land and the points that tell it, or why there is none.

    Parameters
    ----------
    skin : Polynomial
        Surface round the head.
    sigma_px : float
        Blur of the pictures, px.
    """
    near = np.hypot(patch.x, patch.y) < _REACH * patch.radius
    found = _land_of(patch.at(near), skin, sigma_px)
    if isinstance(found, str):
        return found
    near[near] = found[1]
    return found[0], near


def _land_of(patch: Patch, skin: Polynomial, sigma_px: float) -> tuple[Polynomial, Mask] | str:
    """The same of the points of the head and just round it."""
    at, ratio = _pixels(patch)
    outside = _share(ratio >= 1, sigma_px)[at]
    design = np.stack([np.ones(len(patch.x)), patch.x, patch.y], axis=1)
    land = _Land(patch, skin, sigma_px, at, ratio, design, outside, (ratio[at] < 1) & patch.usable)
    start = land.free & (outside < _MOST_SHARES[-1]) & (ratio[at] > _NEAR_RIM)
    if start.sum() < _FEWEST:
        return f"head: {int(start.sum())} points clear of its rim, at least {_FEWEST} needed"
    solved = from_scratch(design[start], patch.h[start], absolute=6, iterations=9)
    if solved is None:
        return "points lie too unevenly for a surface"
    found = _refined(land, solved.values)
    for _ in range(_ROUNDS - 1):
        if isinstance(found, str):
            return found
        before, found = found[1], _refined(land, found[0].coefficients)
        if not isinstance(found, str) and np.array_equal(found[1], before):
            break
    return found


def _refined(land: _Land, plane: Array) -> tuple[Polynomial, Mask] | str:
    """The land's plane with what lies below the one before it taken for the recess."""
    patch, skin, ratio = land.patch, land.skin, land.ratio[land.at]
    below = land.design @ plane - patch.h
    deep = below[(ratio < 1) & (below > _DEEP * skin.chi * patch.sigma)]
    depth = float(np.quantile(deep, _DEPTH)) if len(deep) else 0.0
    # How deep a point lies tells how much of it is recess: of an arm as narrow as the blur never all.
    recess = np.where(land.ratio < _OPEN, 1.0, 0.0)
    deeper = (ratio < 1) & (below > _DEEP * skin.chi * patch.sigma)
    recess[land.at] = np.where(deeper, np.minimum(below / max(depth, 1e-9), 1.0), 0.0)
    inside = _share(recess, land.sigma_px)[land.at]
    # What lies above it is no land, but sealant or dirt.
    members = land.clear(inside) & (below > -_DEEP * max(skin.chi, 1.0) * patch.sigma)
    if members.sum() < _FEWEST:
        return f"head: {int(members.sum())} points between recess and rim, at least {_FEWEST} needed"
    above = float(skin.height(0.0, 0.0) - plane[0])
    sides = land.design / [1.0, patch.radius, patch.radius]
    whole = np.hstack([land.design, -inside[:, None] * sides, land.outside[:, None] * sides])[members]
    fitted = _fit(whole, patch.h[members], patch.sigma[members], max(skin.chi, 1.0), depth, above)
    if fitted is None:
        return "points lie too unevenly for a surface"
    taken_off = float(np.mean((depth * inside + abs(above) * land.outside)[members]))
    unmodelled = taken_off * np.array([_HEIGHT_LEFT, _SLOPE_LEFT / patch.radius, _SLOPE_LEFT / patch.radius])
    return replace(fitted, covariance=fitted.covariance + np.diag(unmodelled**2)), members


def _pixels(patch: Patch) -> tuple[tuple[Array, Array], Array]:
    """Where the patch's points lie on a grid of pixels, and each pixel's distance from the centre over the radius."""
    v, u = patch.v - patch.v.min(), patch.u - patch.u.min()
    design = np.stack([np.ones(len(u)), u, v], axis=1).astype(float)
    places, *_ = np.linalg.lstsq(design, np.stack([patch.x, patch.y], axis=1), rcond=None)
    rows, columns = np.mgrid[: v.max() + 1, : u.max() + 1]
    x, y = np.einsum("ijk,kl->lij", np.stack([np.ones(rows.shape), columns, rows], axis=-1), places)
    return (v, u), np.hypot(x, y) / patch.radius


def _share(beyond: Array | Mask, sigma_px: float) -> Array:
    """How much of each point lies beyond an edge, for a mask (or shares) of what does.

    A point comes of a pixel of the left picture and of a window of the right one: what either is mixed with moves it,
    on average by half.
    """
    blurred = cv2.GaussianBlur(beyond.astype(np.float64), (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(0.5 * (blurred + cv2.blur(blurred, _MATCHED_PX, borderType=cv2.BORDER_REPLICATE)), float)


def _fit(design: Array, h: Array, sigma: Array, least_chi: float, depth: float, above: float) -> Polynomial | None:
    """The plane by robust least squares, the recess's depth and the skin's height over the land known roughly.

    `least_chi` is how far the points of the skin scatter over their σ.
    """
    expected = np.array([0.0, 0.0, 0.0, depth, 0.0, 0.0, above, 0.0, 0.0])
    known_to = _KNOWN_TO * np.abs(np.repeat([depth, above], 3)) + _LEAST_MM
    known = np.diag([0.0, 0.0, 0.0, *known_to**-2.0])
    towards = known @ expected
    weights, chi = np.ones(len(h)), least_chi
    for _ in range(_ROUNDS):
        weighted = design * (weights / (chi * sigma) ** 2)[:, None]
        normal = weighted.T @ design + known
        try:
            solution = np.linalg.solve(normal, weighted.T @ h + towards)
        except np.linalg.LinAlgError:
            return None
        residual = (h - design @ solution) / sigma
        chi = max(MAD * float(np.median(np.abs(residual))), least_chi)
        weights = tukey(residual / (TUKEY * chi))
    if weights.sum() <= _UNKNOWNS:
        return None
    rms = float(np.sqrt(np.mean((residual * sigma)[weights > 0] ** 2)))
    covariance = np.asarray(np.linalg.inv(normal)[:3, :3], float)
    return Polynomial(1, solution[:3], covariance, rms, chi, weights)
