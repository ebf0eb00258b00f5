"""Scratches that look like seams: grooves in one skin, without a second sheet.

A seam parts two sheets, so that it runs on to where the skin ends, to another seam, or out of the picture. A shallow
groove that begins and ends in the middle of the skin parts nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrology.arrays import Array, Mask
from metrology.results import SeamLine
from metrology.seams.finding.relief import SKIN_PX, Relief

# A seam's line ends no farther than that from what it runs on to: its last pixels may fade, and a panel's rim of 16 px
# is not searched.
_FREE_PX = 60
# Pixels in a row that are no skin are where it ends; single ones lack a point by chance.
_GONE_PX = 8
# Its direction at an end comes of so many px.
_WAY_PX = 40
_CLEAR_PX = 6.0  # of another line's border
_SAME = 0.8  # share of a line that runs beside a scratch


def scratches_of(found: Sequence[tuple[SeamLine, Relief]], skin: Mask, heads: Mask) -> list[SeamLine]:
    """The lines that are shallow grooves with both ends in the skin, and those that are their edges.

    A head at an end hides what comes next: beyond it the skin must go on as well.

    Parameters
    ----------
    found : sequence of (SeamLine, Relief)
    skin : (h, w) ndarray of bool
        Pixels with a point.
    heads : (h, w) ndarray of bool
        Pixels of heads.
    """
    lines = [line for line, _ in found]
    scratches = [line for line, relief in found if relief.is_shallow_groove and _is_free(line, lines, skin, heads)]
    # An edge of a scratch may be a line of its own; the scratch in one of its skins makes the step.
    edges = [a for a, relief in found if relief.groove_share < relief.step_share and _along_one(a, scratches)]
    return scratches + [a for a in edges if all(a is not b for b in scratches)]


def _is_free(line: SeamLine, lines: Sequence[SeamLine], skin: Mask, heads: Mask) -> bool:
    """Whether both ends of a line lie in the skin, far from where it ends and from other lines."""
    course = line.centre_px
    back = min(len(course) - 1, _WAY_PX)
    others = [other for other in lines if other is not line]
    return all(
        _runs_on_in_skin(end, end - before, others, skin, heads)
        for end, before in ((course[0], course[back]), (course[-1], course[-1 - back]))
    )


def _runs_on_in_skin(end: Array, way: Array, others: Sequence[SeamLine], skin: Mask, heads: Mask) -> bool:
    steps = end + np.arange(1, max(skin.shape))[:, None] * way / max(float(np.linalg.norm(way)), 1e-9)
    u, v = np.rint(steps).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < skin.shape[1]) & (v < skin.shape[0])
    steps, u, v = steps[inside], u[inside], v[inside]
    bare = np.flatnonzero(~heads[v, u])[:_FREE_PX]
    if len(bare) < _FREE_PX or np.convolve(~skin[v[bare], u[bare]], np.ones(_GONE_PX), "valid").max() >= _GONE_PX:
        return False
    return not any(_beside(steps[: bare[-1] + 1], other, _CLEAR_PX).any() for other in others)


def _along_one(line: SeamLine, scratches: Sequence[SeamLine]) -> bool:
    """Whether nearly all of a line has the same scratch in the skin beside it."""
    return any(float(_beside(line.centre_px[::4], scratch, SKIN_PX).mean()) > _SAME for scratch in scratches)


def _beside(places: Array, line: SeamLine, reach_px: float) -> Mask:
    """(n,) which of places (n, 2) lie on a line or so near to its border."""
    apart = np.linalg.norm(places[:, None] - line.centre_px[None, ::4], axis=2).min(axis=1)
    return np.asarray(apart < 0.5 * float(np.nanmedian(line.width_px)) + reach_px)
