"""The settings of a whole inspection, and reading them from TOML."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from metrology.defects.settings import DefectSettings
from metrology.errors import FlushlineError, UsageError
from metrology.overlay import OverlaySettings
from metrology.reconstruction_settings import ReconstructionSettings
from metrology.registration.settings import RegistrationSettings
from metrology.rig_health import HealthSettings
from metrology.rivets.settings import RivetSettings
from metrology.seams.settings import SeamSettings
from metrology.waviness.row import WavinessSettings
from storage.documents import brief, closest, read_toml, shown
from storage.models import first_problem


@dataclass(frozen=True)
class SceneChecks:
    """When a scan is refused, or said to be doubtful."""

    min_valid_fraction: float = 0.02
    """Share of the left camera's pixels that must have a point; a scan with less shows no skin."""
    max_saturated_fraction: float = 0.05
    """Share of the skin that may be saturated in every exposure before a warning says so. Glints on heads and edges
    take up less than a hundredth; where a twentieth is saturated, there are gaps larger than a rivet head."""
    contradictory_warning_fraction: float = 0.03
    """Share of a camera's lit pixels whose fringes may contradict each other before a warning says so; a sound scan has
    0.005 at most."""
    max_contradictory_fraction: float = 0.2
    """The same share from which a scan is refused, whether or not the wrong frame can be named."""

    def __post_init__(self) -> None:
        for name in (setting.name for setting in fields(self)):
            if not 0 <= getattr(self, name) < 1:
                raise UsageError(f"{name}: found {getattr(self, name):g}, expected 0 … 1")


@dataclass(frozen=True)
class VerificationSettings:
    """What an inspection asks of its rig's evidence.

    A rig that was verified once is watched: a verification that failed or is overdue, or a calibration past its due
    date, is warned of.
    """

    required: bool = False
    """Whether a rig that was never verified counts like one whose verification is overdue."""
    refuse: bool = False
    """Whether scans of such rigs are refused instead of warned of."""


@dataclass(frozen=True)
class InspectionSettings:
    """Settings of every step, one block per step as in the TOML file."""

    checks: SceneChecks = field(default_factory=SceneChecks)
    reconstruction: ReconstructionSettings = field(default_factory=ReconstructionSettings)
    rig_health: HealthSettings = field(default_factory=HealthSettings)
    verification: VerificationSettings = field(default_factory=VerificationSettings)
    rivets: RivetSettings = field(default_factory=RivetSettings)
    seams: SeamSettings = field(default_factory=SeamSettings)
    defects: DefectSettings = field(default_factory=DefectSettings)
    waviness: WavinessSettings = field(default_factory=WavinessSettings)
    registration: RegistrationSettings = field(default_factory=RegistrationSettings)
    overlay: OverlaySettings = field(default_factory=OverlaySettings)

    @property
    def document(self) -> dict[str, Any]:
        """Every setting as plain values, for traceability and comparison."""
        return asdict(self)


def load_settings(path: Path | None = None) -> InspectionSettings:
    """Settings from a TOML file; what it does not mention has its default, a key that does not exist is refused."""
    if path is None:
        return InspectionSettings()
    path = Path(path)
    return settings_from(read_toml(path, UsageError), str(path))


def settings_from(document: Mapping[str, Any], source: str) -> InspectionSettings:
    """Settings from a document; `source` names it in errors."""
    try:
        _check_keys(InspectionSettings, document, "")
        return TypeAdapter(InspectionSettings).validate_python(document)
    except ValidationError as problem:
        raise UsageError(f"{source}: {first_problem(problem, lambda _: [])}") from None
    except FlushlineError as problem:
        raise UsageError(f"{source}: {problem}") from None


def _check_keys(settings: Any, document: Mapping[str, Any], place: str) -> None:
    known = {f.name: f for f in fields(settings)}
    for key, value in document.items():
        if key not in known:
            raise UsageError(f"found unknown key {brief(place + key)!r}, expected {closest(key, list(known))}")
        if isinstance(value, float) and not math.isfinite(value):
            raise UsageError(f"{place}{key}: found {value}, expected a finite number")
        inner = known[key].default_factory
        if isinstance(inner, type) and is_dataclass(inner):
            if not isinstance(value, Mapping):
                raise UsageError(f"{place}{key}: found {shown(value)}, expected a table of settings")
            _check_keys(inner, value, f"{place}{key}.")
