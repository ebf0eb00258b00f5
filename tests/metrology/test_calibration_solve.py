"""From sightings to a rig: accuracy, the lens model that the data support, and bad input named."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from metrology.calibration.calibrate import Calibration, calibrate_sightings
from metrology.calibration.epipolar_residuals import epipolar_residuals
from metrology.calibration.observations import Sighting
from metrology.device_plausibility import check_device
from metrology.errors import CalibrationError
from tests.support.calibration_bench import SIZES, bench_rig, bench_state, see

SIGMA_PX = 0.01
CAMERA_SIZES = {name: size for name, size in SIZES.items() if name != "projector"}


def sightings(poses: int = 7, dots: bool = True) -> list[Sighting]:
    return see(bench_state(bench_rig(), poses), np.random.default_rng(1), SIGMA_PX, dots=dots)


def cameras() -> list[Sighting]:
    """The board alone, where the projector does not matter: solved in a quarter of the time."""
    return sightings(dots=False)


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    return calibrate_sightings(sightings(), SIZES)


def test_residuals_are_the_noise_that_went_in(calibration: Calibration) -> None:
    # Distances of two coordinates.
    assert calibration.rms_px["left"] == pytest.approx(np.sqrt(2) * SIGMA_PX, rel=0.1)
    assert calibration.rms_px["right"] == pytest.approx(np.sqrt(2) * SIGMA_PX, rel=0.1)
    _, across = epipolar_residuals(calibration)
    assert across.std() == pytest.approx(np.sqrt(2) * SIGMA_PX, rel=0.15)


def test_points_are_where_they_are_and_as_uncertain_as_predicted(calibration: Calibration) -> None:
    truth, found = bench_rig(), calibration.rig("r", "2026-11-01T08:00:00Z")
    field = calibration.field
    assert field is not None
    pixels = field.left_px.reshape(-1, 2)
    points = truth.left.rays(pixels)
    points *= (field.distance_mm / points[:, 2])[:, None]
    left, right = found.left.rays(pixels), found.right.rays(truth.right.project(points))
    cosine, base = np.sum(left * right, axis=1), found.right.centre
    reach = (left @ base - cosine * (right @ base)) / (1 - cosine**2)
    seen = left * reach[:, None]
    error = np.abs(seen - points)[:, 2]
    assert (error < 1.5 * field.depth_u95_mm.ravel()).all()
    assert field.depth_u95_mm.max() < 0.1
    overlay = found.projector.project(seen) - truth.projector.project(points)
    assert np.sqrt(np.mean(np.sum(overlay**2, axis=1))) < 0.05
    assert field.height_u95_mm.max() < 0.001


def test_the_third_radial_term_is_not_fitted_to_noise(calibration: Calibration) -> None:
    assert all("k3" not in terms for terms in calibration.terms.values())
    assert all(set(terms) >= {"k1"} for terms in calibration.terms.values())
    chosen = [e for e in calibration.evidence if e.chosen]
    assert len(chosen) == 3
    assert all(e.bic == 0 for e in chosen)


def test_a_pinhole_is_called_one() -> None:
    rig = bench_rig()
    ideal = replace(rig, left=replace(rig.left, distortion=np.zeros(5)))
    seen = see(bench_state(ideal), np.random.default_rng(2), SIGMA_PX, dots=False)
    assert calibrate_sightings(seen, CAMERA_SIZES).terms["left"] == ()


def test_lens_terms_that_fold_the_image_where_no_board_was_are_not_taken() -> None:
    rig = bench_rig()
    steep = replace(rig, left=replace(rig.left, distortion=np.array([-0.27, 21.0, 0.0, 0.0, -545.0])))
    seen = []
    for sighting in see(bench_state(steep), np.random.default_rng(2), SIGMA_PX, dots=False):
        middle = np.linalg.norm(sighting.pixels - np.array([800.0, 600.0]), axis=1) < 560
        seen.append(sighting.only(middle))
    found = calibrate_sightings(seen, CAMERA_SIZES)
    assert "k3" not in found.terms["left"]
    check_device(found.adjusted.state.devices["left"])


def test_a_rig_file_keeps_covariance_residuals_and_poses(calibration: Calibration) -> None:
    extra = calibration.rig("r", "2026-11-01T08:00:00Z").extra["calibration"]
    again = json.loads(json.dumps(extra, allow_nan=False))
    assert np.array(again["covariance"]).shape == (len(again["parameters"]),) * 2
    assert len(again["poses"]) == 7
    assert again["health_sigma_px"]["epipolar"] > 0


def test_projector_coordinates_from_fringes_serve_as_well() -> None:
    state = bench_state(bench_rig())
    rng = np.random.default_rng(3)
    pictures = see(state, rng, SIGMA_PX, dots=False)
    decoded = see(state, rng, 0.02, devices=("projector",))
    found = calibrate_sightings(pictures + decoded, SIZES)
    assert found.rms_px["projector"] == pytest.approx(np.sqrt(2) * 0.02, rel=0.15)
    assert found.adjusted.state.devices["projector"].K[0, 0] == pytest.approx(bench_rig().projector.K[0, 0], rel=3e-4)


def test_outliers_are_left_out_and_counted() -> None:
    seen = cameras()
    pixels = seen[0].pixels.copy()
    pixels[[3, 20, 41]] += (0.4, -0.3)
    found = calibrate_sightings([replace(seen[0], pixels=pixels), *seen[1:]], CAMERA_SIZES)
    assert found.poses[0].outliers >= 3
    assert found.poses[0].rms_px["left board"] < 2 * SIGMA_PX


def swapped(sighting: Sighting) -> Sighting:
    return replace(sighting, device="right" if sighting.device == "left" else "left")


def test_one_pose_with_left_and_right_swapped_is_refused_by_name() -> None:
    found = calibrate_sightings([swapped(s) if s.pose == 3 else s for s in cameras()], CAMERA_SIZES)
    assert found.poses[3].used == ()
    assert any("swapped" in reason for reason in found.poses[3].reasons)
    assert any(text.startswith("pose 3 refused") for text in found.warnings)


def test_cameras_swapped_throughout_are_an_error() -> None:
    with pytest.raises(CalibrationError, match="swapped throughout"):
        calibrate_sightings([swapped(s) for s in cameras()], CAMERA_SIZES)


def test_right_frames_of_two_poses_exchanged_are_refused() -> None:
    other = {1: 4, 4: 1}
    mixed = [replace(s, pose=other.get(s.pose, s.pose)) if s.device == "right" else s for s in cameras()]
    found = calibrate_sightings(mixed, CAMERA_SIZES)
    assert found.poses[1].used == found.poses[4].used == ()
    assert "frames of another pose" in found.poses[1].reasons[0]


def test_right_frames_in_reverse_order_are_an_error() -> None:
    mixed = [replace(s, pose=6 - s.pose) if s.device == "right" else s for s in cameras()]
    with pytest.raises(CalibrationError, match="mixed up"):
        calibrate_sightings(mixed, CAMERA_SIZES)


def test_a_board_that_moved_before_its_dots_were_taken_is_refused_in_part() -> None:
    moved = [
        replace(s, pixels=s.pixels + np.array([0.6, 0.2])) if (s.pose, s.kind) == (2, "dots") else s
        for s in sightings()
    ]
    found = calibrate_sightings(moved, SIZES)
    assert "left dots" not in found.poses[2].used
    assert "moved between the pictures" in found.poses[2].reasons[0]


def test_too_few_poses_are_an_error_and_few_a_warning() -> None:
    with pytest.raises(CalibrationError, match=r"found 2 usable poses .* expected at least 3"):
        calibrate_sightings(sightings(2), SIZES)
    few = calibrate_sightings(sightings(4), SIZES)
    assert any("few poses" in warning for warning in few.warnings)


def test_dots_missing_in_most_poses_are_an_error_and_in_half_a_warning() -> None:
    seen = sightings()
    with pytest.raises(CalibrationError, match="projector: found 2 usable poses"):
        calibrate_sightings([s for s in seen if s.kind == "board" or s.pose < 2], SIZES)
    half = calibrate_sightings([s for s in seen if s.kind == "board" or s.pose < 4], SIZES)
    assert any("usable in 4 of 7 poses" in warning for warning in half.warnings)


def test_a_real_capture_with_few_poses_says_how_uncertain_it_is(shared: Path) -> None:
    with np.load(shared / "real" / "procam-graycode" / "helper_decoded_correspondences.npz") as data:
        points = data["obj_mm"].reshape(-1, 3)[:, :2].astype(float)
        seen = {"left": data["cam"].astype(float), "projector": data["proj"].astype(float)}
    index, radius = np.arange(len(points)), np.zeros(len(points))
    sightings = [
        Sighting("board", name, pose, index, points, radius, pixels[pose].reshape(-1, 2), 0.1)
        for name, pixels in seen.items()
        for pose in range(5)
    ]
    found = calibrate_sightings(sightings, {"left": (1280, 1024), "projector": (1024, 768)})
    squared = np.concatenate([np.sum(r**2, axis=1) for r in found.adjusted.residuals])
    assert np.sqrt(squared.mean()) < 0.35
    assert sum(use.outliers for use in found.poses) < 0.1 * len(squared)
    assert any("projector: the poses leave the focal length uncertain" in warning for warning in found.warnings)
