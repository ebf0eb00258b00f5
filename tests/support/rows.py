"""Rows of results with a place, for tests that make their own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from metrology.results import Rivet, SeamStation


def rivet_at(
    name: str, place: Sequence[Any], pixel: Sequence[Any], diameter: float | None, size: float, **more: Any
) -> Rivet:
    """A round head of a diameter, mm, that the left picture shows `size` pixels wide."""
    placed = dict(zip(("x_mm", "y_mm", "z_mm", "u_px", "v_px"), (*place, *pixel), strict=True))
    seen = {"u_right_px": None, "v_right_px": None, "minor_px": size, **more}
    return Rivet(name, **placed, diameter_mm=diameter, major_px=size, angle_deg=0.0, confidence=1.0, **seen)


def station_at(seam: str, s: float, place: Sequence[Any], pixel: Sequence[Any], **more: Any) -> SeamStation:
    """A position along a seam."""
    placed = dict(zip(("x_mm", "y_mm", "z_mm", "u_px", "v_px"), (*place, *pixel), strict=True))
    return SeamStation(seam, s, **placed, **more)
