"""A virtual rig and panel: ray-traced fringe scans and calibration captures with known truth (docs/simulator.md)."""
