"""Hough-style votes in the neighbourhood of a suspect: they confirm it and put it in place, or refuse it (paper §3.1).

Every pixel votes for the ellipses through it, by how much the image curves there: the Laplacian of a Gaussian is the
second derivative across a line plus that along it, which is nothing in the mean over a ring, so that no direction needs
to be known. Of all Gaussians one √5 times as wide as the line shows it best in white noise, as
s^(5/2) / (s² + σ²)^(3/2) is largest there: for rims of σ = 1 px the scale at which arcs are traced at half resolution.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.jit import kernel
from metrology.rivets.arcs import RidgeField

Float32 = NDArray[np.float32]

# Standard deviation of uu + vv by that of uu, in white noise: √(1 + 1 + 2/3).
_BOTH = math.sqrt(8 / 3)
_MOST_VOTE = 3.0  # of a pixel: a glint does not outvote a rim
_SHADING_PX = 9  # over which the mean curvature, that of the light, is taken off: of a line's it holds next to nothing
_REACH = 2  # px of the level round a suspect that are voted in, for the centre and for the radius
_PLACES = 32  # nearby at which the same votes are counted
_MOST_ANGLES = 96  # neighbouring pixels on the larger rings: more would vote the same


@dataclass(frozen=True)
class Ballot:
    """Votes of an image's pixels.

    Attributes
    ----------
    votes : (h + 2 margin, w + 2 margin) float32
        Positive for dark lines, in standard deviations of what noise alone votes.
    margin : int
        Pixels on all sides that do not vote.
    """

    votes: Float32
    margin: int

    @classmethod
    def of(cls, field: RidgeField, largest: float) -> Ballot:
        """The votes in a field for ellipses with semi-axes up to `largest` pixels, and half as much for flat ones."""
        curvature = field.derivatives.uu + field.derivatives.vv
        shading = cv2.blur(curvature, (_SHADING_PX, _SHADING_PX))
        margin = int(1.5 * largest) + 3 * _REACH + 3
        height, width = curvature.shape
        votes = np.zeros((height + 2 * margin, width + 2 * margin), np.float32)
        _cast(curvature, shading, field.noise, field.glint, votes[margin:-margin, margin:-margin])
        return cls(votes, margin)

    def poll(self, ellipses: NDArray[np.float64], polarity: float) -> NDArray[np.float64]:
        """Move ellipses to where most votes agree; (n, 2) scores, see `_poll`."""
        scores = np.zeros((len(ellipses), 2))
        moved = np.ascontiguousarray(ellipses)
        _poll(self.votes, self.margin, moved, polarity, scores)
        ellipses[:] = moved
        return scores


@kernel
def _cast(curvature, shading, noise, glint, votes):  # type: ignore[no-untyped-def]
    """Each pixel's vote; none where a glint is or nothing is known."""
    height, width = curvature.shape
    for y in range(height):
        for x in range(width):
            vote = (curvature[y, x] - shading[y, x]) / (_BOTH * noise[y, x])
            if glint[y, x] == 0 and not np.isnan(vote):
                votes[y, x] = min(max(vote, -_MOST_VOTE), _MOST_VOTE)


@kernel
def _ring(a, b, angle, width, du, dv, circle, offset):  # type: ignore[no-untyped-def]
    """Pixels nearest to an ellipse whose centre lies (du, dv) off a pixel, as steps in the flat image; their number."""
    stride = max(1, int(_MOST_ANGLES / (2.0 * math.pi * math.sqrt(a * b))))
    ca = math.cos(angle)
    sa = math.sin(angle)
    angles = 0
    for k in range(0, _MOST_ANGLES, stride):
        p = a * circle[k, 0]
        q = b * circle[k, 1]
        x = du + ca * p - sa * q
        y = dv + sa * p + ca * q
        offset[angles] = math.floor(y + 0.5) * width + math.floor(x + 0.5)
        angles += 1
    return angles


@kernel
def _mean(flat, at, offset, angles):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(angles):
        total += flat[at + offset[k]]
    return total / angles


@kernel
def _poll(votes, margin, ellipses, polarity, scores):  # type: ignore[no-untyped-def]
    """Move suspects to where most votes agree, and say how far these stand out from other places'.

    Parameters
    ----------
    votes : (h, w) float32
        See `ballot`; with a margin on all sides, wider than the largest ellipse and the reach.
    margin : int
        Pixels on each side.
    ellipses : (n, 5) float64, changed
        u, v, semi-axes, angle; without the margin.
    polarity : float
        +1 dark, −1 bright.
    scores : (n, 2) float64, output
        Votes at the best place less the median of those nearby, in their standard deviations; share of twenty-four
        sectors that vote for the ring.
    """
    height, width = votes.shape
    flat = votes.ravel()
    offset = np.empty(_MOST_ANGLES, np.int64)
    circle = np.empty((_MOST_ANGLES, 2))
    for k in range(_MOST_ANGLES):
        circle[k, 0] = math.cos(2.0 * math.pi * k / _MOST_ANGLES)
        circle[k, 1] = math.sin(2.0 * math.pi * k / _MOST_ANGLES)
    values = np.empty(_PLACES)
    for index in range(len(ellipses)):
        u, v, a, b, angle = ellipses[index]
        scores[index] = 0.0
        iu = round(u)
        iv = round(v)
        if iu < 0 or iv < 0 or iu >= width - 2 * margin or iv >= height - 2 * margin:
            continue
        # Flatter ones would grow by more than the margin allows for; no head is seen so aslant.
        if max(a, b) + 3.0 * _REACH + 2.0 > margin or min(a, b) < 0.4 * max(a, b):
            continue
        at = (iv + margin) * width + iu + margin
        best = -1e9
        bu = 0
        bv = 0
        grown = 0.0
        for step in range(-_REACH, _REACH + 1):
            scale = 1.0 + step / math.sqrt(a * b)
            if scale < 0.6:
                continue
            angles = _ring(a * scale, b * scale, angle, width, u - iu, v - iv, circle, offset)
            for q in range(-_REACH, _REACH + 1):
                for p in range(-_REACH, _REACH + 1):
                    value = polarity * _mean(flat, at + q * width + p, offset, angles)
                    if value > best:
                        best = value
                        bu = p
                        bv = q
                        grown = step
        u += bu
        v += bv
        scale = 1.0 + grown / math.sqrt(a * b)
        a *= scale
        b *= scale
        # Half a pixel finer.
        cu = u
        cv = v
        ca = a
        cb = b
        for step in range(-1, 2):
            scale = 1.0 + 0.5 * step / math.sqrt(a * b)
            for q in range(-1, 2):
                for p in range(-1, 2):
                    angles = _ring(
                        a * scale, b * scale, angle, width, u + 0.5 * p - iu, v + 0.5 * q - iv, circle, offset
                    )
                    value = polarity * _mean(flat, at, offset, angles)
                    if value > best:
                        best = value
                        cu = u + 0.5 * p
                        cv = v + 0.5 * q
                        ca = a * scale
                        cb = b * scale
        ellipses[index, 0] = cu
        ellipses[index, 1] = cv
        ellipses[index, 2] = ca
        ellipses[index, 3] = cb
        angles = _ring(ca, cb, angle, width, cu - iu, cv - iv, circle, offset)
        n = 0
        away = max(ca, cb) + 4.0
        for k in range(_PLACES):
            r = away * (1.2 + 1.3 * k / _PLACES)
            t = 2.399963 * k
            pu = round(cu + r * math.cos(t))
            pv = round(cv + r * math.sin(t))
            if 0 <= pu < width - 2 * margin and 0 <= pv < height - 2 * margin:
                values[n] = polarity * _mean(flat, (pv + margin) * width + pu + margin, offset, angles)
                n += 1
        if n < 8:
            continue
        middle = np.median(values[:n])
        departures = np.sort(np.abs(values[:n] - middle))
        spread = max(1.4826 * departures[n // 2], departures[int(0.9 * n)] / 1.645) + 1e-12
        scores[index, 0] = (best - middle) / spread
        hits = 0
        for s in range(24):
            total = 0.0
            for k in range(angles * s // 24, angles * (s + 1) // 24):
                total += flat[at + offset[k]]
            if polarity * total > 0.0:
                hits += 1
        scores[index, 1] = hits / 24
