"""Rows of an assembled panel's own tables; their fields say what the columns mean."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated


@dataclass(frozen=True)
class StationRow:
    """One row of `panel_stations`."""

    station: Annotated[str, "placement of the rig in front of the panel"]
    station_scene_id: Annotated[str, "the scan of that station that is in the panel"]
    station_run_id: Annotated[str, "the run of that scan"]
    part: Annotated[
        int | None, "part of the panel, from 1: places of different parts have no common frame; NULL: left out"
    ]
    frame: Annotated[str | None, "specification, where the part lies in its frame, or own"] = None
    rotation: Annotated[tuple[float, ...] | None, "R of x_panel = R x_rig + t, row by row"] = None
    x_mm: Annotated[float | None, "the left camera's centre in the panel's frame, mm"] = None
    y_mm: Annotated[float | None, "the left camera's centre in the panel's frame, mm"] = None
    z_mm: Annotated[float | None, "the left camera's centre in the panel's frame, mm"] = None
    place_u95_mm: Annotated[
        float | None, "expanded uncertainty (95 %) of the placement at its field's worst place, mm"
    ] = None
    reason: Annotated[str | None, "why the scan was left out"] = None


@dataclass(frozen=True)
class DifferenceRow:
    """One row of `panel_differences`: what two scans of a panel say of one quantity of one feature."""

    feature_kind: Annotated[str, "kind of the feature"]
    feature_id: Annotated[str, "its name in the panel's tables"]
    quantity: Annotated[str, "what was measured twice"]
    unit: Annotated[str, "of the values"]
    first_scene_id: Annotated[str, "the scan with the smaller uncertainty"]
    second_scene_id: Annotated[str, "the other scan"]
    first_value: Annotated[float, "value of the first scan"]
    second_value: Annotated[float, "value of the second scan"]
    difference: Annotated[float, "second minus first"]
    difference_u95: Annotated[float, "expanded uncertainty (95 %) of the difference"]
    beyond: Annotated[bool, "whether the scans differ by more than that"]
