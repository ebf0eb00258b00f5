"""The panel specification of a simulated panel: its pattern, so that features have the simulation's names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from flows.study.series import Known, Series, known
from storage.panel_spec import FORMAT, PanelSpecification, panel_spec_from

_SOURCE = "study"
_COURSE_STEP = 10  # stations of the truth between two corners of a nominal seam


def panel_specification(series: Series, tolerance_mm: float) -> PanelSpecification:
    """Limits for height and step as wide as the tolerance, and the pattern with the rig's placements before it."""
    simulation = series.simulation
    placed = [known(simulation, placement) for placement in range(len(simulation.placements))]
    limit = {"lower": -tolerance_mm / 2, "upper": tolerance_mm / 2, "source": _SOURCE, "revision": "1"}
    document: dict[str, Any] = {
        "format": FORMAT,
        "panel": simulation.scene.panel,
        "revision": "1",
        "zones": {"default": {"height_mm": limit, "step_mm": limit}},
        "rivets": _rivets(placed[0]),
        "seams": _seams(placed[0]),
        "stations": {
            series.station(placement, rig): _station(at) for placement, at in enumerate(placed) for rig in series.rigs
        },
    }
    return panel_spec_from(document, Path(f"panel of {series.name}"))


def _rivets(at: Known) -> list[dict[str, Any]]:
    return [
        {"id": rivet.id, "position_mm": _panel(at, rivet.xyz_mm), "diameter_mm": rivet.diameter_mm}
        for rivet in at.truth.rivets
    ]


def _seams(at: Known) -> list[dict[str, Any]]:
    return [
        {"id": seam.id, "course_mm": [_panel(at, xyz) for xyz in [*seam.xyz_mm[:-1:_COURSE_STEP], seam.xyz_mm[-1]]]}
        for seam in at.truth.seams
    ]


def _station(at: Known) -> dict[str, Any]:
    """Rig frame to panel frame: the inverse of the panel's pose."""
    return {"R": at.pose.R.T.tolist(), "t_mm": (-at.pose.R.T @ at.pose.t).tolist()}


def _panel(at: Known, xyz: list[float]) -> list[float]:
    return [float(value) for value in at.pose.to_panel(np.array(xyz))]
