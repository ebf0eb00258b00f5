"""Open holes, and temporary fasteners in them: found in the cloud, measured in both pictures."""

from metrology.holes.find import Opening, find_openings
from metrology.holes.measure import measure_holes

__all__ = ["Opening", "find_openings", "measure_holes"]
