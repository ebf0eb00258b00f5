"""The kinds of features that are measured, declared once; every room reads them here.

Tables and views, ids, limits, verdicts, overlay, reports and pages follow from these declarations. They are dataclasses
and strings alone, so that reading them costs nothing: what a kind needs of other modules is named "module:name" and
loaded where it is used. docs/kinds.md says how to add a kind.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from metrology.results import Feature


@dataclass(frozen=True)
class LimitName:
    """A limit that a zone of a panel specification may have.

    Attributes
    ----------
    name : str
        Its key in a zone, with the unit.
    title : str
        For people, with the unit.
    amount : bool
        Whether it is an upper limit of the value's amount alone.
    """

    name: str
    title: str
    amount: bool = False


@dataclass(frozen=True)
class Quantity:
    """A measured quantity of a kind.

    Attributes
    ----------
    name : str
        In messages, addresses and charts; no other quantity of any kind has it.
    column, u95_column : str
        Of the value and of its expanded uncertainty.
    unit, title : str
        For people.
    limits : tuple of LimitName
        What a zone may ask of it. The first is of the value itself.
    signed : bool
        Whether the value has a direction, so that its sign is written.
    word : str
        What reports and the projector call it; its name where nothing is given.
    projected : bool
        Whether the projector writes it beside its feature.
    rests_on_it : tuple of str
        Further columns that say nothing without it.
    into_wind : str
        Column of the value as the air meets it, where that is what two of the limits are of: the second of what rises
        in the air's way, the third of what falls.
    not_of : tuple of (str, str or None)
        Columns and values of rows that have no such quantity: the edge of one sheet on another has no gap.
    """

    name: str
    column: str
    u95_column: str
    unit: str
    title: str
    limits: tuple[LimitName, ...]
    signed: bool = False
    word: str = ""
    projected: bool = True
    rests_on_it: tuple[str, ...] = ()
    into_wind: str = ""
    not_of: tuple[tuple[str, str | None], ...] = ()

    def lacking(self, row: Feature) -> bool:
        """Whether a row has no such quantity."""
        return any(getattr(row, column) == value for column, value in self.not_of)

    @property
    def said(self) -> str:
        """What reports and the projector call it."""
        return self.word or self.name


@dataclass(frozen=True)
class Cell:
    """A column of a report's table: a value, a value with its U95, or the range between two.

    Attributes
    ----------
    head : str
        With the unit.
    columns : tuple of str
        One; or the value's and its U95's; or the least's and the greatest's where `span`.
    digits : int
    signed, span : bool
    """

    head: str
    columns: tuple[str, ...]
    digits: int = 3
    signed: bool = False
    span: bool = False


@dataclass(frozen=True)
class Count:
    """A column of `scenes` that counts a kind: its rows, those that were found, or the different names among them."""

    column: str
    meaning: str
    of: Literal["rows", "found", "names"] = "found"


@dataclass(frozen=True)
class Kind:
    """A kind of feature.

    Attributes
    ----------
    name : str
        As decisions and findings name it.
    table, row : str
        Its table, and the dataclass of a row ("module:name").
    one, many : str
        What a row is of, for people: "position along a seam", "seam positions".
    id_columns : tuple of str
        The column of its name, and where a name has several places, the column of the position, mm.
    point, pixel : str
        What x, y, z are of; what u, v are of.
    quantities : tuple of Quantity
        The first is the one that findings are sorted by.
    counts : tuple of Count
    per_panel : tuple of str
        Columns of the view `panel_summary` beside the numbers of rows and of those failing, as SQL.
    subject : str
        What bears the name, as trends follow it: a seam for its positions.
    parameter : str
        As addresses of pages name it.
    verdict : str
        A function of a row that judges it by something else than limits ("module:name"); "" where nothing else counts.
    unlimited : str
        A function of a row that no limit of its zone judges ("module:name"); "" where such a row is in order.
    note : str
        A function of a row that gives what the projector writes behind its values; "" where there is nothing to say.
    measure : str
        A function that finds and measures the kind, as a step of its own after the rivets, the seams and the kinds
        before it ("module:name"): from a `metrology.sighted.Sighted`, and its block of the settings (None where there
        is none), to rows. "" for rivets and seams, whose steps come first.
    settings : str
        Name of that block; "" for the name of the table.
    cells : tuple of Cell
        What reports have in a row between its name and its zone; its quantities where nothing is given.
    size : tuple of str
        Columns of its extent, mm. The largest is the ring that the projector draws; rows of two scans nearer than half
        of it are of one feature of the panel.
    along : str
        Column of the direction of its length in the left image, degrees, where it is longer than wide: pictures show
        the ellipse of `major_px` and `minor_px`, and the projector an arrow along it.
    """

    name: str
    table: str
    row: str
    one: str
    many: str
    id_columns: tuple[str, ...]
    point: str
    quantities: tuple[Quantity, ...]
    counts: tuple[Count, ...]
    pixel: str = "that point"
    per_panel: tuple[str, ...] = ()
    subject: str = ""
    parameter: str = ""
    verdict: str = ""
    unlimited: str = ""
    note: str = ""
    measure: str = ""
    settings: str = ""
    cells: tuple[Cell, ...] = ()
    size: tuple[str, ...] = ()
    along: str = ""

    @property
    def is_course(self) -> bool:
        """Whether its rows are positions along something that bears the name."""
        return len(self.id_columns) > 1

    @property
    def shown(self) -> tuple[Cell, ...]:
        """What reports have in a row between its name and its zone."""
        return self.cells or tuple(
            Cell(f"{q.said} {q.unit}", (q.column, q.u95_column), signed=q.signed) for q in self.quantities
        )

    @property
    def row_type(self) -> type[Feature]:
        """The dataclass of a row."""
        row: type[Feature] = load(self.row)
        return row

    @property
    def id_sql(self) -> str:
        """SQL for the id of a row within its scene."""
        name, *positions = self.id_columns
        return " || '@' || ".join([name, *(f"printf('%.1f', {position})" for position in positions)])

    def names(self, rows: Iterable[Feature]) -> set[str]:
        """The different names among rows: of seams, where the rows are positions along them."""
        return {getattr(row, self.id_columns[0]) for row in rows}

    def id_of(self, row: Feature | Mapping[str, Any]) -> str:
        """The id of a row within its scene, such as ``R12``, or ``S1@24.0`` for a position along a seam."""
        name, *positions = [row[c] if isinstance(row, Mapping) else getattr(row, c) for c in self.id_columns]
        return "@".join([str(name), *(f"{position:.1f}" for position in positions)])


def load(name: str) -> Any:
    """What "module:name" names."""
    module, _, attribute = name.partition(":")
    return getattr(import_module(module), attribute)


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
    counts=(Count("n_holes", "open holes, missing and temporary fasteners found, without unconfirmed ones"),),
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
            rests_on_it=("width_to_depth", "width_to_depth_u95", "length_to_depth", "volume_mm3"),
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
            "bottom radius", "bottom_radius_mm", "bottom_radius_u95_mm", "mm", "Least radius at a defect's bottom",
            (LimitName("defect_bottom_radius_mm", "least radius at the bottom of a defect, mm"),), projected=False,
            not_of=(("bottom_radius_mm", None),),
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
    counts=(Count("n_defects", "dents, bumps, creases and scratches found"),),
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
        Cell("straight-edge mm", ("straight_edge_depth_mm",), 3),
        Cell("length mm", ("length_mm", "length_u95_mm"), 1),
        Cell("width mm", ("width_mm", "width_u95_mm"), 1),
        Cell("width/depth", ("width_to_depth",), 0),
        Cell("radius mm", ("bottom_radius_mm",), 0),
    ),
)  # fmt: skip

KINDS = (RIVET, SEAM_STATION, HOLE, DEFECT)
"""In the order in which tables, reports and pages show them."""

BY_NAME = {kind.name: kind for kind in KINDS}
LIMITS = {limit.name: limit for kind in KINDS for quantity in kind.quantities for limit in quantity.limits}
"""Everything that a zone may ask, by its key."""
