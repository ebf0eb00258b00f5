"""Rivets: detection in the image (paper §3.1), geometry from the cloud (paper §4.1)."""
