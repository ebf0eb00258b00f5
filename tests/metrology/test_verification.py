"""Measures of artefacts: each within its own U95 as often as it says, wrong rigs seen, spheres told apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from metrology.calibration.board import Board
from metrology.calibration.detect_board import BoardView
from metrology.calibration.eccentricity import eccentricity
from metrology.errors import CalibrationError, UsageError
from metrology.rig import Rig
from metrology.verification.board_lengths import board_lengths
from metrology.verification.deviations import Deviation, common_bias, growth
from metrology.verification.form import form, inflation
from metrology.verification.spheres import distance_u95, find_spheres, fit_sphere, identify
from simulator.rig import RigDesign, virtual_rig

ARTEFACTS = 200
SIGMA_Z = 0.01
# Of 200 that lie within with a probability of 0.95, 93 to 97 % (186 to 194) are what the draw of a sound measure gives
# four times out of five; with the fixed seeds below each is within.
WITHIN = (0.93, 0.97)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return virtual_rig(np.random.default_rng(3), RigDesign(camera_width=210, camera_height=100, camera_focal_px=900.0))


@pytest.fixture(scope="module")
def rays(rig: Rig) -> np.ndarray:
    v, u = np.mgrid[: rig.left.height, : rig.left.width]
    return rig.left.rays(np.stack([u, v], -1))


def cloud(
    rays: np.ndarray, centres: np.ndarray, radius: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Organised cloud of spheres as the left camera sees them; points err along their rays."""
    distance = np.full(rays.shape[:2], np.inf)
    for centre in centres:
        along = rays @ centre
        under = along**2 - centre @ centre + radius**2
        distance = np.where(under > 0, np.minimum(distance, along - np.sqrt(np.maximum(under, 0))), distance)
    points = np.where(
        np.isfinite(distance)[..., None], rays * np.where(np.isfinite(distance), distance, 0)[..., None], np.nan
    )
    noise = rng.normal(0, SIGMA_Z, distance.shape)
    points = points + noise[..., None] * rays / rays[..., 2:]
    return points, np.where(np.isfinite(points[..., 2]), SIGMA_Z, np.nan)


def coverage(errors: list[float], spans: list[float]) -> float:
    return float(np.mean(np.abs(errors) <= np.array(spans)))


def test_sizes_and_spacings_lie_within_their_u95(rays: np.ndarray) -> None:
    rng = np.random.default_rng(11)
    sizes: list[tuple[float, float]] = []
    spacings: list[tuple[float, float]] = []
    for _ in range(ARTEFACTS):
        # The certificate errs by its own uncertainty: diameter 0.001 mm, length 0.002 mm (95 %).
        diameter, length = 50 + rng.normal(0, 0.0005), 90 + rng.normal(0, 0.001)
        middle = np.array([0, 0, 720.0]) + rng.uniform(-8, 8, 3)
        turn = Rotation.from_euler("zy", rng.uniform(-20, 20, 2), degrees=True)
        half = turn.apply([length / 2, 0, 0])
        points, sigma = cloud(rays, np.array([middle - half, middle + half]), diameter / 2, rng)
        found = find_spheres(points, 25.0, 2)
        fits = [fit_sphere(points, sigma, centre, 25.0) for centre in found]
        assert len(fits) == 2
        one, other = fits
        assert one is not None
        assert other is not None
        sizes.append((one.diameter_mm - 50, np.hypot(one.diameter_u95_mm, 0.001)))
        measured, u95 = distance_u95(one, other)
        spacings.append((measured - 90, np.hypot(u95, 0.002)))
    for found_errors in (sizes, spacings):
        errors, spans = zip(*found_errors, strict=True)
        assert WITHIN[0] <= coverage(list(errors), list(spans)) <= WITHIN[1]


def test_form_errors_lie_within_their_u95() -> None:
    rng = np.random.default_rng(2)

    def flat(n: int) -> np.ndarray:
        # A plate with a bow of 0.02 mm, and noise.
        return 0.01 * np.sin(rng.uniform(0, 2 * np.pi, n)) + rng.normal(0, SIGMA_Z, n)

    true = form(flat(1_000_000)).form_mm
    found = [form(flat(20_000)) for _ in range(ARTEFACTS)]
    errors, spans = [f.form_mm - true for f in found], [f.form_u95_mm for f in found]
    assert WITHIN[0] <= coverage(errors, spans) <= WITHIN[1]
    assert all(f.form95_mm < f.form_mm for f in found)


def test_biases_and_growths_lie_within_their_u95() -> None:
    rng = np.random.default_rng(4)
    heights = np.linspace(-0.1, 0.5, 8)
    each: list[tuple[float, float]] = []
    biases: list[tuple[float, float]] = []
    growths: list[tuple[float, float]] = []
    for _ in range(ARTEFACTS):
        certificate = rng.normal(0, 0.0002)  # all certified values of a plate err alike, by U95 0.0004 mm
        found = [
            Deviation(f"R{k}, {scan}", f"R{k}", height + 0.01 + 0.02 * height + rng.normal(0, 0.0015) - certificate,
                      0.003, height, 0.0004)
            for k, height in enumerate(heights)
            for scan in range(3)
        ]  # fmt: skip
        each.append((found[0].value - 0.01 - 0.02 * heights[0], found[0].u95))
        bias, slope = common_bias(found), growth(found)
        biases.append((bias.value - 0.01 - 0.02 * heights.mean(), bias.u95))
        growths.append((slope.value - 0.02, slope.u95))
    for found_errors in (each, biases, growths):
        errors, spans = zip(*found_errors, strict=True)
        assert WITHIN[0] <= coverage(list(errors), list(spans)) <= WITHIN[1]


def views(
    rig: Rig, board: Board, turn: Rotation, t: np.ndarray, sigma: float, rng: np.random.Generator
) -> list[BoardView]:
    """Both cameras' pictures of a board, as ellipse centres."""
    found = []
    R = turn.as_matrix()
    index = np.arange(len(board.points))
    for device in (rig.left, rig.right):

        def image(plane: np.ndarray, device=device) -> np.ndarray:  # type: ignore[no-untyped-def]
            return device.project(np.column_stack([plane, np.zeros(len(plane))]) @ R.T + t)

        plane = board.points[:, :2]
        off = eccentricity(image, plane, board.radius_mm) if board.radius_mm else 0.0
        pixels = image(plane) + off + rng.normal(0, sigma, plane.shape)
        found.append(BoardView(index, pixels, np.full(len(index), sigma), 1.0, (device.width, device.height)))
    return found


def test_lengths_on_a_board_lie_within_their_u95(rig: Rig) -> None:
    rng = np.random.default_rng(7)
    board = Board("asymmetric_circles", 5, 7, 10.0, dot_diameter_mm=8.0)
    errors, spans = [], []
    for _ in range(ARTEFACTS // 4):
        turn = Rotation.from_euler("xyz", rng.uniform(-25, 25, 3), degrees=True)
        t = np.array([-40.0, -30, 720]) + rng.uniform(-5, 5, 3)
        found = board_lengths(rig, board, *views(rig, board, turn, t, 0.02, rng))
        errors += [measured - nominal for _, measured, _, nominal in found.lengths]
        spans += [u95 for *_, u95, _ in found.lengths]
    assert len(errors) == ARTEFACTS
    assert WITHIN[0] <= coverage(errors, spans) <= WITHIN[1]


def test_eccentricity_of_large_dots_is_no_length_error(rig: Rig) -> None:
    board = Board("circles", 3, 3, 40.0, dot_diameter_mm=38.0)
    turn = Rotation.from_euler("xyz", [25, 15, 3], degrees=True)
    rng = np.random.default_rng(0)
    with pytest.raises(CalibrationError, match="found 9 features"):
        board_lengths(rig, board, *views(rig, board, turn, np.array([-40.0, -40, 720]), 0.0, rng))
    board = Board("circles", 4, 4, 26.0, dot_diameter_mm=24.0)
    found = board_lengths(rig, board, *views(rig, board, turn, np.array([-40.0, -40, 720]), 0.0, rng))
    assert max(abs(measured - nominal) for _, measured, _, nominal in found.lengths) < 1e-4
    assert found.flatness_mm < 2e-4


def test_a_stretched_rig_shows_in_lengths(rig: Rig) -> None:
    stretched = replace(rig, right=replace(rig.right, t=rig.right.t * 1.001))
    board = Board("chessboard", 6, 5, 15.0)
    seen = views(
        rig, board, Rotation.from_euler("x", 10, True), np.array([-40.0, -30, 720]), 0.0, np.random.default_rng(0)
    )
    found = board_lengths(stretched, board, *seen)
    assert [m / nominal for _, m, _, nominal in found.lengths] == pytest.approx([1.001] * 4, abs=1e-5)


def test_three_spheres_are_told_apart_by_their_distances() -> None:
    places = np.array([[0.0, 0, 0], [60, 0, 0], [60, 35, 0]])
    distances = {(0, 1): 60.0, (1, 2): 35.0}
    assert identify(places[[2, 0, 1]], distances) == (1, 2, 0)


def test_a_plane_is_no_sphere() -> None:
    v, u = np.mgrid[:120, :160].astype(float)
    points = np.dstack([0.3 * u, 0.3 * v, 700 + 0.05 * u])
    centres = find_spheres(points, 10.0, 1)
    assert all(fit_sphere(points, np.full(u.shape, 0.01), centre, 10.0) is None for centre in centres)


def test_neighbours_that_share_noise_widen_the_uncertainty() -> None:
    rng = np.random.default_rng(1)
    independent = rng.normal(0, 1, (160, 160))
    shared = np.repeat(rng.normal(0, 1, (160, 40)), 4, axis=1)
    assert inflation(independent) == pytest.approx(1.0, abs=0.25)
    assert inflation(shared) == pytest.approx(4.0, rel=0.3)
    assert inflation(np.full((4, 4), 1.0)) == 1.0


def test_too_few_features_have_no_bias() -> None:
    with pytest.raises(UsageError, match="found 1 features"):
        common_bias([Deviation("R1, a", "R1", 0.1, 0.01, 0.1, 0.001)])
