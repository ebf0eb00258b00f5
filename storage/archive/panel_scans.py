"""The newest scans of an aircraft's panel, as their assembly takes them."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrology.assembly.scan import PanelScan, Skin
from metrology.errors import StoreError
from metrology.kinds import KINDS
from metrology.panel import PanelLayout, Placement
from metrology.results import PanelKey, SceneKey
from metrology.tolerance import as_measured
from storage.archive.bundle import FITS, MANIFEST, RIG
from storage.archive.rows import result_of
from storage.archive.store import Store
from storage.cloud import read_cloud
from storage.documents import read_json
from storage.fits import read_fits
from storage.frames import read_preview
from storage.panel_spec import panel_spec_from
from storage.rig import load_rig

Features = dict[str, list[Any]]


@dataclass(frozen=True)
class ScanOfPanel:
    """A scan, the run that it is taken from, and what its left camera saw."""

    scan: PanelScan
    run_id: str
    texture: NDArray[np.uint8]


def features_of(store: Store, scenes: Sequence[str]) -> dict[str, dict[str, list[Any]]]:
    """Each scan's features by kind, as its current run has them, in the order of their ids."""
    found: dict[str, dict[str, list[Any]]] = {scene: {kind.name: [] for kind in KINDS} for scene in scenes}
    asked = ", ".join("?" * len(scenes))
    for kind in KINDS:
        for row in store.query(f"FROM {kind.table} WHERE scene_id IN ({asked}) ORDER BY ALL", scenes).to_pylist():
            found[row["scene_id"]][kind.name].append(result_of(kind.row_type, row))
    return found


def panels_of(store: Store) -> list[PanelKey]:
    """Panels that have scans."""
    rows = store.query("SELECT DISTINCT aircraft_serial, panel FROM scenes ORDER BY ALL").to_pylist()
    return [PanelKey(**row) for row in rows]


def newest_scans(store: Store, key: PanelKey, layout: PanelLayout | None = None) -> list[ScanOfPanel]:
    """The newest scan of each of a panel's stations, in the order of their names.

    Parameters
    ----------
    layout : PanelLayout, optional
        The pattern of the specification; scans that were recognised in it keep their placement.
    """
    with contextlib.closing(store.connect()) as connection:
        found = connection.execute(
            "SELECT aircraft_serial, panel, station, captured_at, run_id FROM latest_scenes "
            "WHERE aircraft_serial = ? AND panel = ? ORDER BY station",
            [key.aircraft_serial, key.panel],
        ).fetchall()
    if not found:
        known = ", ".join(map(str, panels_of(store)[:5])) or "none"
        raise StoreError(f"{store.root}: found no scan of {key}, expected one of: {known}")
    keys = [SceneKey(*row[:4]) for row in found]
    features = _features(store, [each.scene_id for each in keys])
    with ThreadPoolExecutor(2) as readers:
        return list(
            readers.map(lambda each, row: _loaded(store, each, row[4], features[each.scene_id], layout), keys, found)
        )


def scan_of(store: Store, scene_id: str) -> PanelScan | None:
    """A scan as an assembly takes it; None where the archive does not have it, or not whole, any more."""
    rows = store.query(
        "SELECT aircraft_serial, panel, station, captured_at, run_id FROM scenes WHERE scene_id = ?", [scene_id]
    ).to_pylist()
    with contextlib.suppress(StoreError):
        for row in rows:
            run = row.pop("run_id")
            return _loaded(store, SceneKey(**row), run, _features(store, [scene_id])[scene_id], None).scan
    return None


def _loaded(store: Store, key: SceneKey, run_id: str, features: Features, layout: PanelLayout | None) -> ScanOfPanel:
    paths = store.paths(key.scene_id)
    manifest = read_json(paths.bundle / MANIFEST, StoreError)
    cloud = read_cloud(paths.cloud)
    scan = PanelScan(
        key,
        load_rig(paths.bundle / RIG),
        Skin.thinned(cloud.points, cloud.sigma_z),
        features,
        _across(paths.bundle / FITS),
        _nominal(manifest, paths.bundle / MANIFEST, layout),
    )
    return ScanOfPanel(scan, run_id, read_preview(paths.preview))


def _features(store: Store, scenes: Sequence[str]) -> dict[str, Features]:
    """Each scan's rows by kind, as they were measured, before they were judged."""
    return {
        scene: {kind.name: [as_measured(kind, row) for row in rows[kind.name]] for kind in KINDS}
        for scene, rows in features_of(store, scenes).items()
    }


def _across(path: Path) -> dict[tuple[str, float], NDArray[np.float64]]:
    """From side A to side B at each seam position that was measured; none in runs of older versions."""
    if not path.exists():
        return {}
    rows = read_fits(path).rows
    return {(r["feature_id"], round(r["s_mm"], 5)): np.array(r["axes"][:3]) for r in rows if r["s_mm"] is not None}


def _nominal(manifest: Mapping[str, Any], path: Path, layout: PanelLayout | None) -> Placement | None:
    """Where a scan lies in the specification's frame: it was recognised in the same pattern."""
    registration = manifest.get("registration") or {}
    if layout is None or layout.empty or registration.get("status") != "recognised":
        return None
    document = manifest.get("panel_spec") or {}
    if not (document.get("rivets") or document.get("seams")):
        return None  # recognised by a pattern that a scan of its station enrolled
    used = panel_spec_from(document, path).layout
    if (used.rivets, used.seams) != (layout.rivets, layout.seams):
        return None
    placement = registration["placement"]
    return Placement(placement["R"], placement["t_mm"])
