"""Perspective eccentricity: the centre of a disc's elliptic image is not the image of the disc's centre."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from metrology.arrays import Array

_RIM_POINTS = 24


def rim(centres: Array, radii: Array | float) -> Array:
    """(n, m, 2) points on circles about `centres` (n, 2)."""
    angle = np.linspace(0, 2 * np.pi, _RIM_POINTS, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    return centres[:, None, :] + np.broadcast_to(radii, len(centres))[:, None, None] * circle


def ellipse_centres(points: Array) -> Array:
    """Centres (n, 2) of the conics through outlines (n, m, 2).

    Least squares of ``a x² + b x y + c y² + d x + e y = 1`` about each outline's middle, at unit size.
    """
    middle = points.mean(1, keepdims=True)
    size = np.abs(points - middle).max(axis=(1, 2), keepdims=True)
    x, y = np.moveaxis((points - middle) / size, -1, 0)
    design = np.stack([x * x, x * y, y * y, x, y], -1)
    normal = np.einsum("nmi,nmj->nij", design, design)
    a, b, c, d, e = np.linalg.solve(normal, design.sum(1)[..., None])[..., 0].T
    centre = np.stack([b * e - 2 * c * d, b * d - 2 * a * e], -1) / (4 * a * c - b * b)[:, None]
    return np.asarray(centre * size[:, 0] + middle[:, 0])


def eccentricity(image_of: Callable[[Array], Array], centres: Array, radii: Array | float) -> Array:
    """Offset (n, 2) of the ellipses' centres from the images of the discs' centres.

    Parameters
    ----------
    image_of : callable
        Maps points (k, 2) of the discs' plane to pixels (k, 2): a homography, or the whole device with its distortion.
    centres : (n, 2) array
        Of the discs, in their plane.
    radii : (n,) array or float
        In the plane's unit.

    Returns
    -------
    (n, 2) ndarray
        Pixels; subtract it from measured ellipse centres.
    """
    outlines = rim(centres, radii)
    images = image_of(outlines.reshape(-1, 2)).reshape(outlines.shape)
    return ellipse_centres(images) - image_of(centres)
