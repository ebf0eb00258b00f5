"""What the demonstration sets side by side: each feature with its own truth, and what was not found."""

from __future__ import annotations

import pytest

from flows.demo import compare
from tests.support.results import small_result


def test_found_is_set_beside_the_truth_at_the_same_place() -> None:
    result = small_result()
    features = {**result.features, "rivet": result.features["rivet"][:1]}
    truth = {
        "rivets": [
            {"id": "T1", "xyz_mm": [1.2, 2.0, 700.0], "diameter_mm": 8.0, "height_mean_mm": 0.048},
            {"id": "T2", "xyz_mm": [40.0, 2.0, 700.0], "diameter_mm": 8.0, "height_mean_mm": 0.1},
            {"id": "T3", "xyz_mm": [1.0, 2.0, 700.0], "diameter_mm": 8.0, "height_mean_mm": 0.1, "visible": False},
        ],
        "seams": [
            {"id": "J1", "xyz_mm": [[1.0, 2.0, 700.0], [1.0, 90.0, 700.0]], "step_mm": [0.11, 9], "width_mm": [2.5, 9]}
        ],
    }
    near, far, step, width = compare(features, truth)
    assert (near.feature, near.found, near.true, near.decision) == ("T1", 0.05, 0.048, "pass")
    assert (far.feature, far.found, far.decision) == ("T2", None, "not found")
    assert (step.feature, step.found, step.true) == ("J1", pytest.approx(0.1), pytest.approx(0.11))
    assert (width.found, width.true, width.decision) == (pytest.approx(2.4), pytest.approx(2.5), "0 of 1 pass")
