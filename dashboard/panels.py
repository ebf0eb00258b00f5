"""One assembled panel as the pages need it, and the way from its features to the scans that measured them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import streamlit as st

from dashboard.data import Archive
from dashboard.figures.scene import SceneFeatures
from dashboard.pictures import masked_uri, shrunk
from dashboard.scenes import load_features, load_scene_row
from metrology.arrays import Array
from metrology.assembly.picture import Stitched
from metrology.errors import StoreError
from metrology.kinds import BY_NAME, KINDS
from metrology.panel import points_along
from storage.archive.bundle import MANIFEST
from storage.archive.schema import (
    PANEL_COVERAGE,
    PANEL_FINDINGS,
    PANEL_OF_KIND,
    PANEL_RULES,
    PANEL_STATIONS,
    PANEL_VERDICTS,
    PANELS,
    Table,
)
from storage.documents import read_json
from storage.panel_picture import stored_pictures
from storage.panel_spec import locations_of
from storage.review import Feature

_PICTURE_PX = 1600
_ALONG = 20  # places of a stretch
_SAME_MM = 5.0  # a scan's feature this near to the panel's is the same one; neighbours are farther apart


@dataclass(frozen=True)
class PanelView:
    """An assembled panel."""

    row: Any
    """Of the table `panels`."""
    features: SceneFeatures
    """Rows of the panel by the names of the kinds, with `feature_id`; u_px, v_px are mm in the panel's frame, v
    downwards, as pictures are drawn."""
    findings: pd.DataFrame
    coverage: pd.DataFrame
    rules: pd.DataFrame
    stations: pd.DataFrame
    verdicts: pd.DataFrame
    """findings, coverage, rules, stations, verdicts: of the tables of the panel."""

    @property
    def parts(self) -> list[str]:
        """Names of the parts that have no common frame, such as "part 1 (S1, S2)"."""
        placed = self.stations[self.stations["part"].notna()]
        stations = placed.groupby(placed["part"].astype(int))["station"].agg(", ".join)
        return [f"part {part} ({named})" for part, named in stations.items()]

    def of_part(self, number: int) -> PanelView:
        """One part, counted from 1; findings and coverage stay those of the whole panel."""
        features = {name: rows[rows["part"].fillna(1) == number] for name, rows in self.features.items()}
        return replace(self, features=features)


@dataclass(frozen=True)
class InScan:
    """A panel's feature as one scan has it: the row of `scenes`, what was found there, and its name there."""

    scene: Any
    features: SceneFeatures
    feature: Feature


def panel_names(archive: Archive) -> pd.DataFrame:
    """Panels that have scans, the newest first: aircraft_serial, panel, last_scan."""
    return archive.rows(
        "SELECT aircraft_serial, panel, max(captured_at) AS last_scan FROM latest_scenes GROUP BY ALL "
        "ORDER BY last_scan DESC, aircraft_serial, panel"
    )


def load_panel(archive: Archive, aircraft: str, panel: str) -> PanelView | None:
    """The newest assembly of a panel; None where it was never put together."""

    def names(table: Table) -> str:
        return ", ".join(column.name for column in table.columns)

    found = archive.rows(
        f"SELECT {names(PANELS)} FROM {PANELS.name} WHERE aircraft_serial = ? AND panel = ?", [aircraft, panel]
    )
    whole: Any = next(found.itertuples(), None)
    if whole is None:
        return None

    def rows(table: Table, more: str = "", order: str = "ALL") -> pd.DataFrame:
        # The time adds nothing but speed: rows lie about in its order, so most of a table need not be looked at.
        return archive.rows(
            f"SELECT {names(table)}{more} FROM {table.name} WHERE captured_at = ? AND scene_id = ? ORDER BY {order}",
            [whole.captured_at.to_pydatetime(), str(whole.scene_id)],
        )

    features = {
        kind.name: _drawable(rows(PANEL_OF_KIND[kind.name], f", {kind.id_sql} AS feature_id")) for kind in KINDS
    }
    return PanelView(
        whole, features, rows(PANEL_FINDINGS), rows(PANEL_COVERAGE), rows(PANEL_RULES), rows(PANEL_STATIONS),
        rows(PANEL_VERDICTS, order="judged_at"),
    )  # fmt: skip


def _drawable(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows as figures of pictures take them: millimetres of the panel stand for pixels."""
    numbers = rows.select_dtypes("number")
    if np.isinf(numbers.to_numpy(float)).any():
        numbers = numbers.replace([np.inf, -np.inf], np.nan)
        rows = rows.assign(**{name: numbers[name] for name in numbers})
    places = {"u_px": rows["x_panel_mm"].astype(float), "v_px": -rows["y_panel_mm"].astype(float)}
    if "diameter_mm" in rows:
        places |= {"major_px": rows["diameter_mm"], "minor_px": rows["diameter_mm"]}
        places["angle_deg"] = pd.Series(0.0, rows.index)
    return pd.concat([rows.drop(columns=[name for name in places if name in rows]), pd.DataFrame(places)], axis=1)


@dataclass(frozen=True)
class PanelPicture:
    """The stitched picture of a part, and the same small enough for a page, as a URI."""

    stitched: Stitched
    uri: str


def locations(archive: Archive, view: PanelView) -> dict[str, str]:
    """Where features are on the aircraft (frame, stringer), by their names, where the specification says it."""
    return locations_of(_judged_by(str(archive.file(f"{view.row.bundle_path}/{MANIFEST}"))))


def airflows(archive: Archive, view: PanelView) -> dict[str, tuple[float, float]]:
    """Where the air flows over each seam, in x and y of the panel, where the specification says it."""
    spec = _judged_by(str(archive.file(f"{view.row.bundle_path}/{MANIFEST}")))
    flows = {str(seam["id"]): seam.get("airflow") for seam in spec.get("seams") or ()}
    return {name: (float(flow[0]), float(flow[1])) for name, flow in flows.items() if flow}


def with_courses(archive: Archive, view: PanelView) -> PanelView:
    """The view with `course` in its coverage: places (n, 3) along each stretch of a nominal seam, None of all else."""
    spec = _judged_by(str(archive.file(f"{view.row.bundle_path}/{MANIFEST}")))
    courses = {str(seam["id"]): seam["course_mm"] for seam in spec.get("seams") or ()}
    along = [
        points_along(courses[name], np.linspace(row.from_mm, row.to_mm, _ALONG))
        if (name := str(row.feature_id).split("@")[0]) in courses and pd.notna(row.from_mm)
        else None
        for row in view.coverage.itertuples()
    ]
    return replace(view, coverage=view.coverage.assign(course=pd.Series(along, view.coverage.index, dtype=object)))


@st.cache_resource(max_entries=20, show_spinner=False)
def _judged_by(manifest: str) -> dict[str, Any]:
    """The document of the specification that a run was judged by."""
    return read_json(Path(manifest), StoreError).get("panel_spec") or {}


def stitched_pictures(archive: Archive, view: PanelView) -> dict[int, PanelPicture]:
    """The pictures by the number of the part; none where the run is of a version that made none."""
    return _stitched(f"{view.row.bundle_path}/{MANIFEST}", archive)


@st.cache_resource(max_entries=4, show_spinner=False)
def _stitched(manifest: str, _archive: Archive) -> dict[int, PanelPicture]:
    return {part: _for_page(found) for part, found in stored_pictures(_archive.file, manifest).items()}


def _for_page(found: Stitched) -> PanelPicture:
    grey = shrunk(found.grey, _PICTURE_PX)
    seen = cv2.resize(found.seen.astype(np.uint8), grey.shape[::-1], interpolation=cv2.INTER_AREA) > 0
    return PanelPicture(found, masked_uri(grey, seen))


def in_scan(archive: Archive, view: PanelView, feature: Feature, scene_id: str | None = None) -> InScan | None:
    """A panel's feature as a scan has it, by default the scan that measured it best; None where it has none there.

    Names of the panel are not those of its scans: the feature is the one at the same place.
    """
    rows = view.features[feature.kind]
    found = next(rows[rows["feature_id"] == feature.id].itertuples(), None)
    scene_id = scene_id or (str(found.best_scene_id) if found is not None else None)
    placed = view.stations[view.stations["station_scene_id"] == scene_id]
    scene = load_scene_row(archive, scene_id) if scene_id else None
    if found is None or scene is None or placed.empty or placed.iloc[0]["rotation"] is None:
        return None
    features = load_features(archive, scene)
    there = features[feature.kind]
    R = np.array(list(placed.iloc[0]["rotation"]), float).reshape(3, 3)
    t = placed.iloc[0][["x_mm", "y_mm", "z_mm"]].to_numpy(float)
    at = R.T @ (np.array([found.x_panel_mm, found.y_panel_mm, found.z_panel_mm], float) - t)
    name = name_at(there, ["x_mm", "y_mm", "z_mm"], at)
    return None if name is None else InScan(scene, features, Feature(feature.kind, name))


def name_at(rows: pd.DataFrame, place: list[str], at: Array) -> str | None:
    """The name of the feature at a place (3,), mm, by the columns that hold theirs; None where none is near enough."""
    away = np.linalg.norm(rows[place].to_numpy(float) - at, axis=1)
    if not np.isfinite(away).any() or np.nanmin(away) > _SAME_MM:
        return None
    return str(rows["feature_id"].iloc[int(np.nanargmin(away))])


def of_finding(view: PanelView, finding: Any) -> Feature:
    """The feature that a finding or a change is shown by: itself, or the worst position of a stretch."""
    kind, feature_id = BY_NAME[finding.feature_kind], str(finding.feature_id)
    rows = view.features[kind.name]
    if not kind.is_course or rows.empty or pd.isna(finding.x_panel_mm):
        return Feature(kind.name, feature_id)
    course = rows[rows[kind.id_columns[0]] == feature_id.split("@")[0]]
    away = np.hypot(course["x_panel_mm"] - finding.x_panel_mm, course["y_panel_mm"] - finding.y_panel_mm)
    nearest = str(course["feature_id"].loc[away.idxmin()]) if away.notna().any() else feature_id
    return Feature(kind.name, nearest)
