"""Where seams are: lines of the left image that the points confirm, and steps that the points alone show.

1. ``detect``      The way from a scan to its seams; every other file here is a part of it.
2. ``lines``       Centre lines in one image: candidates, their borders, their ends.
3. ``candidates``  Line points at three reductions, linked (``linking``) and cut into straight pieces (``segments``).
4. ``rough``       First look at a candidate: median cross-section, place, width, contrast.
5. ``refine``      Borders fitted at nodes (``bands``, ``band_kernel``), and the smooth line between them.
6. ``ends``        Where a line begins and ends; ``joints`` where one runs into another (``image_line``: the result).
7. ``relief``      What the points say: step, groove or nothing; ``shade`` where a band has no points of its own.
8. ``bridges``     Pieces of one joint that the points join.
9. ``laps``        Edges of one sheet on another (``step_edges``: ridges of the step in the points).

``strip`` lays pixels out along a line, ``medians`` are those of rows with values left out.
"""
