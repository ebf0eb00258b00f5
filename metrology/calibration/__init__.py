"""Calibration of the rig's cameras and projector from pictures of a board (paper §5.2)."""
