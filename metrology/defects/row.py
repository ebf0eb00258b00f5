"""A defect of the skin as it is stored: one row of `defects`."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Annotated, Literal

from metrology.results import Feature

DefectKind = Literal["dent", "bump", "crease", "scratch", "raised edge", "deposit"]

HiddenBy = Literal["view", "fastener", "seam", "points", "reference"]


@dataclass(frozen=True)
class Defect(Feature):
    """One row of `defects`. Outlines lie in the tangent plane of the skin at the deepest point."""

    defect_id: Annotated[str, "name of the defect in its scene, from the top of the left image down"]
    _: KW_ONLY
    kind: Annotated[
        DefectKind,
        "dent, bump, crease (a fold with a sharp bottom), scratch (narrow), raised edge (a bump at a seam), deposit (a "
        "chip, a drop or a sticker on the skin)",
    ]
    depth_mm: Annotated[
        float | None, "depth along the normal, mm: below the skin as it would be without it, negative above"
    ] = None
    depth_u95_mm: Annotated[float | None, "expanded uncertainty (95 %) of depth_mm, mm"] = None
    hidden_by: Annotated[
        HiddenBy | None,
        "what hides a part of it, so that depth, length and width are at least these: view (it runs out of it), "
        "fastener, seam, points (none where it is deepest), reference (the skin round it does not tell how far it "
        "reaches); NULL where all of it was seen",
    ] = None
    length_mm: Annotated[float | None, "extent of its outline at half depth where it is longest, mm"] = None
    length_u95_mm: Annotated[float | None, "expanded uncertainty (95 %) of length_mm, mm"] = None
    width_mm: Annotated[float | None, "extent of that outline at 90° to its length, mm"] = None
    width_u95_mm: Annotated[float | None, "expanded uncertainty (95 %) of width_mm, mm"] = None
    direction_deg: Annotated[float | None, "direction of its length in the left image, from +u towards +v, degrees"] = (
        None
    )
    major_px: Annotated[float | None, "extent of its outline at half depth along direction_deg, left image, px"] = None
    minor_px: Annotated[float | None, "extent of that outline at 90° to it, left image, px"] = None
    foot_length_mm: Annotated[float | None, "extent of its outline at a tenth of its depth where it is longest, mm"] = (
        None
    )
    foot_width_mm: Annotated[float | None, "extent of that outline at 90° to its length, mm"] = None
    straight_edge_depth_mm: Annotated[
        float | None,
        "greatest gap under a straight-edge laid over its deepest point in any direction, mm; NULL above",
    ] = None
    straight_edge_depth_u95_mm: Annotated[float | None, "expanded uncertainty (95 %) of straight_edge_depth_mm, mm"] = (
        None
    )
    area_mm2: Annotated[float | None, "area within its outline at half depth, mm²"] = None
    volume_mm3: Annotated[float | None, "volume between it and the skin, mm³; negative above"] = None
    width_to_depth: Annotated[float | None, "width over depth; NULL where a part is hidden"] = None
    width_to_depth_u95: Annotated[float | None, "expanded uncertainty (95 %) of width_to_depth"] = None
    length_to_depth: Annotated[float | None, "length over depth; NULL where a part is hidden"] = None
    length_to_depth_u95: Annotated[float | None, "expanded uncertainty (95 %) of length_to_depth"] = None
    bottom_radius_mm: Annotated[
        float | None, "least radius of curvature at its bottom, the skin's own left out, mm"
    ] = None
    bottom_radius_u95_mm: Annotated[float | None, "expanded uncertainty (95 %) of bottom_radius_mm, mm"] = None
    fastener_distance_mm: Annotated[
        float | None,
        "from its outline at half depth to the nearest fastener's rim, mm; 0 where they meet",
    ] = None
    seam_distance_mm: Annotated[
        float | None, "from its outline at half depth to the nearest seam's edge, mm; NULL without"
    ] = None
    distance_u95_mm: Annotated[float | None, "expanded uncertainty (95 %) of these distances, mm"] = None
