"""Waviness of the skin: how far it stands off a straight-edge that is slid over it."""
