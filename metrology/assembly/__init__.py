"""The panel from its scans: placed in one frame, every physical feature once (docs/panel.md)."""
