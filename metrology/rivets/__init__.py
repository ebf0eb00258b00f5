"""Rivets: detection in the image (paper §3.1), geometry from the cloud (paper §4.1)."""

from metrology.rivets.ellipse_detection import detect_ellipses
from metrology.rivets.measure import measure_rivets
from metrology.rivets.rivet_detection import detect_rivets
from metrology.rivets.settings import RivetSettings

__all__ = ["RivetSettings", "detect_ellipses", "detect_rivets", "measure_rivets"]
