"""The wrap-count lattice, the heterodyne's beats, and the choice of fringe counts."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from metrology.errors import SceneError, UsageError
from metrology.fringe_choice import recommend_counts
from metrology.unwrap import heterodyne_beats, largest_sigma, order_lattice, slip_probability

SETS = [(70, 64, 59), (70, 65, 61), (1, 8, 64), (35, 36, 37), (3, 5), (30, 42, 70, 105), (9, 8, 7, 5, 3)]


@pytest.mark.parametrize("counts", SETS)
def test_basis_and_counts_generate_all_whole_numbers(counts: tuple[int, ...]) -> None:
    lattice = order_lattice(counts)
    assert abs(np.linalg.det(np.column_stack([lattice.basis, lattice.counts]))) == pytest.approx(1.0)


@pytest.mark.parametrize("counts", SETS)
def test_every_order_is_a_lattice_point(counts: tuple[int, ...], rng: np.random.Generator) -> None:
    lattice = order_lattice(counts)
    position = rng.uniform(0, 1, 200)
    wrapped = lattice.counts[:, None] * position % 1.0
    coordinates = lattice.to_lattice @ wrapped
    np.testing.assert_allclose(coordinates, np.rint(coordinates), atol=1e-9)


@pytest.mark.parametrize("counts", [(70, 64, 59), (9, 8, 7), (3, 5)])
def test_shortest_vector_is_the_least_distance_between_orders(counts: tuple[int, ...]) -> None:
    f = np.array(counts, float)
    unit = f / np.linalg.norm(f)
    position = np.linspace(0, 1, 20001)
    found = np.inf
    for extra in product((0, 1), repeat=len(counts)):
        whole = np.floor(np.outer(position, f)) + extra
        away = whole - np.outer(whole @ unit, unit)
        length = np.linalg.norm(away, axis=1)
        found = min(found, length[length > 1e-9].min())
    assert order_lattice(counts).shortest == pytest.approx(found)


def test_seventy_sixty_five_sixty_one_has_the_larger_margin() -> None:
    ratio = order_lattice((70, 65, 61)).shortest / order_lattice((70, 64, 59)).shortest
    assert ratio == pytest.approx(1.15, abs=0.01)


def test_common_factors_are_refused() -> None:
    with pytest.raises(SceneError, match="common factor"):
        order_lattice((60, 40, 20))


def test_beats_come_down_to_one_fringe() -> None:
    np.testing.assert_array_equal(heterodyne_beats((70, 64, 59)), [70, 6, 1])
    np.testing.assert_array_equal(heterodyne_beats((37, 36, 35)), [37, 1])
    with pytest.raises(SceneError, match="heterodyne expects 1"):
        heterodyne_beats((70, 49, 43))


def test_slip_probability_and_largest_sigma_are_inverse() -> None:
    assert slip_probability(0.08, largest_sigma(0.08, 1e-3)) == pytest.approx(1e-3)


def test_recommended_counts_keep_the_promise_and_beat_the_usual_set() -> None:
    best = recommend_counts(1280, noise=2.0, modulation=60.0)[0]
    sigma_phase = np.sqrt(2 / 4) * 2.0 / 60.0
    assert best.slip_probability < 1e-6
    assert best.slip_probability == pytest.approx(slip_probability(order_lattice(best.counts).shortest, sigma_phase))
    assert best.sigma_px < 1280 / (2 * np.pi) * sigma_phase / np.linalg.norm([70, 64, 59])


def test_more_noise_asks_for_more_margin() -> None:
    quiet = recommend_counts(1280, noise=1.0, modulation=80.0)[0]
    noisy = recommend_counts(1280, noise=3.0, modulation=25.0)[0]
    assert noisy.margin_rad > quiet.margin_rad


@pytest.mark.parametrize(
    ("size", "noise", "modulation", "counts"), [(1280, 0.0, 50.0, 3), (60, 2.0, 50.0, 3), (1280, 2.0, 50.0, 7)]
)
def test_impossible_wishes_are_refused(size: int, noise: float, modulation: float, counts: int) -> None:
    with pytest.raises(UsageError, match="expected"):
        recommend_counts(size, noise, modulation, counts=counts)
