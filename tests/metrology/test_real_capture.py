"""A capture with a real camera and projector: a white box corner, three counts of eight clipped steps, both axes."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from metrology.cloud import DecodedView, PixelFlag
from metrology.fringe import Axis, FringeCode
from metrology.reconstruct import decode

COUNTS = (37, 36, 35)
# The box, and its two faces left and right of the corner, in camera pixels.
BOX = np.s_[710:885, 515:880]


def capture(shared: Path, axis: Axis) -> tuple[DecodedView, int]:
    """Decoded view and the projector's size along the axis."""
    name, size = ("horizontal", 854) if axis == "x" else ("vertical", 480)
    folder = shared / "real" / "box-3freq-8step" / name
    paths = [folder / f"{name}_f{count}_{step:04d}.png" for count in COUNTS for step in range(1, 9)]
    frames = np.stack([cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in paths])
    return decode(frames[None], FringeCode(axis, 8, COUNTS), size), size


def clear(view: DecodedView) -> NDArray[np.float64]:
    return np.where((view.flags & PixelFlag.EDGE) == 0, view.coordinate, np.nan)[BOX].astype(float)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_orders_agree_between_neighbours(shared: Path, axis: Axis) -> None:
    view, size = capture(shared, axis)
    coordinate = clear(view)
    assert np.isfinite(coordinate).mean() > 0.6
    for along in (0, 1):
        steps = np.diff(coordinate, axis=along)
        steps = steps[np.isfinite(steps)]
        assert steps.size > 35000
        assert (np.abs(steps) > size / 37 / 2).sum() == 0


def test_box_faces_are_planes_in_projector_coordinates(shared: Path) -> None:
    x, y = (clear(capture(shared, axis)[0]) for axis in ("x", "y"))
    v, u = np.mgrid[BOX].astype(float)
    # The corner is where x turns: where two lines fit its median over the rows.
    corner = corner_column(x)
    for face in (u < corner - 15, u > corner + 15):
        good = face & np.isfinite(x) & np.isfinite(y)
        assert good.sum() > 5000
        camera = np.column_stack([u[good], v[good]])
        projector = np.column_stack([x[good], y[good]])
        homography, inlier = cv2.findHomography(camera, projector, cv2.RANSAC, 1.0)
        mapped = cv2.perspectiveTransform(camera[:, None], homography)[:, 0]
        rest = (mapped - projector)[inlier.ravel() > 0]
        assert inlier.mean() > 0.9
        # The projector's clipped fringes leave harmonics of some tenths of a pixel in x.
        assert np.sqrt((rest[:, 0] ** 2).mean()) < 0.35
        assert np.sqrt((rest[:, 1] ** 2).mean()) < 0.1


def corner_column(x: NDArray[np.float64]) -> float:
    """Camera column at which two lines fit the rows' mean x best."""
    known = np.isfinite(x).sum(0) > 20
    profile = np.nanmedian(x[:, known], axis=0)
    columns = np.flatnonzero(known) + float(BOX[1].start)

    def misfit(split: int) -> float:
        parts = (np.s_[:split], np.s_[split:])
        return sum(float(np.polyfit(columns[p], profile[p], 1, full=True)[1].sum()) for p in parts)

    return float(columns[min(range(20, columns.size - 20), key=misfit)])
