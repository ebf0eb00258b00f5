"""What the cloud tells about a skin before anything is looked for on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import Reconstruction
from metrology.rivets.geometry import circle_shapes
from metrology.rivets.relief import Disc, ReliefMap, discs, relief_map
from metrology.rivets.settings import RivetSettings
from metrology.rivets.shapes import CircleShapes


@dataclass(frozen=True)
class Ground:
    """A skin as the left camera sees it."""

    shapes: CircleShapes
    """What a circle on it looks like where."""
    pixels_per_mm: NDArray[np.float64]
    """(rows, columns)."""
    radii: tuple[float, float]
    """(least, most): of the heads looked for, px."""
    relief: ReliefMap
    """Heights over it."""
    discs: list[Disc]
    """What lies above or below it there, round and flat."""


def ground_of(reconstruction: Reconstruction, settings: RivetSettings) -> Ground | None:
    """The skin of a scan; None where the cloud does not tell how large a millimetre is."""
    shapes, scale = circle_shapes(reconstruction)
    if not np.isfinite(scale).all():
        return None
    least = max(0.5 * settings.min_diameter_mm * scale.min(), 0.5 * settings.min_diameter_px)
    most = 0.5 * settings.max_diameter_mm * scale.max()
    relief = relief_map(reconstruction, most)
    return Ground(shapes, scale, (least, most), relief, discs(relief, shapes, (least, most)))
