"""A line as it was found in one image."""

from __future__ import annotations

from dataclasses import dataclass

from metrology.arrays import Array
from metrology.seams.polyline import polyline_length


@dataclass(frozen=True)
class ImageLine:
    """A dark or bright line in an image."""

    centre_px: Array
    """(n, 2): u, v of the middle between both borders, about every pixel."""
    width_px: Array
    """(n,): between the borders, interpolated where they could not be told."""
    contrast: float
    """Brightness of the band relative to its surroundings, less one: negative for a dark line."""
    support: float
    """Share of the line's length over which it is there, 0 … 1."""

    @property
    def length_px(self) -> float:
        """Along the line."""
        return polyline_length(self.centre_px)
