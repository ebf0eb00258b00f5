"""One cloud of an assembled panel: the points of all its scans in the panel's frame, thinned out, each place once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrology.errors import StoreError
from metrology.panel import Placement
from storage.archive.schema import PANEL_STATIONS
from storage.cloud import StoredCloud, read_cloud
from storage.export.formats import Place
from storage.export.subject import Subject
from storage.frames import read_preview
from storage.point_cloud import write_point_cloud

Row = Mapping[str, Any]
CELL_MM = 0.5
"""Edge of the cells that hold one point each; 300 × 200 mm of skin are then 240 000 points."""
_BITS = 21  # of a cell's number in each direction: a kilometre


def write_panel_ply(subject: Subject, place: Place) -> list[Path]:
    """PLY, millimetres, grey as colour; a file for each part of the panel, since parts have frames of their own."""
    stations: list[Row] = place.store.query(
        f"SELECT * FROM {PANEL_STATIONS.name} WHERE aircraft_serial = ? AND panel = ? AND part IS NOT NULL "
        "ORDER BY part, station",
        [subject.aircraft_serial, subject.panel],
    ).to_pylist()
    if not stations:
        raise StoreError(
            f"{place.store.root}: found no assembled panel {subject.aircraft_serial} {subject.panel}, expected one: "
            "'flushline panel assemble' first"
        )
    parts = {part: list(rows) for part, rows in groupby(stations, key=lambda row: row["part"])}
    written = []
    for part, rows in parts.items():
        points, grey = together(_placed(place, row) for row in rows)
        written.append(place.file(f"~panel{part if len(parts) > 1 else ''}.ply"))
        nothing = np.empty((1, 0), np.float32), np.empty((1, 0), np.uint16)
        write_point_cloud(written[-1], StoredCloud(points[None].astype(np.float32), *nothing), grey[None])
    return written


def together(
    clouds: Iterable[tuple[NDArray[np.float64], NDArray[np.uint8]]],
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Clouds of one frame as one, with one point in each cell: that of the first cloud that has one there.

    Parameters
    ----------
    clouds : iterable of ((n, 3), (n,))
        Points, mm, and their grey.
    """
    points, grey, taken = [np.empty((0, 3))], [np.empty(0, np.uint8)], np.empty(0, np.int64)
    for more, shades in clouds:
        cells = np.floor(more / CELL_MM).astype(np.int64) + (1 << (_BITS - 1))
        names = (cells[:, 0] << (2 * _BITS)) | (cells[:, 1] << _BITS) | cells[:, 2]
        names, first = np.unique(names, return_index=True)
        fresh = np.isin(names, taken, assume_unique=True, invert=True)
        points.append(more[first[fresh]])
        grey.append(shades[first[fresh]])
        taken = np.concatenate([taken, names[fresh]])
    return np.concatenate(points), np.concatenate(grey)


def _placed(place: Place, row: Row) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """A scan's points in the panel's frame, with their grey."""
    paths = place.store.paths(row["station_scene_id"])
    points, texture = read_cloud(paths.cloud).points, read_preview(paths.preview)
    valid = np.isfinite(points[..., 2])
    centre = np.array([row["x_mm"], row["y_mm"], row["z_mm"]])
    stands = Placement(np.reshape(row["rotation"], (3, 3)), centre)
    return stands.to_panel(points[valid]), texture[valid]
