"""Seams: detection in the image (paper §3.2), step and width from the cloud (paper §4.2)."""
