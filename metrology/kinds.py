"""The kinds of features that are measured, declared once; every room reads them here.

Tables and views, ids, limits, verdicts, overlay, reports and pages follow from these declarations. docs/kinds.md says
how to add a kind.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from metrology.kind import Cell, Count, Graded, Kind, LimitName, Quantity, load

if TYPE_CHECKING:
    from metrology.results import Feature

__all__ = [
    "BY_NAME", "DEFECT", "HOLE", "KINDS", "LIMITS", "RIVET", "SEAM_STATION", "WAVINESS",
    "Cell", "Count", "Graded", "Kind", "LimitName", "Quantity", "counted", "load",
]  # fmt: skip

RIVET = Kind(
    name="rivet",
    table="rivets",
    row="metrology.results:Rivet",
    one="rivet",
    many="rivets",
    id_columns=("rivet_id",),
    point="centre of the head",
    pixel="the head's centre",
    quantities=(
        Quantity(
            "height", "height_mean_mm", "height_u95_mm", "mm", "Rivet height",
            (LimitName("height_mm", "rivet height, mm"),), signed=True,
            rests_on_it=("height_min_mm", "height_max_mm", "crown_mm"),
        ),
        Quantity(
            "tilt", "tilt_deg", "tilt_u95_deg", "°", "Rivet tilt",
            (LimitName("tilt_deg", "rivet tilt, °"),), projected=False, rests_on_it=("height_min_mm", "height_max_mm"),
        ),
    ),
    counts=(Count("n_rivets", "rivets found, without unconfirmed ones"),),
    per_panel=(
        "count(*) FILTER (decision = 'not measured') AS n_rivets_not_measured",
        "max(abs(height_mean_mm)) AS height_worst_mm",
        "avg(height_mean_mm) AS height_mean_mm",
    ),
    subject="rivet",
    by_design=True,
    parameter="rivet",
    verdict="metrology.fastener:size_finding",
    note="metrology.fastener:size_note",
    size=("diameter_mm",),
    cells=(
        Cell("diameter mm", ("diameter_mm",), 2),
        Cell("height mm", ("height_mean_mm", "height_u95_mm"), 4, signed=True),
        Cell("min … max mm", ("height_min_mm", "height_max_mm"), 3, signed=True, span=True),
        Cell("tilt °", ("tilt_deg", "tilt_u95_deg"), 2),
    ),
)  # fmt: skip

SEAM_STATION = Kind(
    name="seam station",
    table="seam_stations",
    row="metrology.results:SeamStation",
    one="position along a seam",
    many="seam positions",
    id_columns=("seam_id", "s_mm"),
    point="middle between the ideal edges",
    quantities=(
        Quantity(
            "step", "step_mm", "step_u95_mm", "mm", "Seam step",
            (
                LimitName("step_mm", "seam step, mm"),
                LimitName("step_into_wind_mm", "seam step into the wind, mm", amount=True),
                LimitName("step_out_of_wind_mm", "seam step out of the wind, mm", amount=True),
            ),
            signed=True, rests_on_it=("step_into_wind_mm",), into_wind="step_into_wind_mm",
        ),
        Quantity(
            "width", "width_mm", "width_u95_mm", "mm", "Seam gap",
            (LimitName("width_mm", "seam gap, mm"),), word="gap", not_of=(("joint", "lap"),),
        ),
    ),
    counts=(
        Count("n_seams", "seams found", of="names"),
        Count("n_stations", "positions measured along seams", of="rows"),
    ),
    per_panel=("max(abs(step_mm)) AS step_worst_mm", "max(width_mm) AS width_worst_mm"),
    subject="seam",
    by_design=True,
    parameter="station",
    cells=(
        Cell("at mm", ("s_mm",), 0),
        Cell("step mm", ("step_mm", "step_u95_mm"), 3, signed=True),
        Cell("into the wind mm", ("step_into_wind_mm",), 3, signed=True),
        Cell("gap mm", ("width_mm", "width_u95_mm"), 3),
    ),
)  # fmt: skip

HOLE = Kind(
    name="hole",
    table="holes",
    row="metrology.results:Hole",
    one="hole",
    many="holes",
    id_columns=("hole_id",),
    point="middle of the hole at the skin",
    quantities=(
        Quantity(
            "hole diameter", "diameter_mm", "diameter_u95_mm", "mm", "Hole diameter",
            (LimitName("hole_diameter_mm", "hole diameter, mm"),),
        ),
    ),
    counts=(Count("n_holes", "open and filled holes, missing and temporary fasteners, without unconfirmed ones"),),
    subject="hole",
    parameter="hole",
    verdict="metrology.holes.verdict:hole_finding",
    unlimited="metrology.holes.verdict:unexpected_hole",
    note="metrology.holes.verdict:hole_note",
    measure="metrology.holes.measure:measure_sighted",
    settings="rivets",
    size=("diameter_mm", "countersink_diameter_mm"),
    cells=(
        Cell("kind", ("kind",)),
        Cell("diameter mm", ("diameter_mm", "diameter_u95_mm"), 2),
        Cell("countersink mm", ("countersink_diameter_mm", "countersink_diameter_u95_mm"), 2),
    ),
)  # fmt: skip

DEFECT = Kind(
    name="defect",
    table="defects",
    row="metrology.defects.row:Defect",
    one="defect of the skin",
    many="defects of the skin",
    id_columns=("defect_id",),
    point="deepest (of a bump, highest) point",
    quantities=(
        Quantity(
            "defect depth", "depth_mm", "depth_u95_mm", "mm", "Depth of a dent (bump: negative)",
            (LimitName("defect_depth_mm", "depth of a defect, mm (bump: negative)"),), signed=True, word="depth",
            rests_on_it=(
                "width_to_depth", "width_to_depth_u95", "length_to_depth", "length_to_depth_u95", "volume_mm3"
            ),
            by_extent=Graded(
                LimitName("defect_depth_by_width_mm", "depth of a defect by its width, mm", amount=True, graded=True),
                "width_mm", "width_u95_mm", "width",
            ),
        ),
        Quantity(
            "straight-edge depth", "straight_edge_depth_mm", "straight_edge_depth_u95_mm", "mm",
            "Depth of a dent under a straight-edge",
            (LimitName("defect_straight_edge_depth_mm", "depth of a dent under a straight-edge, mm"),),
            projected=False, not_of=(("straight_edge_depth_mm", None),),
        ),
        Quantity(
            "defect length", "length_mm", "length_u95_mm", "mm", "Length of a defect",
            (LimitName("defect_length_mm", "length of a defect at half depth, mm"),), word="length", projected=False,
        ),
        Quantity(
            "defect width", "width_mm", "width_u95_mm", "mm", "Width of a defect",
            (LimitName("defect_width_mm", "width of a defect at half depth, mm"),), word="width", projected=False,
        ),
        Quantity(
            "width over depth", "width_to_depth", "width_to_depth_u95", "", "Width of a defect over its depth",
            (LimitName("defect_width_to_depth", "width of a defect over its depth"),), projected=False,
            not_of=(("width_to_depth", None),),
        ),
        Quantity(
            "length over depth", "length_to_depth", "length_to_depth_u95", "", "Length of a defect over its depth",
            (LimitName("defect_length_to_depth", "length of a defect over its depth"),), projected=False,
            not_of=(("length_to_depth", None),),
        ),
        Quantity(
            "bottom radius", "bottom_radius_mm", "bottom_radius_u95_mm", "mm", "Least radius at a defect's bottom",
            (LimitName("defect_bottom_radius_mm", "least radius at the bottom of a defect, mm"),), projected=False,
        ),
        Quantity(
            "fastener distance", "fastener_distance_mm", "distance_u95_mm", "mm", "Defect to the nearest fastener",
            (LimitName("defect_fastener_distance_mm", "distance of a defect from the nearest fastener, mm"),),
            projected=False, not_of=(("fastener_distance_mm", None),),
        ),
        Quantity(
            "seam distance", "seam_distance_mm", "distance_u95_mm", "mm", "Defect to the nearest seam",
            (LimitName("defect_seam_distance_mm", "distance of a defect from the nearest seam, mm"),),
            projected=False, not_of=(("seam_distance_mm", None),),
        ),
    ),
    without=(("kind", "deposit"),),  # limits speak of the skin
    counts=(Count("n_defects", "dents, bumps, creases, scratches and deposits found"),),
    per_panel=("max(abs(depth_mm)) AS depth_worst_mm",),
    subject="defect",
    parameter="defect",
    verdict="metrology.defects.verdict:defect_finding",
    unlimited="metrology.defects.verdict:unlimited_defect",
    note="metrology.defects.verdict:defect_note",
    size=("length_mm", "foot_length_mm"),
    along="direction_deg",
    measure="metrology.defects.measure:measure_defects",
    cells=(
        Cell("kind", ("kind",)),
        Cell("depth mm", ("depth_mm", "depth_u95_mm"), 3, signed=True),
        Cell("straight-edge mm", ("straight_edge_depth_mm", "straight_edge_depth_u95_mm"), 3),
        Cell("length mm", ("length_mm", "length_u95_mm"), 1),
        Cell("width mm", ("width_mm", "width_u95_mm"), 1),
        Cell("width/depth", ("width_to_depth",), 0),
        Cell("radius mm", ("bottom_radius_mm",), 0),
    ),
)  # fmt: skip

WAVINESS = Kind(
    name="waviness",
    table="waviness",
    row="metrology.waviness.row:Waviness",
    one="waviness of a piece of skin",
    many="waviness of the skin",
    id_columns=("waviness_id",),
    point="place of the greatest gap under the straight-edge",
    quantities=(
        Quantity(
            "waviness", "waviness_mm", "waviness_u95_mm", "mm", "Waviness of the skin",
            (LimitName("waviness_mm", "waviness of the skin under a straight-edge, mm"),),
        ),
    ),
    counts=(Count("n_waviness", "pieces of skin and directions whose waviness was asked for", of="rows"),),
    per_panel=("max(waviness_mm) AS waviness_worst_mm",),
    subject="straight-edge",
    parameter="waviness",
    measure="metrology.waviness.measure:measure_waviness",
    on_request=True,
    cells=(
        Cell("direction", ("direction",)),
        Cell("straight-edge mm", ("edge_mm",), 0),
        Cell("waviness mm", ("waviness_mm", "waviness_u95_mm"), 3),
    ),
)  # fmt: skip

KINDS = (RIVET, SEAM_STATION, HOLE, DEFECT, WAVINESS)
"""In the order in which tables, reports and pages show them."""

BY_NAME = {kind.name: kind for kind in KINDS}
LIMITS = {limit.name: limit for kind in KINDS for quantity in kind.quantities for limit in quantity.all_limits}
"""Everything that a zone may ask, by its key."""


def counted(features: Mapping[str, Sequence[Feature]]) -> dict[str, int]:
    """The columns of `scenes` that count features, from the rows of each kind by its name."""
    return {column: n for kind in KINDS for column, n in kind.counted(features.get(kind.name, ())).items()}
