"""What a user may set about reconstruction; units and meaning beside each value."""

from __future__ import annotations

from dataclasses import dataclass

from metrology.errors import UsageError
from metrology.unwrap import Unwrapping


@dataclass(frozen=True)
class ReconstructionSettings:
    """Settings of decoding, matching and triangulation."""

    unwrapping: Unwrapping = "ml"
    """How the fringe order is found: nearest wrap-count lattice point, or the paper's heterodyne."""
    saturation: float | None = None
    """Grey level from which a sample counts as saturated; None: where the histogram piles up at its end, else the top
    1/255 of the camera's range."""
    min_modulation: float = 3.0
    """Least fringe amplitude, grey levels of an 8-bit camera (scaled for wider ones), at exposure 1."""
    max_slip_probability: float = 0.01
    """Pixels whose noise makes a fringe-order slip likelier than this are LOW_MODULATION."""
    blur_radius_px: float = 1.0
    """Radius of the lens blur (the standard deviation of its spread), pixels; EDGE reaches two of them and a pixel."""
    edge_contrast: float = 0.1
    """Relative change of brightness over a pixel from which a gradient counts as a reflectance edge."""
    min_slope: float = 0.1
    """Least share of the right view's phase gradient that must lie along the epipolar line, 0 … 1."""
    depth_range_mm: tuple[float, float] = (1.0, 1e6)
    """Depths outside are SLOPE."""
    threads: int | None = None
    """None: as many as the process may use."""

    def __post_init__(self) -> None:
        if self.unwrapping not in ("ml", "heterodyne"):
            raise UsageError(f"unwrapping: found {self.unwrapping!r}, expected 'ml' or 'heterodyne'")
        if self.saturation is not None and self.saturation <= 0:
            raise UsageError(f"saturation: found {self.saturation:g}, expected a positive grey level")
        if self.min_modulation <= 0:
            raise UsageError(f"min_modulation: found {self.min_modulation:g}, expected more than 0")
        if not 0 < self.max_slip_probability < 0.5:
            raise UsageError(f"max_slip_probability: found {self.max_slip_probability:g}, expected 0 … 0.5")
        if not 0 < self.blur_radius_px <= 10:
            raise UsageError(f"blur_radius_px: found {self.blur_radius_px:g}, expected 0 … 10")
        if not 0 < self.edge_contrast < 1:
            raise UsageError(f"edge_contrast: found {self.edge_contrast:g}, expected 0 … 1")
        if not 0 < self.min_slope < 1:
            raise UsageError(f"min_slope: found {self.min_slope:g}, expected 0 … 1")
        low, high = self.depth_range_mm
        if not 0 < low < high:
            raise UsageError(f"depth_range_mm: found {low:g} … {high:g}, expected rising positive depths")
        if self.threads is not None and self.threads < 1:
            raise UsageError(f"threads: found {self.threads}, expected at least 1")
