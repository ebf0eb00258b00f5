"""Rigs that cannot be built, or come in another convention, are refused with what they most likely are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from metrology.errors import RigError
from metrology.rig import Device, Rig
from metrology.rig_plausibility import check_rig
from simulator.rig import RigDesign, virtual_rig
from tests.support.calibration_bench import bench_rig
from tests.support.turned_rig import turned

RIG = bench_rig()


def with_device(name: str, device: Device) -> Rig:
    changed: dict[str, Any] = {name: device}
    return replace(RIG, **changed)


def with_K(device: Device, **entries: float) -> Device:
    """Entries named by row and column, such as _01."""
    K = device.K.copy()
    for name, value in entries.items():
        K[int(name[1]), int(name[2])] = value
    return replace(device, K=K)


def lens(device: Device, *terms: float) -> Device:
    return replace(device, distortion=np.array(terms))


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize(
    ("stand_off", "baseline", "focal", "width"),
    [
        (700, 300, 3640, 1624),
        (100, 40, 3000, 1600),
        (5000, 1500, 9000, 4096),
        (300, 100, 1800, 1280),
        (120, 100, 3000, 1600),
        (2000, 300, 2000, 1600),
        (1500, 2000, 2500, 1600),
        (700, 300, 910, 406),
        (5000, 200, 5000, 1600),
    ],
)
def test_rigs_that_can_be_built_are_accepted(
    seed: int, stand_off: float, baseline: float, focal: float, width: int
) -> None:
    design = RigDesign(
        width, round(0.75 * width), camera_focal_px=focal, baseline_mm=baseline, stand_off_mm=stand_off,
        projector_rise_mm=0.3 * baseline, spread=min(1.0, stand_off / 700),
    )  # fmt: skip
    check_rig(virtual_rig(np.random.default_rng(seed), design))


def test_cameras_may_look_alike_or_be_rolled_or_stand_the_other_way_round() -> None:
    """Parallel axes meet nowhere; a rolled camera has its image's sides elsewhere; names of cameras are only names."""
    check_rig(replace(RIG, right=replace(RIG.right, R=RIG.right.R.T, t=RIG.right.centre)))
    check_rig(replace(RIG, right=replace(RIG.right, R=np.eye(3), t=np.array([-80.0, 0.0, 0.0]))))
    for roll in (90.0, 180.0, 270.0):
        check_rig(turned(RIG, "right", roll, (0, 0, 1)))


def test_rectified_images_of_converging_cameras_have_principal_points_outside() -> None:
    left, right, size = RIG.left, turned(RIG, "right", 14.0, (0, 1, 0)).right, (RIG.left.width, RIG.left.height)
    lenses = (left.K, left.lens, right.K, right.lens)
    *_, P1, P2, _, _, _ = cv2.stereoRectify(*lenses, size, right.R, right.t.reshape(3, 1), flags=0)
    plain = np.zeros(5)
    beside = replace(right, K=P2[:, :3], distortion=plain, R=np.eye(3), t=np.linalg.solve(P2[:, :3], P2[:, 3]))
    rectified = replace(RIG, left=replace(left, K=P1[:, :3], distortion=plain), right=beside, projector=None)
    assert not rectified.right.inside(rectified.right.K[:2, 2])
    check_rig(rectified)
    with pytest.raises(RigError, match="expected it inside"):
        check_rig(replace(rectified, right=replace(beside, distortion=right.distortion)))


@pytest.mark.parametrize("device", ["left", "right", "projector"])
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: replace(d, K=d.K.T), "K is transposed"),
        (lambda d: with_K(d, _01=3.2), "found a skew of 3.2 px, expected 0"),
        (lambda d: with_K(d, _22=2.0), "found 2 in the last place, expected 1"),
        (lambda d: with_K(d, _02=5000.0), "expected it inside|of a side outside"),
        (lambda d: with_K(d, _12=-900.0), "expected it inside|of a side outside"),
        (lambda d: with_K(d, _00=12.0, _11=12.0), "field of view of 1[67].*they are in millimetres"),
        (lambda d: with_K(d, _00=3.5e6, _11=3.5e6), "field of view of 0.0"),
        (lambda d: with_K(d, _00=d.K[0, 0] / 10), "expected nearly equal ones"),
        (lambda d: replace(d, width=d.height, height=d.width), "width and height are exchanged"),
        (lambda d: replace(d, width=2 * d.width, height=2 * d.height), "K is that of images 0.5 times the size"),
        (lambda d: replace(d, width=d.width // 2, height=d.height // 2), "K is that of images 2 times the size"),
        (lambda d: lens(d, -0.02, 0.05, -0.04, 0.03), "k1 to k4 of a fisheye"),
        (lambda d: lens(d, -90.0, 120.0, 0.0, 0.0, 0.0), "folds the image over at"),
        (lambda d: lens(d, 1e6, 0.0, 0.0, 0.0, 0.0), "times its distance from the middle"),
        (lambda d: lens(d, -0.1, 0.1, 0.2, 0.0, 0.0), "in another order"),
        (lambda d: lens(d, -0.1, 0.1, 0.0, 0.0, 0.0, 20.0, 0.0, 0.0), "folds the image over at"),
    ],
)
def test_an_absurd_device_is_refused(device: str, change: Callable[[Device], Device], said: str) -> None:
    wrong = with_device(device, change(getattr(RIG, device)))
    with pytest.raises(RigError, match=f"^{device}: .*({said})") as caught:
        check_rig(wrong)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("device", ["right", "projector"])
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: replace(d, t=d.t / 1000), "t is in metres"),
        (lambda d: replace(d, t=d.t * 1000), "unit was given as metres"),
    ],
)
def test_another_unit_is_named(device: str, change: Callable[[Device], Device], said: str) -> None:
    with pytest.raises(RigError, match=f"^{device}: found its centre .* expected 10 to 10000 mm.*{said}"):
        check_rig(with_device(device, change(getattr(RIG, device))))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: replace(d, t=d.t / 10), "fields of view that meet .* t is in centimetres"),
        (lambda d: replace(d, R=d.R.T), "look apart.*R is transposed"),
        (lambda d: replace(d, t=-d.t), "look apart"),
        (lambda d: replace(d, t=d.centre), "look apart.*in the left camera's frame"),
        (lambda d: replace(d, t=d.t + np.array([0, 2000.0, 0])), "look apart"),
    ],
)
def test_a_misplaced_right_camera_is_refused(change: Callable[[Device], Device], said: str) -> None:
    with pytest.raises(RigError, match=f"^right: .*{said}"):
        check_rig(replace(RIG, right=change(RIG.right)))


def test_a_projector_that_lights_another_place_is_refused() -> None:
    with pytest.raises(
        RigError, match=r"^projector: found it lighting \d+% of what both cameras see.*expected at least"
    ):
        check_rig(turned(RIG, "projector", 25.0, (1, 0, 0)))


def test_a_shifted_projector_lens_is_a_real_one() -> None:
    check_rig(replace(RIG, projector=with_K(RIG.projector, _12=1.1 * RIG.projector.height)))


def test_a_mirror_is_no_rotation() -> None:
    with pytest.raises(RigError, match="a mirror: an axis has the other sign"):
        replace(RIG.right, R=RIG.right.R @ np.diag([1.0, 1.0, -1.0]))


@pytest.mark.parametrize("device", ["left", "right", "projector"])
def test_what_swaps_scales_and_negates_is_refused_or_can_be_built(device: str) -> None:
    """No mutation ends otherwise than in one line, or in a rig whose devices still see one place."""
    rng = np.random.default_rng(7)
    refusals = [text for text in (complaint(device, rng) for _ in range(150)) if text]
    assert len(refusals) > 60
    assert not [text for text in refusals if "\n" in text]


def complaint(device: str, rng: np.random.Generator) -> str:
    try:
        check_rig(mutated(device, rng))
    except RigError as problem:
        return str(problem)
    return ""


def mutated(device: str, rng: np.random.Generator) -> Rig:
    """The rig with one of a device's values transposed, scaled, or with entries swapped or negated."""
    old: Device = getattr(RIG, device)
    name = str(rng.choice(["K", "R", "t", "distortion"]))
    value = np.array(getattr(old, name))
    flat, (a, b) = value.reshape(-1), rng.choice(value.size, 2, replace=False)
    match rng.integers(5):
        case 0:
            flat[[a, b]] = flat[[b, a]]
        case 1:
            value = value.T
        case 2:
            value = value * rng.choice([1e-3, 1e3, 1e100, -1.0])
        case 3:
            flat[a] *= rng.choice([1e-3, 1e3, 1e300, -1.0])
        case 4:
            flat[a] = np.nan
    changed: dict[str, Any] = {name: value}
    return with_device(device, replace(old, **changed))
