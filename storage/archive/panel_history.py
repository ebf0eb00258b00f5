"""The assemblies of a panel before the one that is made now."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from metrology.assembly.carried import Former, Known, own_frame, pattern_frame, places_of
from metrology.errors import StoreError
from metrology.kinds import KINDS
from metrology.panel import Placement
from metrology.results import PanelKey
from storage.archive.bundle import MANIFEST
from storage.archive.panel_bundle import REMEMBERED, SIDES
from storage.archive.panel_scans import scan_of
from storage.archive.rows import result_of
from storage.archive.schema import PANEL_OF_KIND, PANEL_STATIONS, PANELS
from storage.archive.store import Store
from storage.documents import read_json
from storage.panel_spec import panel_spec_from

Row = Mapping[str, Any]


def former_assembly(store: Store, key: PanelKey) -> Former | None:
    """The newest assembly that is stored: its frames, its names, and those of earlier ones that it kept."""

    def rows(table: str) -> list[Row]:
        found: list[Row] = store.query(f"FROM {table} WHERE scene_id = ?", [key.panel_id]).to_pylist()
        return found

    panel = next(iter(rows(PANELS.name)), None)
    if panel is None:
        return None
    manifest = read_json(store.file(f"{panel['bundle_path']}/{MANIFEST}"), StoreError)
    stations = [row for row in rows(PANEL_STATIONS.name) if row["part"] is not None]
    scans = {row["station_scene_id"]: (row["station"], row["part"], placement_of(row)) for row in stations}
    names = {kind.name: _known(manifest.get(REMEMBERED, {}).get(kind.name, {})) for kind in KINDS}
    sides = manifest.get(SIDES, {})
    for kind in KINDS:
        found = rows(PANEL_OF_KIND[kind.name].name)
        for part in {row["part"] for row in found}:
            features = [result_of(kind.row_type, row) for row in found if row["part"] == part]
            names[kind.name] |= {
                name: Known(part, places, sides.get(kind.name, {}).get(name, 0.0))
                for name, places in places_of(kind, features).items()
            }
    return Former(scans, frames_of(stations, manifest), names, partial(scan_of, store))


def placement_of(row: Row) -> Placement:
    """Where a scan lies, from its row of `panel_stations`."""
    return Placement(np.reshape(row["rotation"], (3, 3)), np.array([row["x_mm"], row["y_mm"], row["z_mm"]]))


def frames_of(stations: Sequence[Row], manifest: Row) -> dict[int, str]:
    """The name of each part's frame; of runs that kept none, what it would have been."""
    frames: dict[int, str] = {}
    for row in sorted(stations, key=lambda row: str(row["station"])):
        if row["part"] is None or row["part"] in frames:
            continue
        if row.get("frame_id"):
            frames[row["part"]] = row["frame_id"]
        elif row["frame"] == "specification":
            frames[row["part"]] = pattern_frame(panel_spec_from(manifest["panel_spec"], Path(MANIFEST)).layout)
        else:
            frames[row["part"]] = own_frame(row["station_scene_id"], placement_of(row))
    return frames


def _known(document: Row) -> dict[str, Known]:
    return {
        name: Known(int(each["part"]), np.array(each["places"], float), float(each["side"]))
        for name, each in document.items()
    }
