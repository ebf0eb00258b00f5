"""The shape that both cameras see of a seam's edges, shared by all its stations: chamfers and blur.

Paper Fig. 8: L1 ends at C, the chamfer runs down to the inflection point D, and the ideal edge D′ is D's projection
onto
L1. A camera shows C where the bright skin ends and D where the chamfer turns into the gap's wall or hides its floor. C
lies on the skin and is sharp in both views. D lies deeper by an unknown depth d: in a view whose rays lean by the
tangent
t towards the gap (t > 0: it sees this side's wall), the chamfer of width w appears ``a = w + d t`` wide on the skin.
Two
views with different t give w and d; a chamfer is about as deep as wide, which decides where the views lean alike.

A station alone shows too little of this. So the profiles of all stations in a stretch are laid over each other,
aligned on C, and give a; the stretches then share one chamfer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from metrology.seams.bands import BandFit, fit_bands
from metrology.seams.blur import EdgeResponse, PixelBlur
from metrology.seams.sampling import binned

Array = NDArray[np.float64]

# Chamfers to begin with, px.
_START_CHAMFERS_PX = (0.8, 1.6, 3.0)
# Narrower than this, a chamfer and a blur's tail look alike, px.
_LEAST_CHAMFER_PX = 0.4
# Of the gap behind a chamfer at least this must be in view, px.
_LEAST_GAP_PX = 0.7
# A profile reaches this far into the gap, px, and farther only where no chamfer is found so near: shadows and the floor
# begin there.
_REACHES_PX = (3.0, 5.0)
_STATIONS_PER_STRETCH = 8
_BIN_PX = 0.1
# So many stretches show a camera's blur well enough.
_BLUR_STACKS = 10
_LENS_BOUNDS = (0.03, 2.5)
_SPILL_BOUNDS = (0.0, 0.24)
# Least reduction of the residuals' squares, in units of their variance, that proves a second border along a seam.
_SIGNIFICANT = 50.0
# What an imperfect model of blur and brightness leaves in a chamfer's apparent width, however many pixels see it: this
# share of it over the root of the gain (the clearer D is, the less a misfit elsewhere moves it).
_CHAMFER_MISFIT = 3.0
# A chamfer's depth is its width give or take this share.
_DEPTH_SHARE = 0.3
# Squares beyond this in so few rows mean that they are not of the same thing.
_CONTRADICTION = 9.0
# A view leaning less than this towards the gap need not see the wall.
_FACING = 0.05


@dataclass(frozen=True)
class Profile:
    """What one camera shows of one side's edge at one station.

    Attributes
    ----------
    x : (n,) ndarray
        Into the gap from the skin's border C, on the reference curve, mm.
    grey : (n,) ndarray
        Grey levels relative to the skin's.
    t : float
        Ray slope, positive where the camera sees this side's wall.
    px_mm : float
        Pixels per mm across the seam.
    gradient : (float, float)
        Change of x per pixel in u and v, mm.
    """

    x: Array
    grey: Array
    t: float
    px_mm: float
    gradient: tuple[float, float]


@dataclass(frozen=True)
class Stretch:
    """What a stretch of one side's edge looks like in one camera.

    Attributes
    ----------
    offset_mm, apparent_mm : float
        Where C lies relative to the profiles' zero, and the chamfer's apparent width a.
    share : float
        Of C in what locates the edge: its squared contrast over that of C and D.
    sigma_mm : float
        Standard deviation of `apparent_mm`.
    t, px_mm : float
        As in `Profile`, mean.
    gain : float
        By how much a second border lessens the residuals' squares, in units of their variance.
    """

    offset_mm: float
    apparent_mm: float
    share: float
    sigma_mm: float
    t: float
    px_mm: float
    gain: float


@dataclass(frozen=True)
class Chamfer:
    """One side's chamfer.

    Attributes
    ----------
    width_mm, depth_mm : float
        From C to D, along the skin and down.
    covariance : (2, 2) ndarray
    """

    width_mm: float
    depth_mm: float
    covariance: Array

    def apparent(self, t: float) -> float:
        """Width on the skin as seen along rays of slope t, mm."""
        return max(self.width_mm + self.depth_mm * t, 0.0)


@dataclass(frozen=True)
class Stack:
    """The profiles of a stretch laid over each other, in bins of a fraction of a pixel.

    Attributes
    ----------
    x, grey, counts : (n,) ndarray
        Mean position (mm), mean relative grey level, and number of pixels of each bin.
    gradient : (float, float)
    t, px_mm : float
        As in `Profile`, mean.
    """

    x: Array
    grey: Array
    counts: Array
    gradient: tuple[float, float]
    t: float
    px_mm: float

    @property
    def pixel(self) -> float:
        """Change of x per pixel where it changes most, mm."""
        return float(np.hypot(*self.gradient))

    def within(self, reach_px: float) -> Stack:
        """The part that reaches no farther into the gap."""
        near = self.x * self.px_mm <= reach_px
        return replace(self, x=self.x[near], grey=self.grey[near], counts=self.counts[near])

    def fits(
        self, blur: PixelBlur, starts: Sequence[float] = _START_CHAMFERS_PX
    ) -> tuple[BandFit | None, BandFit | None]:
        """The best fit without and with a chamfer, the latter from several `starts` (its width in px).

        What the profiles are aligned on is the stronger border: C under a dark chamfer, D under a bright one.
        """
        response = EdgeResponse.along(self.gradient, blur)

        def fitted(edges: list[float]) -> BandFit | None:
            return fit_bands(self.x, self.grey, edges, response, slopes=(True, False), counts=self.counts)

        near = 0.3 * self.pixel
        tried = [fitted(start) for px in starts for start in ([-near, px * self.pixel], [-px * self.pixel, near])]
        sound = [fit for fit in tried if fit is not None and self._sound(fit)]
        return fitted([0.0]), min(sound, key=lambda fit: fit.cost, default=None)

    def _sound(self, fit: BandFit) -> bool:
        """Whether a fit with a chamfer means one: wide enough to be seen, with gap behind it, not darker than
        darkness."""
        room = self.x[-1] - fit.edges[1] > _LEAST_GAP_PX * self.pixel
        return bool(room and fit.edges[1] - fit.edges[0] > _LEAST_CHAMFER_PX * self.pixel and fit.levels[1] > 0)


def stacks(profiles: Sequence[Profile | None]) -> list[Stack]:
    """Stacks of neighbouring stations' profiles.

    Parameters
    ----------
    profiles : sequence of Profile or None
        One per station, in order, of one side and camera.
    """
    found = []
    for first in range(0, len(profiles), _STATIONS_PER_STRETCH):
        some = [p for p in profiles[first : first + _STATIONS_PER_STRETCH] if p is not None]
        if 2 * len(some) >= _STATIONS_PER_STRETCH:
            found.append(_stack(some))
    return found


def _stack(profiles: Sequence[Profile]) -> Stack:
    x = np.concatenate([p.x for p in profiles])
    grey = np.concatenate([p.grey for p in profiles])
    gradient = np.mean([p.gradient for p in profiles], axis=0)
    x, grey, counts = binned(x, grey, _BIN_PX * float(np.hypot(*gradient)))
    return Stack(
        x=x,
        grey=grey,
        counts=counts,
        gradient=(float(gradient[0]), float(gradient[1])),
        t=float(np.mean([p.t for p in profiles])),
        px_mm=float(np.mean([p.px_mm for p in profiles])),
    )


def stretch(stack: Stack, blur: PixelBlur) -> Stretch | None:
    """What a stretch shows, given the camera's blur."""
    plain, best = stack.fits(blur)
    if best is None or plain is None:
        return None
    c = best.covariance
    variance = max(float(c[0, 0] + c[1, 1] - 2 * c[0, 1]), 0.0)
    apparent = float(best.edges[1] - best.edges[0])
    jumps = np.diff(best.levels)
    return Stretch(
        offset_mm=float(best.edges[0]),
        apparent_mm=apparent,
        share=float(jumps[0] ** 2 / (jumps**2).sum()),
        sigma_mm=float(np.sqrt(variance)),
        t=stack.t,
        px_mm=stack.px_mm,
        gain=best.n * max(plain.cost / best.cost - 1, 0.0),
    )


def estimate_blurs(cameras: Sequence[Sequence[Stack]], start: Sequence[PixelBlur] | None = None) -> list[PixelBlur]:
    """Each camera's blur: the most likely ones, given stretches of both sides' edges. The cameras share their spill.

    Parameters
    ----------
    cameras : sequence of sequence of Stack
        Per camera, of both sides.
    start : sequence of PixelBlur, optional
        Estimates to improve.
    """
    some = [[stack.within(_REACHES_PX[0]) for stack in own[:: max(1, len(own) // _BLUR_STACKS)]] for own in cameras]
    if not any(some):
        return [PixelBlur() for _ in cameras]

    def unlikelihood(parameters: Array) -> float:
        total = 0.0
        for own, lens_px in zip(some, parameters[:-1], strict=True):
            blur = PixelBlur(float(lens_px), float(parameters[-1]))
            for stack in own:
                costs = [fit.cost for fit in stack.fits(blur, _START_CHAMFERS_PX[1:2]) if fit is not None]
                total += 0.5 * len(stack.x) * np.log(min(costs)) if costs else 0.0
        return total

    n = len(cameras)
    if start is None:
        # Little spill behind a soft lens, or much behind a sharp one: both look alike at first sight.
        first = np.array([0.6] * n + [0.02])
        simplex = np.vstack([first, *(first + 0.25 * np.eye(n + 1)[k] for k in range(n)), [0.15] * n + [0.16]])
    else:
        first = np.array([*(blur.lens_px for blur in start), start[0].spill])
        steps = np.diag([0.06] * n + [0.02])
        simplex = np.vstack([first, first + steps])
    bounds = [_LENS_BOUNDS] * n + [_SPILL_BOUNDS]
    best = minimize(
        unlikelihood,
        first,
        method="Nelder-Mead",
        bounds=bounds,
        options={"initial_simplex": np.clip(simplex, *np.transpose(bounds)), "xatol": 0.01, "fatol": 1.0},
    )
    return [PixelBlur(float(lens_px), float(best.x[-1])) for lens_px in best.x[:-1]]


def stretches(own: Sequence[Stack], blur: PixelBlur) -> list[Stretch]:
    """What one camera shows of one side along the seam, given its blur."""
    found: list[Stretch] = []
    for reach in _REACHES_PX:
        found = [one for stack in own if (one := stretch(stack.within(reach), blur)) is not None]
        if sum(one.gain for one in found) > _SIGNIFICANT:
            break
    return found


def solve_chamfer(views: Sequence[Sequence[Stretch]]) -> Chamfer:
    """Width and depth of one side's chamfer from what each camera's stretches show.

    Least squares on ``a = w + d t``, one row per camera (median of its stretches), and ``d = w`` give or take a
    third of it.
    """
    rows, values = [], []
    facing_without = False
    for found in views:
        clear = [s for s in found if s.sigma_mm < 0.5 * s.apparent_mm]
        if sum(s.gain for s in found) < _SIGNIFICANT or not clear:
            facing_without |= bool(found) and float(np.median([s.t for s in found])) > _FACING
            continue
        apparent = np.array([s.apparent_mm for s in clear])
        scatter = 1.4826 * np.median(np.abs(apparent - np.median(apparent))) / np.sqrt(len(clear))
        own = np.median([s.sigma_mm for s in clear]) / np.sqrt(len(clear))
        misfit = _CHAMFER_MISFIT * np.median(apparent) / np.sqrt(sum(s.gain for s in found))
        sigma = np.hypot(max(scatter, own), misfit)
        rows.append(np.array([1.0, np.median([s.t for s in clear])]) / sigma)
        values.append(np.median(apparent) / sigma)
    if not rows:
        # A wall in full view without a chamfer above it; otherwise a chamfer as dark as the gap cannot be excluded.
        sigma = 0.03 if facing_without else 0.1
        return Chamfer(0.0, 0.0, np.diag([sigma**2, sigma**2]))
    width, depth, covariance, chi2 = _chamfer_of(rows, values)
    if len(rows) > 1 and chi2 > _CONTRADICTION:
        # Another border, a shadow's or the floor's, passes for D in one view: farther out than D itself.
        k = int(np.argmin([v / (r @ [1.0, 1.0]) for r, v in zip(rows, values, strict=True)]))
        width, depth, covariance, _ = _chamfer_of(rows[k : k + 1], values[k : k + 1])
    return Chamfer(max(width, 0.0), max(depth, 0.0), covariance)


def _chamfer_of(rows: Sequence[Array], values: Sequence[float]) -> tuple[float, float, Array, float]:
    """Least squares of the rows and of ``d = w``: w, d, their covariance, and the squares left."""
    scale = _DEPTH_SHARE * float(np.median([v / r[0] for v, r in zip(values, rows, strict=True)]))
    design = np.vstack([*rows, np.array([1.0, -1.0]) / scale])
    target = np.array([*values, 0.0])
    covariance = np.linalg.inv(design.T @ design)
    solution = covariance @ design.T @ target
    chi2 = float(((design @ solution - target) ** 2).sum())
    return float(solution[0]), float(solution[1]), covariance, chi2
