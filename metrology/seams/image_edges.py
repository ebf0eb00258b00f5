"""Both edges of a gap from both cameras' images, laid onto the skin lines (`edges: image`).

One camera sees a wall of the gap, so the dark band's middle is not the gap's. What both cameras see sharply is C, the
border of each skin. It is found by shifting the edge's shape (`edge_shape`) over each station's pixels, laid along the
viewing ray onto the skin line, and averaged over the cameras; the ideal edges D′ and G′ lie a chamfer's width
further in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metrology.seams.bands import BandFit, fit_bands
from metrology.seams.blur import EdgeResponse, PixelBlur
from metrology.seams.edge_shape import Chamfer, Profile, Stretch, estimate_blurs, solve_chamfer, stacks, stretches
from metrology.seams.sampling import sample
from metrology.seams.sections import Section
from metrology.seams.views import SectionView, View

Array = NDArray[np.float64]

SIDES = ("a", "b")
# Reach of a profile onto the skin and into the gap, px: while C is sought, and when the shape is fitted.
_SEARCH_PX = (8.0, 4.0)
_OUTER_PX = 6.0
_INNER_PX = 5.0
_NEAR_PX = 3.0
# So far from a border its blur does not reach; fewer pixels beyond do not tell the skin's brightness.
_BLUR_REACH_PX = 2.2
_MIN_SKIN_PIXELS = 12
# A border this far from its neighbours' run is another one (a scratch, a label), px.
_STRAY_PX = 1.0
_RUN = 11
# The edges' shape is found from profiles aligned on C, and C with that shape: so often in turn.
_ROUNDS = 2
# A chamfer narrower than this is not seen, px.
_THIN_CHAMFER_PX = 0.3
# What model and calibration leave in a border however many pixels see it, px.
_BORDER_FLOOR_PX = 0.02


@dataclass(frozen=True)
class Edge:
    """One side's edge at one station.

    Attributes
    ----------
    border_mm : float
        x of C on the skin line.
    ideal_mm : float
        x of the ideal edge (D′ or G′).
    depth_mm : float
        Depth of the inflection point (D or G) under it.
    sigma_border_mm : float
        Of the border at this station alone.
    sigma_chamfer_mm : float
        Of the chamfer's width, common to the whole seam.
    """

    border_mm: float
    ideal_mm: float
    depth_mm: float
    sigma_border_mm: float
    sigma_chamfer_mm: float


@dataclass(frozen=True)
class _Border:
    """C in one camera: x on the reference curve, its standard deviation, and the camera's map."""

    x: float
    sigma: float
    seen: SectionView


Run = list[_Border | None]


def image_edges(
    sections: Sequence[Section | None],
    half_widths: Sequence[float],
    views: tuple[View, View],
    half_length: float,
    min_snr: float,
) -> list[tuple[Edge | None, Edge | None]]:
    """Edges A and B of every station.

    Parameters
    ----------
    sections : sequence of Section or None
        One per station, in order along the seam.
    half_widths : sequence of float
        Half the width of the line as detected, mm.
    views : (View, View)
    half_length : float
        ε_d, mm.
    min_snr : float
        Least ratio of an edge's contrast to the noise around it.
    """
    maps = [
        [
            None if section is None else SectionView.of(section, view.device, half + 2.0, half_length)
            for section, half in zip(sections, half_widths, strict=True)
        ]
        for view in views
    ]
    runs = {
        side: [
            _borders(view, seen, half_widths, side, half_length, min_snr)
            for view, seen in zip(views, maps, strict=True)
        ]
        for side in SIDES
    }
    blurs: list[PixelBlur] = []
    chamfers: dict[str, Chamfer] = {}
    for _ in range(_ROUNDS):
        profiles = {
            side: [_profiles(view, run, side, half_length) for view, run in zip(views, runs[side], strict=True)]
            for side in SIDES
        }
        stacked = {side: [stacks(own) for own in profiles[side]] for side in SIDES}
        blurs = estimate_blurs([[*stacked["a"][k], *stacked["b"][k]] for k in range(len(views))], blurs or None)
        for side in SIDES:
            seen_by = [stretches(own, blur) for own, blur in zip(stacked[side], blurs, strict=True)]
            chamfers[side] = solve_chamfer(seen_by)
            starts = [_usual_offset(own) for own in seen_by]
            runs[side] = [
                _without_strays(
                    [_refined(side, b, p, chamfers[side], blur, start) for b, p in zip(run, own, strict=True)]
                )
                for run, own, blur, start in zip(runs[side], profiles[side], blurs, starts, strict=True)
            ]
    edges = {
        side: [
            _combined(side, section, [run[i] for run in runs[side]], chamfers[side])
            for i, section in enumerate(sections)
        ]
        for side in SIDES
    }
    return list(zip(edges["a"], edges["b"], strict=True))


def _sign(side: str) -> float:
    """Direction of x from the skin into the gap."""
    return 1.0 if side == "a" else -1.0


def _profile(
    view: View, seen: SectionView, side: str, zero: float, half_length: float, reach_px: tuple[float, float]
) -> Profile:
    """Pixels around an expected border; `reach_px` onto the skin and into the gap."""
    into = _sign(side)
    px_mm = seen.local.px_per_unit
    low, high = sorted((zero - into * reach_px[0] / px_mm, zero + into * reach_px[1] / px_mm))
    x, _, grey = sample(view.texture, seen.local, low, high, half_length)
    return Profile(into * (x - zero), grey, into * seen.ray_slope(zero), px_mm, seen.local.gradient)


def _relative(profile: Profile) -> Profile | None:
    """The profile relative to its skin's mean grey level, taken where the border's blur does not reach."""
    skin = profile.grey[profile.x * profile.px_mm < -_BLUR_REACH_PX]
    if len(skin) < _MIN_SKIN_PIXELS or skin.mean() <= 0:
        return None
    return replace(profile, grey=profile.grey / skin.mean())


def _borders(
    view: View,
    maps: Sequence[SectionView | None],
    half_widths: Sequence[float],
    side: str,
    half_length: float,
    min_snr: float,
) -> Run:
    """C of every station as a single blurred step: off by the chamfer's brightness, but alike at all stations."""
    run: Run = []
    for seen, half in zip(maps, half_widths, strict=True):
        border = None
        if seen is not None:
            x: float = -_sign(side) * half
            fit: BandFit | None = None
            for reach in (_SEARCH_PX, (_OUTER_PX, _NEAR_PX), (_OUTER_PX, _NEAR_PX)):
                reach = (reach[0], min(reach[1], half * seen.local.px_per_unit))
                p = _profile(view, seen, side, x, half_length, reach)
                fit = fit_bands(p.x, p.grey, [0.0], EdgeResponse.along(p.gradient, PixelBlur()), slopes=(True, False))
                if fit is None or abs(fit.shifts[0]) * p.px_mm > _SEARCH_PX[0]:
                    fit = None
                    break
                x += _sign(side) * float(fit.shifts[0])
            if fit is not None and abs(fit.levels[1] - fit.levels[0]) > min_snr * fit.rms:
                border = _Border(x, float(np.sqrt(fit.covariance[0, 0])), seen)
        run.append(border)
    return _without_strays(run)


def _without_strays(run: Run) -> Run:
    """The run without borders that leave the line of their neighbours."""
    x = np.array([np.nan if b is None else b.x for b in run])
    kept: Run = []
    for i, border in enumerate(run):
        window = x[max(0, i - _RUN // 2) : i + _RUN // 2 + 1]
        known = window[np.isfinite(window)]
        stray = border is None or abs(border.x - np.median(known)) * border.seen.local.px_per_unit > _STRAY_PX
        kept.append(None if stray else border)
    return kept


def _profiles(view: View, run: Run, side: str, half_length: float) -> list[Profile | None]:
    """The pixels around each border found."""
    return [
        None if b is None else _relative(_profile(view, b.seen, side, b.x, half_length, (_OUTER_PX, _INNER_PX)))
        for b in run
    ]


def _usual_offset(found: Sequence[Stretch]) -> float:
    """Where C lies relative to the border that was found first: at it, or a chamfer's width before it."""
    return float(np.median([s.offset_mm for s in found])) if found else 0.0


def _refined(
    side: str, border: _Border | None, profile: Profile | None, chamfer: Chamfer, blur: PixelBlur, start: float
) -> _Border | None:
    """C in one camera, found anew from `start` with the seam's edge shape and the camera's blur."""
    if border is None or profile is None:
        return None
    apparent = chamfer.apparent(profile.t)
    edges = [start, start + apparent] if apparent * profile.px_mm > _THIN_CHAMFER_PX else [0.0]
    # Beyond the chamfer only so much of the gap as is needed: shadows and the floor begin farther in.
    near = profile.x * profile.px_mm < max(_NEAR_PX, edges[-1] * profile.px_mm + 1.2)
    fit = fit_bands(
        profile.x[near],
        profile.grey[near],
        edges,
        EdgeResponse.along(profile.gradient, blur),
        ties=np.ones((len(edges), 1)),
        slopes=(True, False),
    )
    if fit is None:
        return None
    sigma = np.hypot(np.sqrt(fit.covariance[0, 0]), _BORDER_FLOOR_PX / profile.px_mm)
    return replace(border, x=border.x + _sign(side) * float(fit.edges[0]), sigma=float(sigma))


def _combined(side: str, section: Section | None, borders: Run, chamfer: Chamfer) -> Edge | None:
    """Mean of what the cameras see, weighted by inverse variance; the spread between them widens its uncertainty."""
    found = [b for b in borders if b is not None]
    if section is None or not found:
        return None
    x = np.array([b.seen.on_skin(b.x, getattr(section, side)) for b in found])
    weights = np.array([b.sigma for b in found]) ** -2.0
    mean = float((weights * x).sum() / weights.sum())
    variance = 1.0 / weights.sum()
    if len(x) > 1:
        variance *= max(1.0, float((weights * (x - mean) ** 2).sum() / (len(x) - 1)))
    return Edge(
        border_mm=mean,
        ideal_mm=mean + _sign(side) * chamfer.width_mm,
        depth_mm=chamfer.depth_mm,
        sigma_border_mm=float(np.sqrt(variance)),
        sigma_chamfer_mm=float(np.sqrt(chamfer.covariance[0, 0])),
    )
