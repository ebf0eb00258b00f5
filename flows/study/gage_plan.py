"""The plan of a gage study on captured scans (`flushline-gage/1`, TOML), and what of it is still to be scanned."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from metrology.errors import SpecError
from metrology.kinds import KINDS, Kind, Quantity
from storage.archive import Store
from storage.documents import check_format, read_toml
from storage.models import Identifier, Line, PositiveNumber, StrictModel, UtcTime, WholeNumber, validate

FORMAT = "flushline-gage/1"
QUANTITIES: dict[str, tuple[Kind, Quantity]] = {q.name: (kind, q) for kind in KINDS for q in kind.quantities}


class ReferenceModel(StrictModel):
    """A part whose value is known otherwise: of bias and linearity."""

    part: Line
    quantity: Literal[tuple(QUANTITIES)]  # type: ignore[valid-type]
    value: float
    u95: Annotated[float, Field(ge=0)] = 0.0
    source: Line = ""


class GagePlan(StrictModel):
    """A plan."""

    format: Literal["flushline-gage/1"]
    title: Line = "Gage study"
    panel: Identifier
    aircraft: Annotated[tuple[Identifier, ...], Field(min_length=1)]
    stations: Annotated[tuple[Identifier, ...], Field(min_length=1)]
    """aircraft, stations: each aircraft's station is scanned by each operator; its features are the parts."""
    operators: Annotated[tuple[Line, ...], Field(min_length=2)]
    """As scene.json names them."""
    trials: Annotated[WholeNumber, Field(ge=2)] = 3
    quantities: Annotated[tuple[Line, ...], Field(min_length=1)] = ("height",)
    parts: tuple[Line, ...] = ()
    """Features to look at; all that every scan measured where none is given."""
    positions: Annotated[WholeNumber, Field(ge=2)] = 10
    """Places along a course, such as a seam, that count as parts."""
    since: UtcTime | None = None
    until: UtcTime | None = None
    """since, until: scans of that time only."""
    tolerance: dict[str, PositiveNumber] = Field(default_factory=dict)
    """Upper less lower limit of a quantity, in its unit: %GRR of tolerance."""
    acceptable_percent: PositiveNumber = 10.0
    conditional_percent: PositiveNumber = 30.0
    """acceptable_percent, conditional_percent: %GRR up to which the gage is acceptable, and may be acceptable."""
    least_categories: WholeNumber = 5
    """ndc."""
    reference: tuple[ReferenceModel, ...] = ()

    @model_validator(mode="after")
    def _known_quantities(self) -> GagePlan:
        for name in (*self.quantities, *self.tolerance):
            if name not in QUANTITIES:
                raise ValueError(f"found quantity {name!r}, expected one of {', '.join(QUANTITIES)}")
        return self


def read_plan(path: Path) -> GagePlan:
    """A plan from a TOML file."""
    document = read_toml(path, SpecError)
    check_format(document, FORMAT, path, SpecError)
    return validate(GagePlan, document, path, SpecError)


@dataclass(frozen=True)
class Cell:
    """What one operator scans of one station of one aircraft: the scans that count, in their order."""

    aircraft: str
    station: str
    operator: str
    scans: tuple[str, ...]
    extra: tuple[str, ...] = ()


@dataclass(frozen=True)
class Scanned:
    """What the archive holds of a plan."""

    cells: tuple[Cell, ...]
    """Every aircraft, station and operator of the plan."""
    trials: int
    """Complete ones, of all cells."""
    others: dict[str, int] = field(default_factory=dict)
    """Scans of the panel's stations by whom the plan does not name, by the operator's name ("" for nobody)."""

    def still(self, wanted: int) -> list[tuple[str, str, str]]:
        """(operator, aircraft, station) of every scan still to be made, in a random order that stays the same."""
        left = [(c.operator, c.aircraft, c.station) for c in self.cells for _ in range(wanted - len(c.scans))]
        random.Random(len(left)).shuffle(left)  # the manual asks for a random order, not for secrecy
        return left


def scanned(store: Store, plan: GagePlan) -> Scanned:
    """Compare the archive with the plan."""
    rows = scans_of(store, plan)
    cells = []
    for aircraft in plan.aircraft:
        for station in plan.stations:
            for operator in plan.operators:
                scans = [r["scene_id"] for r in rows if _key(r) == (aircraft, station, operator)]
                cells.append(
                    Cell(aircraft, station, operator, tuple(scans[: plan.trials]), tuple(scans[plan.trials :]))
                )
    others: dict[str, int] = {}
    for row in rows:
        if row["operator"] not in plan.operators:
            others[row["operator"] or ""] = others.get(row["operator"] or "", 0) + 1
    return Scanned(tuple(cells), min(len(cell.scans) for cell in cells), others)


def scans_of(store: Store, plan: GagePlan, since: datetime | None = None) -> list[dict[str, Any]]:
    """Scans of the plan's stations within its time, the earliest first."""
    rows = store.query(
        "SELECT scene_id, aircraft_serial, station, operator, captured_at FROM scenes WHERE panel = ? "
        "ORDER BY captured_at, scene_id",
        [plan.panel],
    ).to_pylist()
    begin = since or plan.since
    return [
        row
        for row in rows
        if row["aircraft_serial"] in plan.aircraft
        and row["station"] in plan.stations
        and (begin is None or row["captured_at"] >= begin)
        and (plan.until is None or row["captured_at"] <= plan.until)
    ]


def _key(row: dict[str, Any]) -> tuple[str, str, str]:
    return row["aircraft_serial"], row["station"], row["operator"]


def part_name(plan: GagePlan, aircraft: str, station: str, feature: str) -> str:
    """A part's name: the feature's, with aircraft and station where the plan has several."""
    several: Sequence[str] = [a for a in (aircraft,) if len(plan.aircraft) > 1] + [
        s for s in (station,) if len(plan.stations) > 1
    ]
    return " ".join([*several, feature])
