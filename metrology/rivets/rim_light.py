"""How much light is missing across a ring's line, in each camera: what tells a gap from a painted line.

The light that is missing across a line, over that of what lies on either side, is a length: for a black gap, its width.
Neither blur nor the light's strength changes it. A gap takes more of it from a camera that looks straight in than from
one that looks in at a slant and sees its lit wall; paint takes as much from every camera. With the angles θ between the
skin's normal and both cameras' directions,

    log(missing left / missing right) = k log(cos θ left / cos θ right)

holds for all gaps of a scan with one k (about 3 to 4 for deep ones), and with k = 0 for paint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrology.arrays import Array
from metrology.cloud import Reconstruction
from metrology.rivets.bilinear import sample_image
from metrology.robust import MAD
from metrology.surfaces import Frame

_DIRECTIONS = 24
_REACH_PX, _SPACING_PX = 4.5, 0.5  # of a profile across the line
_FLANK = 3  # outermost places on either side, where skin and head are as bright as they are
_SEEN = 0.5  # of the directions, in which all cameras must show the line
_FEW = 4  # gaps that tell what is usual
_SCATTER = 3.0  # standard deviations beyond which a line takes more light than gaps do
_AS_MUCH = (1 / 1.6, 1.3)  # times what is usual: dirt fills gaps, and nothing makes them wider
_LEAST_SCATTER = 0.5  # log of what gaps may differ by in any case: dirt, and gaps of other widths
_APART = 4.0  # standard deviations between what gaps and what paint would show, to tell them apart
_NEARER = 1 / 3  # of that distance within which a ring is one of them
_LEAST_SD = 0.03  # of a ratio's logarithm: brightness of head and skin from both sides


@dataclass(frozen=True)
class RimLight:
    """Light missing across a ring's line."""

    missing_mm: Array
    """(cameras,): median over the directions; negative for a bright line."""
    ratio: float
    """log(left / right); NaN with one camera, or where the two do not show the same."""
    ratio_sd: float
    obliqueness: float
    """log(cos θ left / cos θ right)."""

    @property
    def mean_mm(self) -> float:
        """Of all cameras."""
        return float(self.missing_mm.mean())


def rim_light(reconstruction: Reconstruction, frame: Frame, radius: float, pixel: float) -> RimLight | None:
    """The light missing across a ring; None where too little of it is seen.

    Parameters
    ----------
    frame : Frame
        On the skin, with the ring's centre as origin.
    radius, pixel : float
        Of the ring, and what a pixel shows there, mm.
    """
    turn = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
    around = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=1)
    away = np.arange(-_REACH_PX, _REACH_PX + 0.5 * _SPACING_PX, _SPACING_PX) * pixel
    places = frame.rig((radius + away)[:, None, None] * around)
    missing, slants = [], []
    for device, view in reconstruction.cameras.values():
        profile = sample_image(view.texture, device.project(places))
        inside, outside = profile[:_FLANK].mean(axis=0), profile[-_FLANK:].mean(axis=0)
        beside = np.where(away[:, None] < 0, inside, outside)
        missing.append(_SPACING_PX * pixel * (1 - profile / beside)[_FLANK:-_FLANK].sum(axis=0))
        way = device.centre - frame.origin
        slants.append(abs(float(way @ frame.axes[2])) / float(np.linalg.norm(way)))
    known = np.isfinite(missing).all(axis=0)
    if known.mean() < _SEEN:
        return None
    seen = np.array(missing)[:, known]
    level = np.median(seen, axis=1)
    if len(level) < 2 or level[0] * level[1] <= 0:
        return RimLight(level, np.nan, np.nan, 0.0)
    off = np.abs(np.diff(seen, axis=0)[0] - (level[1] - level[0]))
    sd = MAD * float(np.median(off)) / np.sqrt(known.sum()) / abs(level.mean())
    return RimLight(level, float(np.log(level[0] / level[1])), float(sd), float(np.log(slants[0] / slants[1])))


@dataclass(frozen=True)
class GapLight:
    """What light a scan's gaps take."""

    usual_mm: float
    """Of what they take in the median, the sign too; NaN where too few tell."""
    most_mm: float
    """A line that takes more is none of them; inf where too few tell."""
    slope: float
    slope_sd: float
    """slope, slope_sd: k; 0 and inf where too few tell."""
    scatter: float
    """Of the ratio's logarithm about k times the obliqueness."""

    @classmethod
    def of(cls, gaps: Sequence[RimLight]) -> GapLight:
        """From the lines of a scan's fasteners beyond doubt."""
        taken = np.array([gap.mean_mm for gap in gaps if gap.mean_mm])
        usual, most = np.nan, np.inf
        if len(taken) >= _FEW:
            usual = float(np.median(taken))
            middle = float(np.median(np.log(np.abs(taken))))
            scatter = MAD * float(np.median(np.abs(np.log(np.abs(taken)) - middle)))
            most = float(np.exp(middle + max(_SCATTER * scatter, _LEAST_SCATTER)))
        told = np.array([(g.obliqueness, g.ratio) for g in gaps if np.isfinite(g.ratio)]).reshape(-1, 2)
        if len(told) < _FEW or not told[:, 0].any():
            return cls(usual, most, 0.0, np.inf, np.inf)
        slant, ratio = told.T
        # The median of slopes, each weighed by its slant: lines across which dirt or a glint lies do not count.
        order = np.argsort(ratio / np.where(slant == 0, np.inf, slant))
        share = np.cumsum(np.abs(slant)[order])
        half = order[int(np.searchsorted(share, 0.5 * share[-1]))]
        slope = float(ratio[half] / slant[half])
        scatter = float(np.hypot(MAD * np.median(np.abs(ratio - slope * slant)), _LEAST_SD))
        return cls(usual, most, slope, scatter / float(np.sqrt((slant**2).sum())), scatter)

    def takes_more(self, line: RimLight) -> bool:
        """Whether a line takes more light than these gaps do: it is wider, or darker, or both."""
        return abs(line.mean_mm) > self.most_mm

    def takes_as_much(self, line: RimLight, shown: float) -> bool:
        """Whether a line takes about as much light as these gaps do where it shows, in a share of its directions."""
        return bool(_AS_MUCH[0] < line.mean_mm / (shown * self.usual_mm) < _AS_MUCH[1])

    def side(self, line: RimLight) -> float | None:
        """0 for what looks alike from both cameras, as paint does, 1 for what these gaps show; None without a telling.

        It tells nothing in the middle between both cameras, nor where gaps themselves look alike from both.
        """
        expected = self.slope * line.obliqueness
        if not np.isfinite(line.ratio) or not np.isfinite(self.slope_sd):
            return None
        sd = np.sqrt(self.scatter**2 + line.ratio_sd**2 + (self.slope_sd * line.obliqueness) ** 2)
        return line.ratio / expected if abs(expected) > _APART * sd else None

    def is_paint(self, line: RimLight) -> bool:
        """Whether a line looks alike from both cameras where gaps do not."""
        side = self.side(line)
        return side is not None and abs(side) < _NEARER

    def is_gap(self, line: RimLight) -> bool:
        """Whether a line looks as different from both cameras as gaps do."""
        side = self.side(line)
        return side is not None and abs(side - 1) < _NEARER
