"""The head's own surface: a plane, a dome, or a plane with its slot cut out."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Mask
from metrology.rivets.land import land_surface
from metrology.rivets.patch import Patch
from metrology.rivets.settings import RivetSettings
from metrology.surfaces import Polynomial

_UNEVEN = "points lie too unevenly for a surface"
# Points this many standard deviations off a surface do not belong to it: one in 2 million by noise.
_OFF = 5.0
# Where the guard is more of the radius, what is clear of the rim may be the recess alone: recesses reach to 0.6 of it.
_SMALL = 0.25
# A recess leaves little of a small head. Four points for each unknown of a plane make one; U95 says how good it is.
_FEWEST_CLEAR = 12
_PLENTY = 150  # of such points tell a head as well as all of its land does
_FEW = 0.01  # share of such points that dirt and single wrong matches make
# RANSAC finds a surface on which this share of the points lies: sixty samples of three hold four good ones.
_LEAST_SHARE = 0.4
# A slot lies below the head. With more than this share above it, a surface is the slot's floor.
_MOST_ABOVE = 0.1
# Neighbours share the noise of the right view: a mean's variance is up to twice that of independent points.
_INFLATION = 2.0
# Scatter of a head's points over that of the skin's, in their σ: at most 1.4 on heads whose surface was found. What
# blur leaves of a narrow slot on a small head lies on no surface, and passes for one.
_ROUGH = 1.8
# The same of a land whose edges were reckoned as they are; more remains where nothing of it is clear of them.
_ROUGH_LAND = 1.5
# Tilt of a head of which a recess leaves a part: a wall of the recess leans more, a head hardly ever a third of it.
_MOST_LEAN_DEG = 5.0


def head_surface(
    patch: Patch, inner: Mask, skin: Polynomial, settings: RivetSettings, generator: np.random.Generator
) -> tuple[Polynomial, Mask] | str:
    """Surface of a head and the points that it was fitted to, or why there is none.

    Parameters
    ----------
    inner : (n,) bool
        Points of the head.
    skin : Polynomial
        Surface round the head; its residuals tell how far the noise is from σ.
    """
    surface = _plane_or_dome(patch, inner, settings, generator)
    if surface is None:
        return _UNEVEN
    found: tuple[Polynomial, Mask] | str = (surface, inner)
    if np.mean(_off(patch, inner, surface, skin) != 0) > _FEW:
        found = _beside_recesses(patch, inner, skin, settings, generator)
        if not isinstance(found, str) and (leans := _lean_deg(found[0], skin)) > _MOST_LEAN_DEG:
            return f"head: what is clear of its recesses leans by {leans:.1f}°, as a recess's wall does"
    elif _may_be_floor(patch, surface):
        land = _land(patch, skin, settings)
        if not isinstance(land, str) and _lies_below(surface, land[0]):
            found = land
    return found if isinstance(found, str) else _unless_rough(found, skin, _ROUGH)


def _may_be_floor(patch: Patch, surface: Polynomial) -> bool:
    """Whether a small head's surface may be the floor of a recess that fills it: what is near the rim lies higher."""
    if patch.guard <= _SMALL * patch.radius:
        return False
    away = np.hypot(patch.x, patch.y)
    near = patch.usable & (away > (1 - _SMALL) * patch.radius - 0.5 * patch.guard)
    near &= away < patch.radius - 0.5 * patch.guard
    above = patch.h[near] - surface.height(0.0, 0.0)
    return len(above) > 0 and bool(np.median(above) > np.median(patch.sigma[near]))


def _land(patch: Patch, skin: Polynomial, settings: RivetSettings) -> tuple[Polynomial, Mask] | str:
    """The land of the head, see `land_surface`, where what is reckoned of its edges explains it."""
    land = land_surface(patch, skin, (patch.guard_px - settings.guard_px) / settings.guard_sigmas)
    return land if isinstance(land, str) else _unless_rough(land, skin, _ROUGH_LAND)


def _unless_rough(found: tuple[Polynomial, Mask], skin: Polynomial, limit: float) -> tuple[Polynomial, Mask] | str:
    rough = _roughness(found[0], skin)
    return f"head: its points scatter {rough:.1f} times as far as the skin's" if rough > limit else found


def _roughness(surface: Polynomial, skin: Polynomial) -> float:
    """How far a head's points scatter, over the skin's."""
    return surface.chi / max(skin.chi, 1.0)


def _beside_recesses(
    patch: Patch, inner: Mask, skin: Polynomial, settings: RivetSettings, generator: np.random.Generator
) -> tuple[Polynomial, Mask] | str:
    """The surface of points clear of recesses; where they are few or scatter, the land's if that is known better."""
    found: list[tuple[Polynomial, Mask]] = []
    clear = _clear_of_recesses(patch, inner, skin, generator)
    if clear is not None and clear.sum() >= _FEWEST_CLEAR:
        surface = _plane_or_dome(patch, clear, settings, generator)
        if surface is not None:
            found.append((surface, clear))
            if clear.sum() >= _PLENTY and _roughness(surface, skin) <= _ROUGH:
                return found[0]
    land = _land(patch, skin, settings)
    if not isinstance(land, str):
        found.append(land)
    elif not found:
        return land
    smooth = [one for one in found if _roughness(one[0], skin) <= _ROUGH]
    return min(smooth or found, key=lambda one: _variance(one[0], patch.radius))


def _variance(surface: Polynomial, radius: float = 0.0) -> float:
    """Of a surface's height, mm²: at the head's centre, or the mean over the head."""
    return float(surface.covariance[0, 0] + 0.25 * radius**2 * (surface.covariance[1, 1] + surface.covariance[2, 2]))


def _lies_below(surface: Polynomial, land: Polynomial) -> bool:
    """Whether a surface lies below the land beside the rim: then it is a recess's floor."""
    sd = np.sqrt(_INFLATION * (_variance(surface) + _variance(land)))
    return bool(land.height(0.0, 0.0) - surface.height(0.0, 0.0) > _OFF * sd)


def _plane_or_dome(
    patch: Patch, members: Mask, settings: RivetSettings, generator: np.random.Generator
) -> Polynomial | None:
    """A quadric where its crown is larger than `min_crown_mm` and than four standard deviations, else a plane."""
    if members.sum() >= 2 * settings.min_inner:
        quadric = patch.surface(members, 2, generator)
        if quadric is not None:
            # Crown over the full radius: −(c_xx + c_yy) R² / 2.
            by = np.zeros(6)
            by[3] = by[5] = -0.5 * patch.radius**2
            deviation = float(np.sqrt(by @ quadric.covariance @ by * _INFLATION))
            if abs(by @ quadric.coefficients) > max(settings.min_crown_mm, 4 * deviation):
                return quadric
    return patch.surface(members, 1, generator)


def _lean_deg(surface: Polynomial, skin: Polynomial) -> float:
    """Angle between a surface and the skin at the head's centre."""
    (_, a1, b1), (_, a0, b0) = surface.tangent(0.0, 0.0)[0], skin.tangent(0.0, 0.0)[0]
    return float(np.degrees(np.arctan(np.hypot(a1 - a0, b1 - b0))))


def _off(patch: Patch, members: Mask, surface: Polynomial, skin: Polynomial) -> NDArray[np.float64]:
    """(m,) −1, 0 or 1 for members below, on or above a surface."""
    distance = patch.h[members] - surface.height(patch.x[members], patch.y[members])
    return np.sign(distance) * (np.abs(distance) > _OFF * skin.chi * patch.sigma[members])


def _clear_of_recesses(patch: Patch, inner: Mask, skin: Polynomial, generator: np.random.Generator) -> Mask | None:
    """Points clear of a head's slots: on the surface that most share, the guard away from all that are not.

    Next to a slot's edge phase is mixed, as it is at the rim. None where there is no such surface.
    """
    for order in (1, 2):
        surface = patch.surface(inner, order, generator, scale=skin.chi)
        if surface is None:
            continue
        off = _off(patch, inner, surface, skin)
        if np.mean(off == 0) < _LEAST_SHARE or np.mean(off > 0) > _MOST_ABOVE:
            continue
        u, v = patch.u - patch.u.min(), patch.v - patch.v.min()
        recess = np.zeros((v.max() + 1, u.max() + 1), np.uint8)
        recess[v[inner][off != 0], u[inner][off != 0]] = 1
        size = 2 * int(np.ceil(patch.guard_px)) + 1
        recess = cv2.dilate(recess, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
        return np.asarray(inner & (recess[v, u] == 0))
    return None
