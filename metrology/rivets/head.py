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

# Points this many standard deviations off a surface do not belong to it: one in 2 million by noise.
_OFF = 5.0
# A recess leaves little of a small head. Four points for each unknown of a plane make one; U95 says how good it is.
_FEWEST_CLEAR = 12
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
    if surface is not None and np.mean(_off(patch, inner, surface, skin) != 0) > _FEW:
        clear = _clear_of_recesses(patch, inner, skin, generator)
        if clear is None or clear.sum() < _FEWEST_CLEAR:
            land = land_surface(patch, skin, (patch.guard_px - settings.guard_px) / settings.guard_sigmas)
            if isinstance(land, str):
                return land
            surface, inner = land
        else:
            inner, surface = clear, _plane_or_dome(patch, clear, settings, generator)
        if surface is not None and (leans := _lean_deg(surface, skin)) > _MOST_LEAN_DEG:
            return f"head: what is clear of its recesses leans by {leans:.1f}°, as a recess's wall does"
    if surface is None:
        return "points lie too unevenly for a surface"
    rough = surface.chi / max(skin.chi, 1.0)
    return f"head: its points scatter {rough:.1f} times as far as the skin's" if rough > _ROUGH else (surface, inner)


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
