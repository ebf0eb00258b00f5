"""Seams: their centre lines, and step and width at stations along them (paper §3.2 and §4.2)."""

from metrology.seams.detect import detect_seams
from metrology.seams.image_line import ImageLine
from metrology.seams.lines import detect_lines
from metrology.seams.settings import LineSettings, SeamSettings
from metrology.seams.stations import measure_seams
from metrology.seams.summary import SeamSummary, summarize

__all__ = [
    "ImageLine",
    "LineSettings",
    "SeamSettings",
    "SeamSummary",
    "detect_lines",
    "detect_seams",
    "measure_seams",
    "summarize",
]
