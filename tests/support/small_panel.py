"""A specification for the simulator: a small camera before a panel with two rivets and, where wanted, a seam."""

SIMULATION = """
format = "flushline-simulation/1"
seed = 3
[scene]
aircraft_serial = "A"
panel = "SMALL"
station = "S1"
captured_at = "2026-11-20T08:00:00Z"
[rig]
id = "rig-small"
seed = 3
design = { camera_width = 300, camera_height = 220 }
[panel.surface]
brushing = 0.0
[[panel.rivets]]
id = "R01"
x_mm = -14.0
y_mm = 5.0
diameter_mm = 8.0
height_mm = 0.113
[[panel.rivets]]
id = "R02"
x_mm = -13.0
y_mm = -9.0
diameter_mm = 6.0
height_mm = -0.06
"""

SEAM = """
[[panel.seams]]
id = "J01"
points_mm = [[10.0, -110.0], [11.0, 110.0]]
width_mm = 2.0
step_mm = 0.2
"""

PLACEMENTS = """
[[placements]]
[[placements]]
rotation_deg = [2.0, -3.0, 1.0]
"""
