"""Defects of the skin itself: dents, bumps, creases and scratches, against the skin as it would be without them."""
