"""Panel specifications (`flushline-panel/1`, TOML): tolerance zones, and the nominal pattern of rivets and seams.

A pattern enrolled from a scan is a file of the same format with a pattern of one station and no zones.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, create_model, model_validator

from metrology.errors import SpecError
from metrology.kinds import LIMITS
from metrology.limits import GradedLimit
from metrology.panel import NominalRivet, NominalSeam, PanelLayout, Placement
from metrology.rules import Rule
from metrology.tolerance import DEFAULT_ZONE, Limit, PanelSpec
from storage.documents import check_format, read_toml
from storage.models import Identifier, Line, StrictModel, validate

FORMAT = "flushline-panel/1"
DEFAULT_SPEC = Path(__file__).with_name("default_panel.toml")

Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]  # mm: no aircraft is a kilometre long
Vector3 = tuple[Coordinate, Coordinate, Coordinate]
FeatureName = Annotated[Line, Field(min_length=1, max_length=64)]


class LimitModel(StrictModel):
    """Limits of one quantity; a side that is not given is open. Every limit says where it comes from."""

    lower: float | None = None
    upper: float | None = None
    serious_lower: float | None = None
    serious_upper: float | None = None
    source: Annotated[str, Field(min_length=1)]
    revision: Annotated[str, Field(min_length=1)]


class GradedLimitModel(StrictModel):
    """A limit that goes with an extent: [extent, limit] in turn."""

    steps: tuple[tuple[float, float], ...]
    serious_upper: float | None = None
    source: Annotated[str, Field(min_length=1)]
    revision: Annotated[str, Field(min_length=1)]


_FIELDS: dict[str, Any] = {
    name: ((GradedLimitModel if limit.graded else LimitModel) | None, None) for name, limit in LIMITS.items()
}


class ZoneModel(create_model("_Limits", __base__=StrictModel, **_FIELDS)):  # type: ignore[misc]
    """Limits that hold for the features of a zone; what it leaves open is as in the zone `default`."""


class RivetModel(StrictModel):
    """A nominal rivet, in the panel's frame."""

    id: FeatureName
    position_mm: Vector3
    diameter_mm: Annotated[float, Field(gt=0)] | None = None
    zone: str = DEFAULT_ZONE
    normal: Vector3 | None = None
    row: FeatureName | None = None
    location: FeatureName | None = None


class StretchModel(StrictModel):
    """A stretch of a seam, from and to in mm along it, where another zone's limits hold."""

    from_mm: float
    to_mm: float
    zone: FeatureName


class SeamModel(StrictModel):
    """A nominal seam: its course as a polyline in the panel's frame, and where the air flows."""

    id: FeatureName
    course_mm: tuple[Vector3, ...]
    zone: str = DEFAULT_ZONE
    airflow: Vector3 | None = None
    stretches: tuple[StretchModel, ...] = ()
    location: FeatureName | None = None


class RuleModel(StrictModel):
    """An acceptance rule of the panel (`metrology.rules.Rule`); like every limit it says where it comes from."""

    id: FeatureName
    measure: Literal["share", "number", "adjacent", "run", "length", "mean", "density"]
    kind: str
    most: Annotated[float, Field(ge=0)] = 0.0
    quantity: str = ""
    beyond: Literal["limit", "serious", "any"] = "limit"
    zone: FeatureName | None = None
    per: Literal["panel", "zone", "row", "course"] = "panel"
    over_mm: Annotated[float, Field(gt=0)] | None = None
    source: Annotated[str, Field(min_length=1)]
    revision: Annotated[str, Field(min_length=1)]


class StationModel(StrictModel):
    """Nominal placement of the rig: a point x of the rig frame is at R x + t_mm in the panel's frame."""

    R: tuple[Vector3, Vector3, Vector3]
    t_mm: Vector3


class PanelSpecModel(StrictModel):
    """A panel specification.

    `example` marks limits that are nobody's requirement; `enrolled_from` the scan that a pattern was taken from.
    """

    format: Literal["flushline-panel/1"]
    panel: Identifier
    revision: Annotated[str, Field(min_length=1)]
    example: bool = False
    enrolled_from: str | None = None
    zones: dict[FeatureName, ZoneModel] = Field(default_factory=dict)
    rivets: tuple[RivetModel, ...] = ()
    seams: tuple[SeamModel, ...] = ()
    stations: dict[Identifier, StationModel] = Field(default_factory=dict)
    acceptance: tuple[RuleModel, ...] = ()

    @model_validator(mode="after")
    def _zones_exist(self) -> PanelSpecModel:
        for kind, features in (("rivet", self.rivets), ("seam", self.seams)):
            for feature in features:
                if feature.zone not in self.zones and feature.zone != DEFAULT_ZONE:
                    raise ValueError(
                        f"found zone {feature.zone!r} in {kind} {feature.id}, expected one of {', '.join(self.zones)}"
                    )
        named = [(f"seam {seam.id}", part.zone) for seam in self.seams for part in seam.stretches]
        named += [(f"acceptance {rule.id}", rule.zone) for rule in self.acceptance if rule.zone]
        for place, zone in named:
            if zone not in self.zones and zone != DEFAULT_ZONE:
                raise ValueError(f"found zone {zone!r} in {place}, expected one of {', '.join(self.zones)}")
        if any(rule.per == "row" for rule in self.acceptance) and not any(rivet.row for rivet in self.rivets):
            raise ValueError("found a rule per row and no rivet with a row, expected `row` in the rivets")
        return self


@dataclass(frozen=True)
class PanelSpecification:
    """A panel specification as it was read."""

    limits: PanelSpec
    layout: PanelLayout
    """Empty where the file gives no pattern."""
    document: Mapping[str, Any]
    """The file's content, for traceability."""
    example: bool = False
    """Whether its limits are an example and nobody's requirement."""
    rules: tuple[Rule, ...] = ()
    """What the panel as a whole must meet."""

    def __str__(self) -> str:
        return f"{self.limits.panel} {self.limits.revision}"


def load_panel_spec(path: Path | None = None) -> PanelSpecification:
    """Read a panel specification; the example that ships with Flushline where none is given."""
    path = Path(path) if path else DEFAULT_SPEC
    return panel_spec_from(read_toml(path, SpecError), path)


def panel_spec_from(document: Mapping[str, Any], path: Path) -> PanelSpecification:
    """The specification that a document describes; `path` names it in errors."""
    check_format(document, FORMAT, path, SpecError)
    model = validate(PanelSpecModel, document, path, SpecError)
    try:
        zones = {
            name: {q: _limit(f"zones.{name}.{q}", limit) for q, limit in zone if limit is not None}
            for name, zone in model.zones.items()
        }
        limits = PanelSpec(model.panel, model.revision, zones)
        return PanelSpecification(limits, _layout(model), document, model.example, _rules(model))
    except SpecError as problem:
        raise SpecError(f"{path}: {problem}") from None


def locations_of(document: Mapping[str, Any]) -> dict[str, str]:
    """Where named features are on the aircraft, by their names, as far as a specification's document says it."""
    named = [*(document.get("rivets") or ()), *(document.get("seams") or ())]
    return {str(each["id"]): str(each["location"]) for each in named if each.get("location")}


def judged_by(manifest: Mapping[str, Any], path: Path) -> PanelSpec | None:
    """The limits that a run was judged by, as its manifest keeps them; None where this version cannot read them."""
    with contextlib.suppress(SpecError, AttributeError):  # a run of an older version had another form
        return panel_spec_from(manifest.get("panel_spec") or {}, path).limits
    return None


def pattern_toml(layout: PanelLayout, panel: str, revision: str, enrolled_from: str | None = None) -> str:
    """A panel's pattern as a specification without limits, to be kept or to be completed by hand.

    Parameters
    ----------
    enrolled_from : str, optional
        The scan that it was taken from; without one it comes from a list.
    """
    enrolled = "enrolled from a scan; positions in mm, z outward, x to the right and y up for a viewer outside"
    said = enrolled if enrolled_from else "imported from a list; positions in mm; limits are still to be written"
    lines = [
        f"# Pattern {said}.",
        f"format = {_toml(FORMAT)}",
        f"panel = {_toml(panel)}",
        f"revision = {_toml(revision)}",
        *([f"enrolled_from = {_toml(enrolled_from)}"] if enrolled_from else []),
    ]
    zones = ({rivet.zone for rivet in layout.rivets} | {seam.zone for seam in layout.seams}) - {DEFAULT_ZONE}
    lines += [line for zone in sorted(zones if not enrolled_from else ()) for line in ("", f"[zones.{_toml(zone)}]")]
    for name, placement in layout.stations.items():
        lines += ["", f"[stations.{_toml(name)}]", f"R = {_toml(placement.R, 10)}", f"t_mm = {_toml(placement.t)}"]
    for rivet in layout.rivets:
        lines += ["", "[[rivets]]", f"id = {_toml(rivet.rivet_id)}", f"position_mm = {_toml(rivet.position)}"]
        lines += [f"diameter_mm = {_toml(rivet.diameter_mm)}"] if rivet.diameter_mm is not None else []
        lines += [f"zone = {_toml(rivet.zone)}"] if rivet.zone != DEFAULT_ZONE else []
        lines += [f"normal = {_toml(rivet.normal, 6)}"] if rivet.normal is not None else []
        lines += [f"row = {_toml(rivet.row)}"] if rivet.row is not None else []
        lines += [f"location = {_toml(rivet.location)}"] if rivet.location is not None else []
    for seam in layout.seams:
        lines += ["", "[[seams]]", f"id = {_toml(seam.seam_id)}", f"course_mm = {_toml(seam.course)}"]
        lines += [f"zone = {_toml(seam.zone)}"] if seam.zone != DEFAULT_ZONE else []
        lines += [f"airflow = {_toml(seam.airflow)}"] if seam.airflow is not None else []
    return "\n".join([*lines, ""])


def _toml(value: str | float | Iterable[Any], digits: int = 4) -> str:
    """A value as TOML has it; numbers are lengths to 0.1 µm unless more digits are asked for."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, (int, float)):
        return repr(round(float(value), digits))
    return f"[{', '.join(_toml(item, digits) for item in value)}]"


def _limit(place: str, model: LimitModel | GradedLimitModel) -> Limit:
    try:
        if isinstance(model, GradedLimitModel):
            greatest = max((upper for _, upper in model.steps), default=0.0)
            return GradedLimit(upper=greatest, **model.model_dump())
        return Limit(**model.model_dump())
    except SpecError as problem:
        raise SpecError(f"{place}: {problem}") from None


def _rules(model: PanelSpecModel) -> tuple[Rule, ...]:
    fields = [rule.model_dump() for rule in model.acceptance]
    return tuple(Rule(rule_id=rule.pop("id"), **rule) for rule in fields)


def _layout(model: PanelSpecModel) -> PanelLayout:
    return PanelLayout(
        tuple(
            NominalRivet(r.id, r.position_mm, r.diameter_mm, r.zone, r.normal, r.row, r.location) for r in model.rivets
        ),
        tuple(
            NominalSeam(s.id, s.course_mm, s.zone, s.airflow, tuple((p.from_mm, p.to_mm, p.zone) for p in s.stretches))
            for s in model.seams
        ),
        {name: Placement(np.array(s.R), np.array(s.t_mm)) for name, s in model.stations.items()},
    )
