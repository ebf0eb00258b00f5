"""Panel specifications (TOML): tolerance zones, and the nominal pattern of rivets and seams where it is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from metrology.errors import SpecError
from metrology.panel import NominalRivet, NominalSeam, PanelLayout, Placement
from metrology.tolerance import Limit, PanelSpec, Zone
from storage.documents import read_toml
from storage.models import Identifier, StrictModel, validate

DEFAULT_SPEC = Path(__file__).with_name("default_panel.toml")
DEFAULT_ZONE = "default"

Vector3 = tuple[float, float, float]
FeatureName = Annotated[str, Field(min_length=1, max_length=64)]


class LimitModel(StrictModel):
    """Limits of one quantity; a side that is not given is open. Every limit says where it comes from."""

    lower: float | None = None
    upper: float | None = None
    serious_lower: float | None = None
    serious_upper: float | None = None
    source: Annotated[str, Field(min_length=1)]
    revision: Annotated[str, Field(min_length=1)]


class ZoneModel(StrictModel):
    """Limits that hold for the features of a zone."""

    height_mm: LimitModel | None = None
    tilt_deg: LimitModel | None = None
    step_mm: LimitModel | None = None
    width_mm: LimitModel | None = None


class RivetModel(StrictModel):
    """A nominal rivet, in the panel's frame."""

    id: FeatureName
    position_mm: Vector3
    diameter_mm: Annotated[float, Field(gt=0)] | None = None
    zone: str = DEFAULT_ZONE
    normal: Vector3 | None = None


class SeamModel(StrictModel):
    """A nominal seam: its course as a polyline in the panel's frame, and where the air flows."""

    id: FeatureName
    course_mm: tuple[Vector3, ...]
    zone: str = DEFAULT_ZONE
    airflow: Vector3 | None = None


class StationModel(StrictModel):
    """Nominal placement of the rig: a point x of the rig frame is at R x + t_mm in the panel's frame."""

    R: tuple[Vector3, Vector3, Vector3]
    t_mm: Vector3


class PanelSpecModel(StrictModel):
    """A panel specification."""

    panel: Identifier
    revision: Annotated[str, Field(min_length=1)]
    zones: dict[str, ZoneModel]
    rivets: tuple[RivetModel, ...] = ()
    seams: tuple[SeamModel, ...] = ()
    stations: dict[Identifier, StationModel] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _zones_exist(self) -> PanelSpecModel:
        for kind, features in (("rivet", self.rivets), ("seam", self.seams)):
            for feature in features:
                if feature.zone not in self.zones:
                    raise ValueError(
                        f"found zone {feature.zone!r} in {kind} {feature.id}, expected one of {', '.join(self.zones)}"
                    )
        return self


@dataclass(frozen=True)
class PanelSpecification:
    """A panel specification as it was read.

    Attributes
    ----------
    limits : PanelSpec
    layout : PanelLayout
        Empty where the file gives no pattern.
    document : mapping
        The file's content, for traceability.
    """

    limits: PanelSpec
    layout: PanelLayout
    document: Mapping[str, Any]


def load_panel_spec(path: Path | None = None) -> PanelSpecification:
    """Read a panel specification; the example that ships with Flushline where none is given."""
    path = Path(path) if path else DEFAULT_SPEC
    document = read_toml(path, SpecError)
    model = validate(PanelSpecModel, document, path, SpecError)
    try:
        zones = {
            name: Zone(**{q: _limit(f"zones.{name}.{q}", getattr(zone, q)) for q in ZoneModel.model_fields})
            for name, zone in model.zones.items()
        }
        return PanelSpecification(PanelSpec(model.panel, model.revision, zones), _layout(model), document)
    except SpecError as problem:
        raise SpecError(f"{path}: {problem}") from None


def _limit(place: str, model: LimitModel | None) -> Limit | None:
    try:
        return Limit(**model.model_dump()) if model else None
    except SpecError as problem:
        raise SpecError(f"{place}: {problem}") from None


def _layout(model: PanelSpecModel) -> PanelLayout:
    return PanelLayout(
        tuple(NominalRivet(r.id, r.position_mm, r.diameter_mm, r.zone, r.normal) for r in model.rivets),
        tuple(NominalSeam(s.id, s.course_mm, s.zone, s.airflow) for s in model.seams),
        {name: Placement(np.array(s.R), np.array(s.t_mm)) for name, s in model.stations.items()},
    )
