"""Settings of rivet detection and measurement."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from metrology.errors import UsageError

Reference = Literal["quadric", "plane"]


@dataclass(frozen=True)
class RivetSettings:
    """How rivets are looked for and measured."""

    min_diameter_mm: float = 2.8
    max_diameter_mm: float = 15.0
    """min_diameter_mm, max_diameter_mm: heads looked for, where the cloud gives the scale."""
    min_diameter_px: float = 10.0
    max_diameter_px: float = 90.0
    """min_diameter_px, max_diameter_px: heads looked for in an image without a cloud, and hard limits with one."""
    ridge_low: float = 2.0
    ridge_high: float = 2.8
    """ridge_low, ridge_high: ridge response at which an arc goes on, and starts, in standard deviations of its noise.
    """
    min_support: float = 0.12
    """Share of a full turn that must vote for a centre before it is looked at."""
    min_coverage: float = 0.52
    """Share of a ring's sectors in which the ring must show to be a rivet."""
    min_coverage_alone: float = 0.64
    """The same where neither cloud nor other rings tell what shape to expect: scratches that cross make polygons."""
    min_score: float = 8.0
    """Amplitude of the ring over its standard deviation to be a rivet."""
    min_quality: float = 2.5
    """How far the ring stands out from its surroundings, in their standard deviations, times the square of its
    coverage, to be a rivet."""
    sure_quality: float = 6.0
    """Quality above which a ring needs no step in height to be a rivet."""
    sure_relief: float = 4.0
    """Height step over its standard deviation that bears out a weaker ring."""
    max_sunk_mm: float = 2.0
    """A ring whose inside lies deeper than this below the skin is a hole."""
    plain_heads: bool = True
    """Whether to look for heads without a rim (painted over) in the height map."""
    min_ring_share: float = 0.5
    """Amplitude of the ring as a share of the brightness step from head to skin: below it the ring is an edge."""
    reference: Reference = "quadric"
    """What the skin round a head is taken for: the tangent plane at the head's centre of a quadric, or a plane (the
    paper's)."""
    inner_radius: float = 0.85
    """Radius of the inner point set as a share of the head's."""
    outer_radii: tuple[float, float] = (1.1, 3.0)
    """Radii of the outer annulus as shares of the head's. The wider, the less noise in the skin's height at the head's
    centre, and the more waviness (with the fourth power of the radius): on 40 simulated panels 3.0 errs by 1.01 µm
    in the mean, 2.5 by 1.17 µm; beyond 3.0 little is gained, and those panels have no waviness."""
    min_outer_width_mm: float = 4.0
    """The outer annulus reaches at least this far from the rim, so that small heads have skin enough."""
    guard_px: float = 0.5
    guard_sigmas: float = 3.0
    """guard_px, guard_sigmas: both sets keep this distance from the rim: pixels, plus multiples of the rim's half-width
    σ in the image."""
    min_clear_share: float = 0.35
    """Share of a set's points that must be free of edge flags for the flagged ones to be left out."""
    seam_margin_px: float = 3.0
    """Kept from a seam beyond its half-width."""
    controls: int = 12
    """Places on bare skin at which the height of nothing is measured, to learn how far measurements really scatter."""
    min_crown_mm: float = 0.015
    """A head is modelled as a dome where its crown is larger and significant."""
    min_inner: int = 30
    min_outer: int = 120
    """min_inner, min_outer: points needed."""
    min_sectors: int = 7
    """Directions, of twelve, in which skin is needed."""

    def __post_init__(self) -> None:
        if not 0 < self.min_diameter_mm < self.max_diameter_mm:
            raise UsageError(
                f"rivet diameters: found {self.min_diameter_mm:g} to {self.max_diameter_mm:g} mm, "
                "expected 0 < min < max"
            )
        if not 6 <= self.min_diameter_px < self.max_diameter_px:
            raise UsageError(
                f"rivet diameters: found {self.min_diameter_px:g} to {self.max_diameter_px:g} px, "
                "expected 6 <= min < max"
            )
        if self.reference not in ("quadric", "plane"):
            raise UsageError(f"rivet reference: found {self.reference!r}, expected 'quadric' or 'plane'")
        if not 0.3 <= self.inner_radius <= 1:
            raise UsageError(f"inner_radius: found {self.inner_radius:g}, expected 0.3 to 1")
        if not 1 <= self.outer_radii[0] < self.outer_radii[1]:
            raise UsageError(f"outer_radii: found {self.outer_radii}, expected 1 <= inner < outer")
