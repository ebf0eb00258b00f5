"""What circles on the skin look like in the image: told by the cloud, or learnt from rings that are beyond doubt."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from metrology.arrays import Array
from metrology.rivets.ellipse import Ellipse, ellipse_of_shape
from metrology.robust import MAD

SHAPE_TOLERANCE = 0.15  # of an elongation: five standard deviations of what is expected (see `ring.fit_ring`)


@dataclass(frozen=True)
class CircleShapes:
    """What a circle on the surface looks like: one ellipse shape of determinant 1 per cell of the image."""

    matrices: Array
    """(rows, columns, 3): entries uu, vv, uv of Σ, see `Ellipse.shape`."""
    cell: float
    """Size of a cell, px."""
    freedom: float = 0.0
    """By how much the elongation of an ellipse that is looked for may depart from that, see `log_shape`."""

    @classmethod
    def round(cls) -> CircleShapes:
        """Circles look like circles everywhere, or like anything up to 1 : 2: nothing is known."""
        return cls(np.array([[[1.0, 1.0, 0.0]]]), 1e9, math.log(2))

    @classmethod
    def of_elongation(cls, elongation: Array, cell: float, freedom: float = 0.0) -> CircleShapes:
        """From (rows, columns, 2) elongations, see `log_shape`: exp of the symmetric matrix [[x, y], [y, −x]]."""
        e = np.linalg.norm(elongation, axis=-1)
        ratio = np.sinh(e) / np.maximum(e, 1e-9)
        x, y = elongation[..., 0] * ratio, elongation[..., 1] * ratio
        return cls(np.stack([np.cosh(e) + x, np.cosh(e) - x, y], axis=-1), cell, freedom)

    def at(self, u: Array, v: Array) -> Array:
        """(n, 3) shapes at pixels."""
        rows, columns = self.matrices.shape[:2]
        i = np.clip((np.asarray(v) / self.cell).astype(int), 0, rows - 1)
        j = np.clip((np.asarray(u) / self.cell).astype(int), 0, columns - 1)
        return self.matrices[i, j]

    def ellipse(self, u: float, v: float, radius: float) -> Ellipse:
        """What a circle about a pixel looks like whose image has the given radius (geometric mean of the semi-axes)."""
        uu, vv, uv = self.at(np.array([u]), np.array([v]))[0]
        return ellipse_of_shape(u, v, radius**2 * np.array([[uu, uv], [uv, vv]]))


def log_shape(ellipse: Ellipse) -> Array:
    """(2,) elongation e cos 2θ, e sin 2θ with e = ln(a/b): 0 for a circle, smooth through it."""
    return np.log(ellipse.a / ellipse.b) * np.array([np.cos(2 * ellipse.angle), np.sin(2 * ellipse.angle)])


def shapes_of(ellipses: list[Ellipse], size: tuple[int, ...]) -> CircleShapes | None:
    """What circles look like where rings tell it: all lie on one panel, which the camera sees at one slant.

    The elongation is taken as linear over the image, or constant where there are fewer than eight rings; those that
    disagree are left out. None below four rings.
    """
    if len(ellipses) < 4:
        return None
    columns = 3 if len(ellipses) >= 8 else 1
    at = np.array([[1.0, e.u / size[1], e.v / size[0]] for e in ellipses])[:, :columns]
    values = np.array([log_shape(e) for e in ellipses])
    keep = np.linalg.norm(values - np.median(values, axis=0), axis=1) < 0.15
    for _ in range(3):
        if keep.sum() < 4:
            return None
        model, *_ = np.linalg.lstsq(at[keep], values[keep], rcond=None)
        error = np.linalg.norm(values - at @ model, axis=1)
        keep = error <= max(0.03, 3 * MAD * float(np.median(error)))
    cell = 64.0
    v, u = np.mgrid[0 : np.ceil(size[0] / cell), 0 : np.ceil(size[1] / cell)]
    place = np.stack([np.ones_like(u), (u + 0.5) * cell / size[1], (v + 0.5) * cell / size[0]], axis=-1)[..., :columns]
    return CircleShapes.of_elongation(place @ model, cell, SHAPE_TOLERANCE)
