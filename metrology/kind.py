"""What a kind of feature declares: its table and rows, its quantities with their limits, and how it is shown.

Dataclasses and strings alone, so that reading them costs nothing: what a kind needs of other modules is named
"module:name" and loaded where it is used.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Sized
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from metrology.results import Feature


@dataclass(frozen=True)
class LimitName:
    """A limit that a zone of a panel specification may have."""

    name: str
    """Its key in a zone, with the unit."""
    title: str
    """For people, with the unit."""
    amount: bool = False
    """Whether it is an upper limit of the value's amount alone."""
    graded: bool = False
    """Whether it goes with an extent of the feature (`metrology.limits.GradedLimit`)."""


@dataclass(frozen=True)
class Graded:
    """A limit that goes with an extent, the columns of the extent and of its U95, and what the extent is called."""

    limit: LimitName
    column: str
    u95_column: str
    word: str


@dataclass(frozen=True)
class Quantity:
    """A measured quantity of a kind."""

    name: str
    """In messages, addresses and charts; no other quantity of any kind has it."""
    column: str
    u95_column: str
    """column, u95_column: of the value and of its expanded uncertainty."""
    unit: str
    title: str
    """unit, title: for people."""
    limits: tuple[LimitName, ...]
    """What a zone may ask of it. The first is of the value itself."""
    signed: bool = False
    """Whether the value has a direction, so that its sign is written."""
    word: str = ""
    """What reports and the projector call it; its name where nothing is given."""
    projected: bool = True
    """Whether the projector writes it beside its feature."""
    rests_on_it: tuple[str, ...] = ()
    """Further columns that say nothing without it."""
    into_wind: str = ""
    """Column of the value as the air meets it, where that is what two of the limits are of: the second of what rises in
    the air's way, the third of what falls."""
    by_extent: Graded | None = None
    """A limit of its amount that goes with an extent; None where there is no such limit."""
    not_of: tuple[tuple[str, str | None], ...] = ()
    """Columns and values of rows that have no such quantity: the edge of one sheet on another has no gap."""

    @property
    def said(self) -> str:
        """What reports and the projector call it."""
        return self.word or self.name

    @property
    def all_limits(self) -> tuple[LimitName, ...]:
        """What a zone may ask of it, by an extent too."""
        return (*self.limits, *([self.by_extent.limit] if self.by_extent else ()))


@dataclass(frozen=True)
class Cell:
    """A column of a report's table: a value, a value with its U95, or the range between two."""

    head: str
    """With the unit."""
    columns: tuple[str, ...]
    """One; or the value's and its U95's; or the least's and the greatest's where `span`."""
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
    """A kind of feature."""

    name: str
    """As decisions and findings name it."""
    table: str
    row: str
    """table, row: its table, and the dataclass of a row ("module:name")."""
    one: str
    many: str
    """one, many: what a row is of, for people: "position along a seam", "seam positions"."""
    id_columns: tuple[str, ...]
    """The column of its name, and where a name has several places, the column of the position, mm."""
    point: str
    quantities: tuple[Quantity, ...]
    """The first is the one that findings are sorted by."""
    counts: tuple[Count, ...]
    without: tuple[tuple[str, str], ...] = ()
    """Columns and values of rows that have none of its quantities."""
    pixel: str = "that point"
    """point, pixel: what x, y, z are of; what u, v are of."""
    per_panel: tuple[str, ...] = ()
    """Columns of the view `panel_summary` beside the numbers of rows and of those failing, as SQL."""
    subject: str = ""
    """What bears the name, as trends follow it: a seam for its positions."""
    by_design: bool = False
    """Whether every aircraft of a type has the same ones: they are followed for drift, and missing ones are no cure."""
    parameter: str = ""
    """As addresses of pages name it."""
    verdict: str = ""
    """A function of a row that judges it by something else than limits ("module:name"); "" where nothing else counts.
    """
    unlimited: str = ""
    """A function of a row that no limit of its zone judges ("module:name"); "" where such a row is in order."""
    note: str = ""
    """A function of a row that gives what the projector writes behind its values; "" where there is nothing to say."""
    measure: str = ""
    """A function that finds and measures the kind, as a step of its own after the rivets, the seams and the kinds
    before it ("module:name"): from a `metrology.sighted.Sighted`, and its block of the settings (None where there is
    none), to rows. "" for rivets and seams, whose steps come first."""
    on_request: bool = False
    """Whether it is measured only where the panel's specification limits it."""
    settings: str = ""
    """Name of that block; "" for the name of the table."""
    cells: tuple[Cell, ...] = ()
    """What reports have in a row between its name and its zone; its quantities where nothing is given."""
    size: tuple[str, ...] = ()
    """Columns of its extent, mm. The largest is the ring that the projector draws; rows of two scans nearer than half
    of it are of one feature of the panel."""
    along: str = ""
    """Column of the direction of its length in the left image, degrees, where it is longer than wide: pictures show the
    ellipse of `major_px` and `minor_px`, and the projector an arrow along it."""

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

    def quantities_of(self, row: Feature) -> list[Quantity]:
        """The quantities that a row has."""
        if _has_any(row, self.without):
            return []
        return [quantity for quantity in self.quantities if not _has_any(row, quantity.not_of)]

    def counts_in(self, rows: Sized) -> bool:
        """Whether people are told how many there are, be it none; of what has to be asked for only if there is some."""
        return bool(len(rows)) or not self.on_request

    def names(self, rows: Iterable[Feature]) -> set[str]:
        """The different names among rows: of seams, where the rows are positions along them."""
        return {getattr(row, self.id_columns[0]) for row in rows}

    def counted(self, rows: Sequence[Feature]) -> dict[str, int]:
        """Its columns of `scenes` that count it, from its rows."""
        found = {"rows": len(rows), "names": len(self.names(rows)), "found": sum(row.is_found for row in rows)}
        return {count.column: found[count.of] for count in self.counts}

    def id_of(self, row: Feature | Mapping[str, Any]) -> str:
        """The id of a row within its scene, such as ``R12``, or ``S1@24.0`` for a position along a seam."""
        name, *positions = [row[c] if isinstance(row, Mapping) else getattr(row, c) for c in self.id_columns]
        return "@".join([str(name), *(f"{position:.1f}" for position in positions)])


def _has_any(row: Feature, values: Sequence[tuple[str, str | None]]) -> bool:
    """Whether a row has one of the values in its column."""
    return any(getattr(row, column) == value for column, value in values)


def load(name: str) -> Any:
    """What "module:name" names."""
    module, _, attribute = name.partition(":")
    return getattr(import_module(module), attribute)
