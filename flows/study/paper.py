"""The paper's figures: Tables 1 to 3 (sections 6.1 and 6.2), in mm."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Accuracy:
    """A row of Table 1."""

    true: float
    measured: float
    mean_error: float
    sd: float
    max_error: float


@dataclass(frozen=True)
class Repeatability:
    """A row of Table 2, or half a row of Table 3; `deviation` is the largest variation range."""

    mean: float
    sd: float
    deviation: float


TABLE_1 = tuple(
    Accuracy(*row)
    for row in (
        (0.113, 0.129, 0.016, 0.003, 0.020),
        (0.143, 0.144, 0.001, 0.002, 0.005),
        (0.160, 0.153, -0.007, 0.001, 0.009),
        (0.151, 0.150, -0.001, 0.002, 0.003),
        (0.239, 0.239, 0.000, 0.002, 0.003),
        (0.257, 0.249, -0.008, 0.001, 0.010),
        (0.265, 0.247, -0.018, 0.001, 0.020),
        (0.254, 0.244, -0.010, 0.002, 0.013),
        (0.533, 0.536, 0.004, 0.002, 0.006),
        (0.550, 0.539, -0.011, 0.003, 0.015),
        (0.551, 0.532, -0.019, 0.003, 0.023),
        (0.533, 0.529, -0.004, 0.004, 0.009),
        (1.048, 1.046, -0.002, 0.003, 0.007),
        (1.051, 1.032, -0.019, 0.003, 0.023),
        (1.046, 1.026, -0.020, 0.003, 0.024),
        (1.025, 1.020, -0.004, 0.002, 0.007),
    )
)
TABLE_1_MEAN_ERROR, TABLE_1_SD, TABLE_1_MAX_ERROR = 0.009, 0.0023, 0.012
"""The last row of Table 1: averages over the rivets; the largest error of all is 0.024."""

TABLE_2 = tuple(
    Repeatability(*row)
    for row in (
        (0.046, 0.006, 0.020),
        (0.060, 0.003, 0.008),
        (0.048, 0.005, 0.019),
        (0.044, 0.003, 0.009),
        (0.109, 0.003, 0.009),
        (0.059, 0.003, 0.010),
        (0.071, 0.004, 0.015),
    )
)

TABLE_3 = tuple(
    (Repeatability(*row[:3]), Repeatability(*row[3:]))
    for row in (
        (0.112, 0.009, 0.028, 2.333, 0.018, 0.052),
        (0.064, 0.005, 0.015, 2.562, 0.016, 0.045),
        (0.169, 0.006, 0.019, 2.577, 0.013, 0.043),
        (0.110, 0.006, 0.020, 2.356, 0.013, 0.041),
        (0.072, 0.005, 0.014, 2.496, 0.014, 0.044),
        (0.216, 0.006, 0.019, 2.270, 0.017, 0.050),
        (0.279, 0.006, 0.015, 2.550, 0.013, 0.040),
        (0.164, 0.006, 0.018, 2.536, 0.012, 0.038),
        (0.235, 0.005, 0.019, 2.542, 0.017, 0.051),
        (0.157, 0.007, 0.018, 2.567, 0.013, 0.038),
    )
)
"""Steps and widths."""

SCENE_SECONDS = 8.0
"""Measurement and analysis of a scene of 300 mm × 200 mm (section 6.2)."""
