"""Tolerance zones of what no pattern names: that of the rivet or seam nearest to it."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from metrology.panel import PanelLayout, course_length, points_along
from metrology.results import Feature

Row = TypeVar("Row", bound=Feature)

_SAMPLE_MM = 5.0  # along a seam


def in_nearest_zone(row: Row, layout: PanelLayout) -> Row:
    """The row with the zone of the nearest rivet or seam; as it is without panel coordinates."""
    if row.x_panel_mm is None or layout.empty:
        return row
    here = np.array([row.x_panel_mm, row.y_panel_mm, row.z_panel_mm], float)
    near = [(float(np.linalg.norm(here - rivet.position)), rivet.zone) for rivet in layout.rivets]
    for seam in layout.seams:
        s = np.arange(0.0, course_length(seam.course), _SAMPLE_MM)
        away = np.linalg.norm(points_along(seam.course, s) - here, axis=1)
        near.append((float(away.min()), seam.zone_at(float(s[away.argmin()]))))
    return row.changed(zone=min(near)[1])
