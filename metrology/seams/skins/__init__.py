"""How the skins lie on both sides of a seam, and the step between them.

1. ``track``        The centre line laid onto the skin: arc length, places and directions of the seam stations.
2. ``sections``     The plane across the seam at a seam station, the points near it, and their two skin lines.
3. ``other_seams``  Which points lie beyond another seam, on another sheet.
4. ``skin_lines``   Both lines by weighted least squares, outliers clipped, curvature in common.
5. ``residuals``    How errors of neighbouring points go together, across the seam and along it.
6. ``neighbours``   The lines smoothed by those of the seam stations before and behind.
7. ``one_sided``    What bends of one side alone may move the step by.
8. ``step``         Step and its uncertainty (eqs 6–8).
"""
