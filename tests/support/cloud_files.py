"""A riveted skin's cloud as other scanners export it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import Reconstruction
from tests.support.rivet_scan import Head, Skin, scan

HEADS = (
    Head(-40, -25, height=0.06), Head(0, -25, height=-0.05), Head(40, -25, height=0.12),
    Head(-40, 25, height=0.0), Head(0, 25, height=0.03), Head(40, 25, height=-0.08, tilt_deg=0.4),
)  # fmt: skip


def riveted(correlated_px: float = 0.0, seed: int = 3) -> Reconstruction:
    """A scan of six heads on a curved skin."""
    skin = Skin(radius_x=1800.0, sigma_z=0.012, correlated_px=correlated_px)
    return scan(skin, HEADS, np.random.default_rng(seed))


def levels(found: Reconstruction) -> NDArray[np.uint8]:
    """Its picture."""
    return np.clip(np.rint(found.left.texture), 0, 255).astype(np.uint8)


def write_ply(
    path: Path, points: NDArray, grey: NDArray[np.uint8] | None = None, comments: tuple[str, ...] = ()
) -> Path:
    """Points as they come, as colours where grey is given; comments such as a grid's size."""
    import plyfile

    names = [("x", "f4"), ("y", "f4"), ("z", "f4")] + [(name, "u1") for name in ("red", "green", "blue")] * (
        grey is not None
    )
    rows = np.empty(points.shape[:-1], dtype=names).ravel()
    for k, axis in enumerate("xyz"):
        rows[axis] = points[..., k].ravel()
    for name in ("red", "green", "blue") if grey is not None else ():
        rows[name] = np.ravel(grey)
    element = plyfile.PlyElement.describe(rows, "vertex")
    plyfile.PlyData([element], comments=list(comments)).write(str(path))
    return path
