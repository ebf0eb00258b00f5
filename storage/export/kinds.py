"""The kinds of features and their quantities, as every format takes them: column, U95, unit, limit, verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from metrology.limits import Limit, PanelSpec
from metrology.requirements import downstream_of, limit_of
from metrology.results import SeamStation
from storage.archive.rows import result_of

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Quantity:
    """A measured quantity of a kind.

    Attributes
    ----------
    name : str
        In files and messages.
    column, u95_column : str
        Of the value and of its expanded uncertainty.
    unit : str
        "mm" or "°".
    title : str
        For people.
    limit : str
        What a zone of the panel specification calls its limit.
    """

    name: str
    column: str
    u95_column: str
    unit: str
    title: str
    limit: str


@dataclass(frozen=True)
class Kind:
    """A kind of feature: its table, what names a row within its scene, and its quantities."""

    name: str
    table: str
    id_columns: tuple[str, ...]
    quantities: tuple[Quantity, ...]

    def id_of(self, row: Row) -> str:
        """The id of a row within its scene, such as ``R12``, or ``S1@24.0`` for a position along a seam."""
        name, *positions = (row[column] for column in self.id_columns)
        return "@".join([str(name), *(f"{position:.1f}" for position in positions)])


KINDS = (
    Kind(
        "rivet",
        "rivets",
        ("rivet_id",),
        (
            Quantity("height", "height_mean_mm", "height_u95_mm", "mm", "Rivet height", "height_mm"),
            Quantity("tilt", "tilt_deg", "tilt_u95_deg", "°", "Rivet tilt", "tilt_deg"),
        ),
    ),
    Kind(
        "seam station",
        "seam_stations",
        ("seam_id", "s_mm"),
        (
            Quantity("step", "step_mm", "step_u95_mm", "mm", "Seam step", "step_mm"),
            Quantity("width", "width_mm", "width_u95_mm", "mm", "Seam width", "width_mm"),
        ),
    ),
)


def limit_for(quantity: Quantity, row: Row, spec: PanelSpec | None) -> Limit | None:
    """The limit that a feature's quantity was judged by."""
    if spec is None:
        return None
    downstream = downstream_of(result_of(SeamStation, row)) if quantity.name == "step" else 0
    return limit_of(spec.zone(row["zone"]), quantity.limit, downstream)
