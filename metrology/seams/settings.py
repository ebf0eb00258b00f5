"""What a user may set about seams; units and meaning beside each value."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from metrology.errors import UsageError

EdgeMethod = Literal["image", "points"]


@dataclass(frozen=True)
class LineSettings:
    """Settings of line detection in one image."""

    min_contrast: float = 0.08
    """Least darkness (or brightness) of a line relative to the skin beside it. Sealant and skin of one paint differ by
    as little; brushed skin varies by a few per cent from place to place."""
    noise_sigmas: float = 6.0
    """Least line strength in standard deviations of what noise and surface grain give: at six, none of the million
    pixels of an image is a line by chance."""
    min_length_px: float = 150.0
    """Shortest line reported: 30 mm at five pixels per millimetre, fifteen stations."""
    min_segment_px: float = 30.0
    straightness_px: float = 1.5
    """min_segment_px, straightness_px: shortest straight piece that may become part of a line, and how far its points
    may lie from it. A chord of 30 px departs by 1.5 px from an arc of 75 px radius: rims of rivets up to 30 mm are
    no straight pieces."""
    max_gap_px: float = 120.0
    """Longest interruption of one line, besides half the shorter piece: a rivet head of 24 mm."""
    max_bend_deg: float = 6.0
    """Largest angle between neighbouring pieces of one line: the direction of a piece of `min_segment_px` known to
    `straightness_px`, twice."""
    coarsest_level: int = 3
    """Lines are sought in the image reduced 2, 4 … 2^coarsest_level times; the last finds bands up to 3 ·
    2^coarsest_level px wide best, and somewhat wider ones."""
    seed: int = 1
    """Of the random samples that straight pieces are found with."""

    def __post_init__(self) -> None:
        if not 0 < self.min_contrast < 1:
            raise UsageError(f"min_contrast: found {self.min_contrast:g}, expected 0 … 1")
        for name in ("noise_sigmas", "min_length_px", "min_segment_px", "straightness_px", "max_bend_deg"):
            if not getattr(self, name) > 0:
                raise UsageError(f"{name}: found {getattr(self, name):g}, expected more than 0")
        if self.max_gap_px < 0:
            raise UsageError(f"max_gap_px: found {self.max_gap_px:g}, expected 0 or more")
        if not 1 <= self.coarsest_level <= 5:
            raise UsageError(f"coarsest_level: found {self.coarsest_level}, expected 1 … 5")


@dataclass(frozen=True)
class SeamSettings:
    """Settings of seam detection and measurement."""

    lines: LineSettings = field(default_factory=LineSettings)
    min_step_mm: float = 0.03
    """Step between the two skins from which a line without a groove counts as a seam: more than the skin's own waves
    and texture leave in the points on both sides of a painted line (0.02 mm on simulated skins)."""
    min_groove_mm: float = 0.02
    """How much deeper than both skins a groove must be in its middle: sealant sinks in by more as it cures, and painted
    lines stay within 0.01 mm of the skin (simulated)."""
    edges: EdgeMethod = "image"
    """Where the gap's edges come from: the grey-level model in both images, or the paper's piecewise fit of points."""
    station_step_mm: float = 2.0
    """Distance between stations along the seam."""
    half_length_mm: float = 2.0
    """ε_d: points and pixels this near to a station's section plane belong to it (paper: 1–2 mm)."""
    skin_extent_mm: float = 14.0
    """How far from the edge the skin lines are fitted."""
    guard_px: float = 4.0
    """Points nearer to an edge than this are mixed with what lies behind it and stay out of the skin lines."""
    min_points: int = 150
    """Fewest points of a skin line."""
    chamfer_deg: float = 45.0
    """Angle of the edges' chamfers against the skin (drawings: 45°)."""
    merge_angle_deg: float = 20.0
    """θ: neighbouring pieces with a smaller angle are one line (`edges: points`; paper: 20°)."""
    tolerance_sigmas: float = 5.0
    """ε in units of the measured point noise (`edges: points`; paper: 5)."""

    def __post_init__(self) -> None:
        if self.edges not in ("image", "points"):
            raise UsageError(f"edges: found {self.edges!r}, expected 'image' or 'points'")
        positive = (
            "min_step_mm",
            "min_groove_mm",
            "station_step_mm",
            "half_length_mm",
            "skin_extent_mm",
            "min_points",
            "merge_angle_deg",
            "tolerance_sigmas",
        )
        for name in positive:
            if not getattr(self, name) > 0:
                raise UsageError(f"{name}: found {getattr(self, name):g}, expected more than 0")
        if not 0 < self.chamfer_deg <= 75:
            raise UsageError(f"chamfer_deg: found {self.chamfer_deg:g}, expected more than 0, up to 75")
        if self.guard_px < 0:
            raise UsageError(f"guard_px: found {self.guard_px:g}, expected 0 or more")
