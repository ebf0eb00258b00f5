"""Names that defects keep from scan to scan: what lies where an earlier scan of the station had one is that one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrology.arrays import Array
from metrology.defects.row import Defect

_RAISED = ("bump", "raised edge", "deposit")


def with_known_names(rows: Sequence[Defect], earlier: Sequence[Defect]) -> list[Defect]:
    """The defects with the names of those that lie where they do, others with numbers that nobody had.

    Two are one where their places on the panel are nearer than half the length of the larger, and both lie below the
    skin or both above. The nearest pair goes first; a name is given once.

    Parameters
    ----------
    rows : sequence of Defect
        Of a scan, in panel coordinates.
    earlier : sequence of Defect
        Of other scans of the station; of rows with one name the first counts.
    """
    known = list({defect.defect_id: defect for defect in reversed(earlier)}.values())
    names: dict[int, str] = {}
    for _, k, name in sorted(_pairs(rows, known)):
        if k not in names and name not in names.values():
            names[k] = name
    taken = [int(name[1:]) for name in (d.defect_id for d in known) if name[1:].isdecimal()]
    number = max(taken, default=0)
    for k in range(len(rows)):
        if k not in names:
            number += 1
            names[k] = f"D{number:02d}"
    named = [replace(row, defect_id=names[k]) for k, row in enumerate(rows)]
    return sorted(named, key=lambda row: row.defect_id)


def _pairs(rows: Sequence[Defect], known: Sequence[Defect]) -> list[tuple[float, int, str]]:
    """Distance, row and name of all that may be one."""
    found = []
    for k, row in enumerate(rows):
        for other in known:
            away = float(np.linalg.norm(_place(row) - _place(other)))
            reach = 0.5 * max(row.length_mm or 0.0, other.length_mm or 0.0)
            if away < reach and (row.kind in _RAISED) == (other.kind in _RAISED):
                found.append((away, k, other.defect_id))
    return found


def _place(defect: Defect) -> Array:
    return np.array([defect.x_panel_mm, defect.y_panel_mm, defect.z_panel_mm], float)
