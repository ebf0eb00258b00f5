"""How wide the gap between the skins is, from what both cameras see of it.

1. ``find``         The gap at every seam station, by the method that joint and settings ask for.
2. ``image_edges``  Both edges from the images (``edges: image``); ``point_edges``, ``piecewise`` from points (eq 5).
3. ``profiles``     Grey levels across the seam in both cameras (``views``).
4. ``lap_shadow``   Whether what is dark is a gap, or the wall and shadow of a step.
5. ``model``        What a camera sees of a section: outline, light and shadow, blur. ``levels``: brightness.
6. ``prior``        What is known of a gap before any picture; ``floor``: its depth where points show it.
7. ``solver``       Least squares of borders and shape. ``descent``, ``equations``: its steps, brightness first.
8. ``shape``        The shape that a seam's stations share, from several starts; ``chamfers``: averaged over them.
9. ``fit``          All of it in order: shape, borders, uncertainty, seam stations that look unlike the rest.
10. ``width``       Width between the edges (eqs 9–11).
"""
