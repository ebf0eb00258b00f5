"""Positions of result rows, in the rig frame and in the panel frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from metrology.panel import Placement
from metrology.results import Feature

Array = NDArray[np.float64]
Row = TypeVar("Row", bound=Feature)


def has_position(row: Feature) -> bool:
    """Whether a row has a place in space."""
    return row.x_mm is not None and row.y_mm is not None and row.z_mm is not None


def positions(rows: Sequence[Feature]) -> Array:
    """(n, 3) places in the rig frame; NaN where a row has none."""
    return np.array([(row.x_mm, row.y_mm, row.z_mm) for row in rows], float).reshape(-1, 3)


def placed(row: Row, placement: Placement) -> Row:
    """The row with its panel coordinates."""
    if not has_position(row):
        return row
    x, y, z = placement.to_panel(positions([row])[0])
    return row.changed(x_panel_mm=float(x), y_panel_mm=float(y), z_panel_mm=float(z))
