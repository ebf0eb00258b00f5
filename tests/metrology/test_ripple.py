"""Two cameras whose frames are uneven: what both see alike cancels, what one sees alone is taken out."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from metrology.cloud import DecodedView
from metrology.fringe import FringeCode
from metrology.reconstruct import decode, triangulate
from metrology.ripple import with_equal_ripples
from tests.support.rendered_fringes import PLANE_DISTANCE, PLANE_NORMAL, plane_scan, small_rig

CODE, SIZE = FringeCode("x", 4, (20, 18, 17)), 320
FLICKER = (1 + 0.02 * np.random.default_rng(9).standard_normal(CODE.frames))[None, :, None, None]


def views(left: NDArray | float, right: NDArray | float) -> tuple[DecodedView, DecodedView]:
    """Both cameras' views of a plane, their frames as bright as said."""
    scan = plane_scan(small_rig(), CODE, np.random.default_rng(4), 0.5)
    one, other = (
        decode(np.rint(frames * bright).clip(0, 255).astype(np.uint8), CODE, SIZE)
        for frames, bright in zip(scan, (left, right), strict=True)
    )
    return one, other


def scatter(left: DecodedView, right: DecodedView) -> float:
    """Of the cloud about the plane, mm."""
    found = triangulate(left, right, small_rig())
    points = found.points[found.flags == 0].astype(float)
    return float(np.std(points @ PLANE_NORMAL - PLANE_DISTANCE))


@pytest.mark.parametrize("uneven", ["left", "right"])
def test_a_ripple_of_one_camera_is_taken_out(uneven: str) -> None:
    sound = scatter(*views(1.0, 1.0))
    odd = views(FLICKER if uneven == "left" else 1.0, FLICKER if uneven == "right" else 1.0)
    left, right, difference = with_equal_ripples(*odd, CODE, SIZE)
    assert difference > 1
    assert scatter(*odd) > 2 * sound
    assert scatter(left, right) < 1.15 * sound


@pytest.mark.parametrize("bright", [1.0, FLICKER], ids=["steady", "flicker"])
def test_what_both_cameras_see_alike_is_left_as_it_is(bright: NDArray | float) -> None:
    both = views(bright, bright)
    left, right, difference = with_equal_ripples(*both, CODE, SIZE)
    assert difference < 0.25
    assert left is both[0]
    assert right is both[1]
