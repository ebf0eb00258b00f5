"""Frames that were mixed up are told from a rig that does not fit, and the mix-up is named."""

from __future__ import annotations

from dataclasses import fields, replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from metrology.cloud import DecodedView
from metrology.mix_ups import find_mix_up
from metrology.reconstruct import triangulate
from metrology.rig import Rig
from tests.support.grained_plane import both_views, half_size_rig, seen_by, turned

Views = tuple[DecodedView, DecodedView]


@pytest.fixture(scope="module")
def rig() -> Rig:
    return half_size_rig()


@pytest.fixture(scope="module")
def views() -> Views:
    return both_views()


def turn(view: DecodedView, rows: int, columns: int) -> DecodedView:
    images = {f.name: getattr(view, f.name) for f in fields(view) if isinstance(getattr(view, f.name), np.ndarray)}
    return replace(view, **{name: np.ascontiguousarray(image[::rows, ::columns]) for name, image in images.items()})


def reversed_steps(view: DecodedView, size: int) -> DecodedView:
    return replace(view, coordinate=np.float32(size - 1) - view.coordinate)


def said(views: Views, rig: Rig) -> str:
    found = find_mix_up(triangulate(*views, rig), "x", half_size_rig().projector.width)
    return "" if found is None else found.when


def test_exchanged_cameras(rig: Rig, views: Views) -> None:
    assert said((views[1], views[0]), rig) == "left and right are exchanged"


@pytest.mark.parametrize(
    ("rows", "columns", "words"), [(-1, -1, "turned by 180°"), (1, -1, "left to right"), (-1, 1, "top to bottom")]
)
def test_turned_and_mirrored_frames(rig: Rig, views: Views, rows: int, columns: int, words: str) -> None:
    both = (turn(views[0], rows, columns), turn(views[1], rows, columns))
    all_frames = said(both, rig)
    assert all_frames.startswith("all frames are")
    assert words in all_frames
    right = said((views[0], both[1]), rig)
    assert right.startswith("the right camera's frames are")
    assert words in right


def test_reversed_steps(rig: Rig, views: Views) -> None:
    size = rig.projector.width
    both = (reversed_steps(views[0], size), reversed_steps(views[1], size))
    assert said(both, rig) == "the phase steps are taken in reverse order"
    assert said((both[0], views[1]), rig) == "the left camera's phase steps are taken in reverse order"
    assert (
        said((both[1], both[0]), rig) == "left and right are exchanged and the phase steps are taken in reverse order"
    )


def test_undistorted_frames(rig: Rig, views: Views) -> None:
    # Frames of cameras without distortion, inspected with a rig that has it: what undistorted frames come to.
    stronger = replace(rig.right, distortion=rig.right.distortion + np.array([-0.2, 0.1, 0, 0, 0]))
    bent = replace(rig, right=stronger)
    plain = replace(rig, right=replace(rig.right, distortion=np.zeros(5)))
    [right] = seen_by(plain, "right")
    assert "the right camera's lens distortion is left out" in said((views[0], right), bent)


@pytest.mark.parametrize("projector", [True, False])
def test_rectified_frames(rig: Rig, projector: bool) -> None:
    left, right = rig.left, rig.right
    size = (left.width, left.height)
    turn_left, turn_right, P1, P2, *_ = cv2.stereoRectify(
        left.K, left.lens, right.K, right.lens, size, right.R, right.t.reshape(3, 1), flags=0
    )
    rectified = SimpleNamespace(
        projector=rig.projector,
        left=replace(left, K=P1[:, :3], distortion=np.zeros(5), R=turn_left, t=np.zeros(3)),
        right=replace(right, K=P2[:, :3], distortion=np.zeros(5), R=turn_right @ right.R, t=turn_right @ right.t),
    )
    seen = (seen_by(rectified, "left")[0], seen_by(rectified, "right")[0])  # type: ignore[arg-type]
    assert "the frames are rectified" in said(seen, rig if projector else replace(rig, projector=None))


def test_a_right_camera_s_pose_in_another_convention(rig: Rig, views: Views) -> None:
    device = rig.right
    for other, words in (
        (replace(device, R=device.R.T, t=-device.R.T @ device.t), "R and t are the inverse"),
        (replace(device, t=-device.t), "t has the other sign"),
        (replace(device, R=device.R.T), "R is transposed"),
    ):
        wrong = replace(rig, right=other, projector=None)
        found = find_mix_up(triangulate(*views, wrong), "x", rig.projector.width)
        assert found is not None
        assert words in found.when


def test_lenses_of_the_cameras_exchanged(rig: Rig, views: Views) -> None:
    K = rig.right.K + np.array([[9.0, 0, 6], [0, 9, -7], [0, 0, 0]])
    unlike = replace(rig, right=replace(rig.right, K=K))
    [right] = seen_by(unlike, "right")
    wrong = replace(unlike, left=replace(unlike.left, K=K), right=replace(unlike.right, K=rig.left.K), projector=None)
    found = find_mix_up(triangulate(views[0], right, wrong), "x", rig.projector.width)
    assert found is not None
    assert found.when == "K and distortion of its cameras are exchanged"


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_knocked_rig_is_no_mix_up(rig: Rig, views: Views, axis: int) -> None:
    assert said(views, replace(rig, right=turned(rig.right, axis, 0.5))) == ""


def test_another_rigs_projector_is_no_mix_up(rig: Rig, views: Views) -> None:
    moved = replace(rig.projector, t=rig.projector.t + np.array([25.0, 3.0, 0.0]))
    assert said(views, replace(rig, projector=moved)) == ""
