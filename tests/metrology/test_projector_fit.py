"""The projector from points and decoded coordinates: truth, stated uncertainty, what cannot be told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from metrology.calibration.distortion_model import LADDER, choose_terms
from metrology.calibration.projector_fit import SeenPoints, fit_projector
from metrology.errors import CalibrationError
from metrology.fringe import Axis
from metrology.rig import Device
from tests.support.rendered_fringes import small_rig

SIZE = (320, 240)
LENS = np.array([-0.05, 0.08, 0.0, 0.0, 0.0])


def projector() -> Device:
    return replace(small_rig().with_projector(), distortion=LENS)


def seen(
    axis: Axis,
    rng: np.random.Generator,
    heights: tuple[float, ...] = (0.0, 60.0, -50.0),
    sigma: float = 0.03,
    device: Device | None = None,
) -> SeenPoints:
    """Tilted planes at several heights, 240 blocks of 30 points each."""
    blocks, points = [], []
    for plane, height in enumerate(heights):
        x, y = rng.uniform(-90, 90, (2, 80)), rng.uniform(-70, 70, (2, 80))
        for k in range(80):
            px, py = x[0, k] + rng.uniform(-4, 4, 30), y[0, k] + rng.uniform(-4, 4, 30)
            slope = (-0.3, 0.1, 0.4)[plane]
            points.append(np.column_stack([px, py, 700 + height + slope * px + 0.2 * py]))
            blocks += [plane * 80 + k] * 30
    where: NDArray[np.float64] = np.concatenate(points)
    shown = (device or projector()).project(where)[:, 0 if axis == "x" else 1]
    return SeenPoints(axis, where, shown + rng.normal(0, sigma, len(shown)), np.array(blocks))


def test_both_axes_tell_the_whole_projector(rng: np.random.Generator) -> None:
    found = fit_projector([seen("x", rng), seen("y", rng)], SIZE)
    true = projector()
    assert found.assumed is None
    assert found.rms_px < 0.02
    for name, place in (("fx", (0, 0)), ("fy", (1, 1)), ("cx", (0, 2)), ("cy", (1, 2))):
        off = abs(found.device.K[place] - true.K[place])
        assert off < 4.5 * found.sigma[name], name
        assert found.sigma[name] < 5
    assert np.linalg.norm(found.device.centre - true.centre) < 2.5 * found.place_u95_mm
    points = seen("x", rng).points
    assert np.abs(found.device.project(points) - true.project(points)).max() < 0.2


def test_one_axis_tells_columns_and_says_how_far_rows_are_assumed(rng: np.random.Generator) -> None:
    found = fit_projector([seen("x", rng)], SIZE)
    true = projector()
    assert found.assumed == "rows"
    assert abs(found.device.K[0, 0] - true.K[0, 0]) < 4.5 * found.sigma["fx"]
    points = seen("x", rng).points
    off = np.abs(found.device.project(points) - true.project(points))
    assert off[:, 0].max() < 0.2
    assert off[:, 1].max() < 2 * found.assumed_u95_px
    assert found.assumed_u95_px > 1
    assert found.summary["assumed"] == "rows"


def test_where_a_lens_without_distortion_lies_along_its_columns_is_not_known(rng: np.random.Generator) -> None:
    true = replace(projector(), distortion=np.zeros(5))
    found = fit_projector([seen("x", rng, sigma=0.003, device=true)], SIZE)
    off = np.abs(true.R @ (found.device.centre - true.centre))
    assert off[1] < found.place_u95_mm
    assert found.place_u95_mm > 20
    assert off[[0, 2]].max() < 1


def test_what_is_flat_is_refused(rng: np.random.Generator) -> None:
    flat = seen("x", rng, heights=(0.0,))
    with pytest.raises(CalibrationError, match=r"one plane|flat"):
        fit_projector([flat], SIZE)
    few = SeenPoints("x", flat.points[:900], flat.coordinate[:900], flat.block[:900])
    with pytest.raises(CalibrationError, match="found 30 blocks of measured points, expected at least 60"):
        fit_projector([few], SIZE)


def test_a_code_that_runs_backwards_is_named(rng: np.random.Generator) -> None:
    rows = seen("y", rng)
    with pytest.raises(CalibrationError, match="mirror each other"):
        fit_projector([seen("x", rng), replace(rows, coordinate=SIZE[1] - 1 - rows.coordinate)], SIZE)


def test_terms_that_no_lens_can_have_are_no_candidates() -> None:
    chi2 = dict.fromkeys(LADDER, 300.0) | {LADDER[0]: 900.0, LADDER[-1]: np.inf}
    terms, evidence = choose_terms("projector", lambda terms: (chi2[terms], 300 - len(terms)), 300)
    assert terms == LADDER[1]
    assert evidence[-1].bic == np.inf
    assert evidence[-1].p_value is None
    assert evidence[1].p_value is not None
