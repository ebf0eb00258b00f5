"""Settings of how defects of the skin are looked for and measured."""

from __future__ import annotations

from dataclasses import dataclass

from metrology.errors import UsageError


@dataclass(frozen=True)
class DefectSettings:
    """How dents, bumps, creases and scratches are looked for and measured."""

    least_depth_mm: float = 0.015
    """What is shallower is no defect."""
    largest_mm: float = 80.0
    """Length at half depth of the largest defect of interest: the reference surface has no wave shorter than twice
    that, which is about a dent's whole length."""
    straight_edge_mm: float = 150.0
    """Length of the straight-edge that is laid across a defect."""
    pull_in_mm: float = 0.1
    """How deep a fastener may draw in the skin round itself without its being a dent; where other fasteners of the scan
    draw it in half as much or more, twice what is usual."""
    scratch_width_mm: float = 3.0
    """What is narrower at half depth, and over four times as long, is a scratch."""
    scratch_pixels: float = 3.0
    """Width at half depth that a scratch must have for its depth to be measured: points are means over fewer pixels."""

    def __post_init__(self) -> None:
        for name, least, most in (
            ("least_depth_mm", 0.001, 5.0),
            ("largest_mm", 5.0, 500.0),
            ("straight_edge_mm", 10.0, 1000.0),
            ("pull_in_mm", 0.0, 5.0),
            ("scratch_width_mm", 0.1, 20.0),
            ("scratch_pixels", 1.0, 50.0),
        ):
            if not least <= getattr(self, name) <= most:
                raise UsageError(f"{name}: found {getattr(self, name):g}, expected {least:g} … {most:g}")
