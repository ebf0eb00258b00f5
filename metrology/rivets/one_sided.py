"""Heads of which recesses, glints or shadows leave points to one side only.

The height at such a head's centre is carried there along a slope, and small errors of the points that blur mixes with
a recess bend the slope more than their noise tells. That the head is parallel to the skin is the other guess; how far
the two lie apart is uncertainty: in full where the centre lies further from the points' middle than they scatter.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrology.results import COVERAGE_95
from metrology.rivets.fits import Fits
from metrology.rivets.inflation import Inflation
from metrology.surfaces import Polynomial


def head_from_one_side(fits: Fits, inflation: Inflation) -> Polynomial:
    """The head's surface with what points to one side leave uncertain; the same where they surround the centre.

    Parameters
    ----------
    inflation : Inflation
        By which the variances of heights and slopes exceed those of independent noise.
    """
    head = fits.head
    chosen = np.flatnonzero(fits.inner)[head.weights > 0]
    points = np.stack([fits.patch.x[chosen], fits.patch.y[chosen]])
    middle = points.mean(axis=1)
    away = float(np.linalg.norm(middle))
    outside = min(float(middle @ np.linalg.solve(np.cov(points), middle)), 1.0)
    towards = middle / away
    slope = float((head.tangent(0.0, 0.0)[0] - fits.skin.tangent(0.0, 0.0)[0])[1:] @ towards)
    apart = outside * slope / COVERAGE_95
    covariance = head.covariance.copy()
    covariance[0, 0] += (apart * away) ** 2 / inflation.height
    covariance[1:3, 1:3] += apart**2 * np.outer(towards, towards) / inflation.slope
    return replace(head, covariance=covariance)
