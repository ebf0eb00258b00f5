"""Seams: where they run (`finding`), how the skins beside them lie (`skins`), how wide they gape (`gap`).

``detect_seams`` finds them (paper §3.2). ``measure_seams`` gives step and width at seam stations along them (§4.2):
the centre line is laid onto the skin, each seam station gets its two skin lines and its gap, and both make a row.
Shared by the rooms: ``settings``, ``sides`` (which side is A), ``places`` (heads, panel), ``polyline``, ``sampling`` of
pixels along a section, ``blur`` of an edge.
"""

from metrology.seams.finding.detect import detect_seams
from metrology.seams.finding.image_line import ImageLine
from metrology.seams.finding.lines import detect_lines
from metrology.seams.measure import measure_seams
from metrology.seams.settings import LineSettings, SeamSettings

__all__ = ["ImageLine", "LineSettings", "SeamSettings", "detect_lines", "detect_seams", "measure_seams"]
