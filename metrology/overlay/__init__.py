"""The overlay: verdicts drawn for the projector, so that they appear on the skin beside what they judge (paper §5)."""

from metrology.overlay.draw import Overlay, OverlaySettings, draw_overlay, scan_title
from metrology.overlay.words import Words

__all__ = ["Overlay", "OverlaySettings", "Words", "draw_overlay", "scan_title"]
