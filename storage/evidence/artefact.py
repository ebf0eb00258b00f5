"""Artefacts (`flushline-artefact/1`, TOML): what is certified of them, and what a rig may be wrong by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from metrology.errors import SpecError
from metrology.panel import NominalRivet, NominalSeam, PanelLayout
from storage.calibration import BoardModel
from storage.certificate import CertificateModel
from storage.documents import check_format, read_toml
from storage.models import Identifier, Line, PositiveNumber, StrictModel, WholeNumber, validate
from storage.panel_spec import FeatureName, Vector3

FORMAT = "flushline-artefact/1"
Kind = Literal["plane", "spheres", "rivet-plate", "step-plate", "gap-plate", "board"]
_LEAST_HEADS = 3
_SAME_MM = 2.0  # a pattern is told from its image by more than that
_SAME_SIZE = 0.1  # of the diameter, as registration tells heads apart
_SAME_SPHERE = 1.02
Uncertainty = Annotated[float, Field(ge=0)]


class LimitsModel(StrictModel):
    """Maximum permissible amounts; what is not named is reported and not judged."""

    flatness_mm: PositiveNumber | None = None
    probing_form_mm: PositiveNumber | None = None
    """flatness_mm, probing_form_mm: errors of form: of a plane, of a sphere."""
    probing_size_mm: PositiveNumber | None = None
    sphere_spacing_mm: PositiveNumber | None = None
    length_mm: PositiveNumber | None = None
    """probing_size_mm, sphere_spacing_mm, length_mm: deviations of diameters, of distances of spheres' centres, of
    lengths on a board."""
    height_mm: PositiveNumber | None = None
    height_bias_mm: PositiveNumber | None = None
    height_growth: PositiveNumber | None = None
    step_mm: PositiveNumber | None = None
    step_bias_mm: PositiveNumber | None = None
    step_growth: PositiveNumber | None = None
    width_mm: PositiveNumber | None = None
    """height_mm, step_mm, width_mm: deviations of single features."""
    width_bias_mm: PositiveNumber | None = None
    """height_bias_mm, step_bias_mm, width_bias_mm: their mean."""
    width_growth: PositiveNumber | None = None
    """height_growth, step_growth, width_growth: slope of the deviation over the certified value, mm per mm (linearity).
    """


class PlaneModel(StrictModel):
    """A flat plate."""

    flatness_mm: Uncertainty = 0.0
    flatness_u95_mm: Uncertainty = 0.0


class SphereModel(StrictModel):
    """A sphere."""

    id: FeatureName
    diameter_mm: PositiveNumber
    diameter_u95_mm: Uncertainty
    form_u95_mm: Uncertainty = 0.0


class DistanceModel(StrictModel):
    """Distance of two spheres' centres."""

    between: tuple[FeatureName, FeatureName]
    length_mm: PositiveNumber
    u95_mm: Uncertainty


class CertifiedRivetModel(StrictModel):
    """A head of certified height over the plate around it; one without a height only tells where the plate is."""

    id: FeatureName
    position_mm: Vector3
    diameter_mm: PositiveNumber
    height_mm: float | None = None
    height_u95_mm: Uncertainty = 0.0


class CertifiedSeamModel(StrictModel):
    """A seam of certified step or width, the same along its course.

    `step_mm` is how far the side on the left of the course stands above that on the right, seen from outside (+z).
    """

    id: FeatureName
    course_mm: Annotated[tuple[Vector3, ...], Field(min_length=2)]
    step_mm: float | None = None
    step_u95_mm: Uncertainty = 0.0
    width_mm: PositiveNumber | None = None
    width_u95_mm: Uncertainty = 0.0


class ArtefactFile(StrictModel):
    """An artefact."""

    format: Literal["flushline-artefact/1"]
    id: Identifier
    kind: Kind
    title: Line = ""
    size_mm: tuple[PositiveNumber, PositiveNumber] | None = None
    """(width, height) or None: of a plate, for its drawing."""
    valid_days: Annotated[WholeNumber, Field(gt=0)] | None = None
    """How long a verification with it holds."""
    certificate: CertificateModel | None = None
    limits: LimitsModel = Field(default_factory=LimitsModel)
    plane: PlaneModel | None = None
    spheres: tuple[SphereModel, ...] = ()
    distances: tuple[DistanceModel, ...] = ()
    rivets: tuple[CertifiedRivetModel, ...] = ()
    seams: tuple[CertifiedSeamModel, ...] = ()
    positions: Annotated[WholeNumber, Field(ge=1)] = 5
    """Places along each seam that are compared."""
    board: BoardModel | None = None
    length_u95_mm: Uncertainty = 0.0
    """Expanded uncertainty of a length on the board."""

    @model_validator(mode="after")
    def _whole(self) -> ArtefactFile:
        heights = [rivet for rivet in self.rivets if rivet.height_mm is not None]
        needed: dict[str, object] = {"plane": self.plane, "spheres": self.spheres, "rivet-plate": heights}
        needed |= {"step-plate": self.seams, "gap-plate": self.seams, "board": self.board}
        if not needed[self.kind]:
            table = {"rivet-plate": "rivets", "step-plate": "seams", "gap-plate": "seams"}.get(self.kind, self.kind)
            raise ValueError(f"found no {table}, expected what is certified of a {self.kind}")
        names = [sphere.id for sphere in self.spheres]
        for distance in self.distances:
            if unknown := set(distance.between) - set(names):
                raise ValueError(f"found sphere {min(unknown)!r} in a distance, expected one of {', '.join(names)}")
        diameters = [sphere.diameter_mm for sphere in self.spheres]
        if diameters and max(diameters) > _SAME_SPHERE * min(diameters):
            raise ValueError(
                f"found spheres of {min(diameters):g} and {max(diameters):g} mm, expected one nominal diameter"
            )
        if len(self.spheres) > 1 and not self.distances:
            raise ValueError("found several spheres but no distances, expected the certified distance of two")
        if self.rivets or self.seams:
            _refuse_unplaceable(self.rivets)
        missing = "step_mm" if self.kind == "step-plate" else "width_mm" if self.kind == "gap-plate" else ""
        for seam in self.seams:
            if missing and getattr(seam, missing) is None:
                raise ValueError(f"found seam {seam.id} without {missing}, expected it in a {self.kind}")
        return self


@dataclass(frozen=True)
class Artefact:
    """An artefact as it was read; `document` is the file's content, kept with each verification."""

    file: ArtefactFile
    document: Mapping[str, Any]

    @property
    def layout(self) -> PanelLayout:
        """Its heads and seams as a pattern that scans are recognised in."""
        return PanelLayout(
            tuple(NominalRivet(r.id, r.position_mm, r.diameter_mm) for r in self.file.rivets),
            tuple(NominalSeam(s.id, s.course_mm, airflow=_left_of(s.course_mm)) for s in self.file.seams),
            {},
        )


def _refuse_unplaceable(rivets: Sequence[CertifiedRivetModel]) -> None:
    """Heads must tell where a plate is and which way round: names would be guessed otherwise."""
    if len(rivets) < _LEAST_HEADS:
        raise ValueError(f"found {len(rivets)} heads, expected {_LEAST_HEADS} or more that tell where the plate is")
    places = np.array([complex(*rivet.position_mm[:2]) for rivet in rivets])
    sizes = np.array([rivet.diameter_mm for rivet in rivets])
    places -= places.mean()
    first = int(np.abs(places).argmax())
    for k in range(len(places)):
        if k == first or abs(abs(places[k]) - abs(places[first])) > _SAME_MM:
            continue
        turned = places * (places[k] / places[first]) * abs(places[first]) / abs(places[k])
        apart = np.abs(turned[:, None] - places)
        partner = apart.argmin(1)
        if (apart.min(1) < _SAME_MM).all() and np.allclose(sizes[partner], sizes, rtol=_SAME_SIZE):
            turn = np.degrees(np.angle(places[k] / places[first]))
            raise ValueError(f"found heads that look the same after a turn by {turn:.0f}°, expected none such")


def _left_of(course: tuple[tuple[float, float, float], ...]) -> tuple[float, float, float]:
    """The direction to the left of a course: a step in an air flow that way is left above right, however it is seen."""
    (x0, y0, _), (x1, y1, _) = course[0], course[-1]
    return (y0 - y1, x1 - x0, 0.0)


SHIPPED = Path(__file__).with_name("artefacts")
"""Artefacts that ship with Flushline, to be made and certified."""


def shipped_artefact(name: str) -> Path:
    """The file of an artefact that ships."""
    path = SHIPPED / f"{name}.toml"
    if not path.is_file():
        known = ", ".join(sorted(file.stem for file in SHIPPED.glob("*.toml")))
        raise SpecError(f"artefact: found {name!r}, expected one of {known}")
    return path


def load_artefact(path: Path) -> Artefact:
    """Read an artefact."""
    document = read_toml(path, SpecError)
    check_format(document, FORMAT, path, SpecError)
    return Artefact(validate(ArtefactFile, document, path, SpecError), document)
