"""Whether a rig fits a scan: every way one device can move or zoom shows, noise and calibration errors do not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metrology.blocks import in_blocks
from metrology.cloud import DecodedView, Reconstruction
from metrology.contrast_match import CONTRAST_LIMIT, contrast_apart
from metrology.errors import RigError
from metrology.far_offset import measure_far_offsets
from metrology.reconstruct import coordinate_size, decode, triangulate
from metrology.results import RivetDetection
from metrology.rig import Device, Rig
from metrology.rig_health import HealthSettings, RigHealth, epipolar_health
from metrology.third_view import bent_places
from storage.rig import load_rig
from storage.scene import load_scene
from tasks.rig_check import check_scene
from tests.support.grained_plane import (
    both_views,
    half_size_rig,
    turned,
)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return half_size_rig()


@pytest.fixture(scope="module")
def views() -> tuple[DecodedView, DecodedView]:
    return both_views()


def health(rig: Rig, views: tuple[DecodedView, DecodedView]) -> RigHealth:
    return epipolar_health(triangulate(*views, rig), settings=HealthSettings(patch_spacing_px=48, block_px=48))


def zoomed(device: Device, factor: float) -> Device:
    return replace(device, K=device.K * np.array([[factor, 1, 1], [1, factor, 1], [1, 1, 1]]))


def test_the_true_rig_is_well(rig: Rig, views: tuple[DecodedView, DecodedView]) -> None:
    found = health(rig, views)
    assert found.verdict == "ok"
    assert found.reason is None
    assert found.epipolar_rms_px is not None
    assert found.epipolar_rms_px < 0.1
    assert found.projector_rms_px is not None
    assert found.projector_rms_px < 0.01
    assert found.n > 60


def test_where_patches_far_apart_are_too_few_they_lie_side_by_side(
    rig: Rig, views: tuple[DecodedView, DecodedView]
) -> None:
    apart = HealthSettings(patch_spacing_px=300, block_px=48)
    cameras = replace(rig, projector=None)
    found = epipolar_health(triangulate(*views, cameras), settings=apart)
    assert found.verdict == "ok"
    assert found.n > 300
    moved = replace(cameras, right=turned(rig.with_right(), 2, 0.1))
    assert epipolar_health(triangulate(*views, moved), settings=apart).verdict in ("warning", "refused")


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("name", ["right", "projector"])
def test_a_device_turned_by_a_twentieth_of_a_degree_shows(
    rig: Rig, views: tuple[DecodedView, DecodedView], name: str, axis: int
) -> None:
    moved = replace(rig, **{name: turned(getattr(rig, name), axis, 0.05)})
    assert health(moved, views).verdict != "ok"


@pytest.mark.parametrize("names", [("left",), ("right",), ("left", "right"), ("projector",)])
def test_a_focal_length_off_by_three_in_a_thousand_shows(
    rig: Rig, views: tuple[DecodedView, DecodedView], names: tuple[str, ...]
) -> None:
    moved = replace(rig, **{name: zoomed(getattr(rig, name), 1.003) for name in names})
    found = health(moved, views)
    assert found.verdict != "ok"
    assert found.reason is not None
    assert "calibrate the rig again" in found.reason


def test_each_observable_sees_what_the_other_is_blind_to(rig: Rig, views: tuple[DecodedView, DecodedView]) -> None:
    pitch = health(replace(rig, right=turned(rig.right, 0, 0.05)), views)
    yaw = health(replace(rig, right=turned(rig.right, 1, 0.05)), views)
    assert pitch.epipolar_drift_px is not None
    assert pitch.projector_rms_px is not None
    # A pitch shifts the right image by its angle times the focal length.
    assert pitch.epipolar_drift_px == pytest.approx(np.radians(0.05) * rig.right.K[1, 1], rel=0.05)
    assert pitch.projector_rms_px < 0.1
    assert yaw.projector_rms_px is not None
    assert yaw.projector_rms_px > 0.5
    assert pitch.verdict == yaw.verdict == "refused"


def test_more_drift_is_worse(rig: Rig, views: tuple[DecodedView, DecodedView]) -> None:
    drifts = [health(replace(rig, right=turned(rig.right, 2, d)), views).epipolar_drift_px for d in (0.0, 0.03, 0.3)]
    assert drifts == sorted(drifts, key=lambda d: d or 0.0)
    assert health(replace(rig, right=turned(rig.right, 2, 0.3)), views).verdict == "refused"


def test_what_the_calibration_leaves_uncertain_is_allowed_for(rig: Rig, views: tuple[DecodedView, DecodedView]) -> None:
    moved = replace(rig, right=turned(rig.right, 2, 0.02))
    assert health(moved, views).verdict == "warning"
    vague = replace(moved, extra={"calibration": {"health_sigma_px": {"epipolar": 0.1, "projector": 0.1}}})
    assert health(vague, views).verdict == "ok"


def knocked(rig: Rig, kind: str, degrees: float) -> Rig:
    """A rig of which a part was turned by degrees, moved or zoomed by as much as that shifts the image."""
    name, how = kind.split()
    device, share = getattr(rig, name), float(np.tan(np.radians(degrees)))
    if how == "moved":
        return replace(rig, **{name: replace(device, t=device.t + np.array([0.0, 700 * share, 0.0]))})
    if how == "nearer":
        return replace(rig, **{name: replace(device, t=device.t * (1 - share))})
    if how == "zoomed":
        return replace(rig, **{name: zoomed(device, 1 + share)})
    return replace(rig, **{name: turned(device, ["pitched", "yawed", "rolled"].index(how), degrees)})


ORDER = ("ok", "warning", "unjudged", "refused")
CAMERAS = ("right pitched", "right yawed", "right rolled", "right moved", "right nearer", "right zoomed")
PROJECTOR = ("projector pitched", "projector yawed", "projector rolled", "projector nearer")


@pytest.mark.parametrize("kind", CAMERAS + PROJECTOR)
def test_worse_is_never_judged_milder(rig: Rig, views: tuple[DecodedView, DecodedView], kind: str) -> None:
    verdicts = [health(knocked(rig, kind, degrees), views).verdict for degrees in (0.05, 0.3, 4.0)]
    assert verdicts == sorted(verdicts, key=ORDER.index)
    assert verdicts[-1] == "refused"
    assert "unjudged" not in verdicts


@pytest.mark.parametrize("degrees", [0.3, 4.0])
def test_a_pitch_beyond_the_fine_search_is_measured(
    rig: Rig, views: tuple[DecodedView, DecodedView], degrees: float
) -> None:
    found = health(replace(rig, right=turned(rig.right, 0, degrees)), views)
    assert found.verdict == "refused"
    assert found.epipolar_drift_px == pytest.approx(np.radians(degrees) * rig.right.K[1, 1], rel=0.03, abs=0.2)


@pytest.mark.parametrize(("off_px", "noise_px", "verdict"), [(4.1, 40.0, "refused"), (0.0, 1.5, "unjudged")])
def test_the_scans_own_scatter_excuses_nothing(
    rig: Rig, views: tuple[DecodedView, DecodedView], off_px: float, noise_px: float, verdict: str
) -> None:
    whole = triangulate(*views, rig)
    noise = np.random.default_rng(5).normal(off_px, noise_px, whole.flags.shape).astype(np.float32)
    scattered = replace(whole, left=replace(whole.left, coordinate=whole.left.coordinate + noise))
    found = epipolar_health(scattered, settings=HealthSettings(patch_spacing_px=48, block_px=48))
    assert found.verdict == verdict


def test_a_poor_calibration_excuses_no_more_than_the_limit(rig: Rig, views: tuple[DecodedView, DecodedView]) -> None:
    moved = replace(rig, right=turned(rig.right, 2, 0.3))
    vague = replace(moved, extra={"calibration": {"health_sigma_px": {"epipolar": 9.0, "projector": 9.0}}})
    assert health(vague, views).verdict == "refused"


def test_a_skin_without_texture_leaves_the_third_view(rig: Rig, views: tuple[DecodedView, DecodedView]) -> None:
    rng = np.random.default_rng(2)
    plain = [replace(v, texture=(100 + rng.normal(0, 0.6, v.texture.shape)).astype(np.float32)) for v in views]
    found = health(rig, (plain[0], plain[1]))
    assert found.epipolar_rms_px is None
    assert found.projector_rms_px is not None
    assert found.verdict == "unjudged"
    assert found.reason is not None
    assert "too little texture" in found.reason
    assert health(replace(rig, projector=turned(rig.projector, 1, 0.05)), (plain[0], plain[1])).verdict == "refused"


def test_nothing_to_see_is_said(rig: Rig, views: tuple[DecodedView, DecodedView]) -> None:
    whole = triangulate(*views, rig)
    empty: Reconstruction = replace(whole, points=np.full_like(whole.points, np.nan))
    found = epipolar_health(empty)
    assert found.verdict == "unjudged"
    assert found.reason is not None
    assert "too few points" in found.reason


def test_rivets_join_the_patches(rig: Rig, views: tuple[DecodedView, DecodedView]) -> None:
    reconstruction = triangulate(*views, rig)
    rivet = RivetDetection(400.0, 300.0, 40.0, 38.0, 10.0, 0.9)
    sparse = HealthSettings(patch_spacing_px=48)
    assert (
        epipolar_health(reconstruction, [rivet], settings=sparse).n
        >= epipolar_health(reconstruction, settings=sparse).n
    )


def test_settings_that_make_no_sense_are_refused() -> None:
    with pytest.raises(RigError, match="floor below refusal"):
        HealthSettings(refuse_px=0.01)
    with pytest.raises(RigError, match="blocks"):
        HealthSettings(block_px=2)


@pytest.mark.slow
def test_on_an_independent_rendering_of_a_skin(shared: Path) -> None:
    rig = load_rig(shared / "scenes" / "rig.json")
    scene = load_scene(shared / "scenes" / "skin")
    assert check_scene(rig, scene.folder)[0].verdict == "ok"
    size = coordinate_size(rig, scene.code)
    left, right = (decode(scene.frames(side), scene.code, size, scene.exposures) for side in ("left", "right"))
    turned_rig, zoomed_rig = replace(rig, right=turned(rig.right, 1, 0.05)), replace(rig, left=zoomed(rig.left, 1.003))
    assert epipolar_health(triangulate(left, right, turned_rig)).verdict == "refused"
    assert epipolar_health(triangulate(left, right, zoomed_rig)).verdict != "ok"


def test_medians_of_blocks_are_those_of_each_block() -> None:
    rng = np.random.default_rng(8)
    v, u = rng.integers(0, 40, (2, 500))
    values = rng.normal(size=500)
    blocks = in_blocks(v, u, 40, 16)
    expected = [
        np.median(values[(v // 16 == row) & (u // 16 == column)])
        for row, column in zip(blocks.row, blocks.column, strict=True)
    ]
    assert len(expected) == 9
    np.testing.assert_allclose(blocks.medians(values), expected, rtol=1e-12)


def test_texture_far_off_is_placed_to_parts_of_a_pixel(rig: Rig, views: tuple[DecodedView, DecodedView]) -> None:
    """In whole rows of the layout each block would be off by up to one pixel, and some of them all alike."""
    found = measure_far_offsets(triangulate(*views, rig)).across_px
    assert len(found) > 12
    assert np.median(np.abs(found)) < 0.25


@pytest.mark.parametrize("camera", [0, 1])
def test_a_place_where_one_camera_sees_light_bent_is_found(
    rig: Rig, views: tuple[DecodedView, DecodedView], camera: int
) -> None:
    """A drop on a lens: the coordinate of its middle is that of a third of a pixel beside it."""
    assert bent_places(triangulate(*views, rig), "x") == ()
    v, u = np.mgrid[: rig.left.height, : rig.left.width]
    drop = np.exp(-((u - 400) ** 2 + (v - 300) ** 2) / (2 * 50**2))
    seen = list(views)
    wet = seen[camera].coordinate + (0.3 * drop).astype(np.float32)
    seen[camera] = replace(seen[camera], coordinate=wet)
    cloud = triangulate(seen[0], seen[1], rig)
    (found,) = bent_places(cloud, "x")
    middle = 400 if camera == 0 else _left_column(cloud, seen[1].coordinate[300, 400])
    assert found.place.u_px[0] < middle < found.place.u_px[1]
    assert found.place.v_px[0] < 300 < found.place.v_px[1]
    assert found.off_px > 2 * found.limit_px
    assert np.diff([*found.place.u_px])[0] < 400
    assert bent_places(replace(cloud, right=None), "x") == ()
    assert bent_places(replace(cloud, rig=replace(rig, projector=None)), "x") == ()


def _left_column(cloud: Reconstruction, coordinate: float) -> float:
    """Where the left camera sees what the right one sees at that coordinate, near row 300."""
    return float(np.argmin(np.abs(cloud.left.coordinate[300] - coordinate)))


def test_a_veil_over_a_part_of_one_cameras_picture_is_found(rig: Rig, views: tuple[DecodedView, DecodedView]) -> None:
    left, right = views
    assert contrast_apart(triangulate(left, right, rig)) is None
    u = np.arange(rig.left.width)
    focus, veil = 1 + 0.2 * (u / rig.left.width - 0.5) ** 2, 1 - 0.3 / (1 + np.exp((u - 200) / 15))
    smooth = replace(right, modulation=(right.modulation * focus).astype(np.float32))
    assert contrast_apart(triangulate(left, smooth, rig)) is None
    veiled = replace(left, modulation=(left.modulation * veil).astype(np.float32))
    found = contrast_apart(triangulate(veiled, smooth, rig))
    assert found is not None
    assert CONTRAST_LIMIT < found < 0.3
