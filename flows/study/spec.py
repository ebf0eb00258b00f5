"""What a study does: a TOML file (`flushline-study/1`), checked key by key, and the simulations it names."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, Literal

from metrology.errors import SpecError
from simulator.spec import CalibrationSpec, SimulationSpec, read_spec, shipped_spec
from simulator.tables import build
from storage.documents import check_format

FORMAT = "flushline-study/1"
Kind = Literal["accuracy", "repeatability"]


def _at_least(least: float, what: str, found: float) -> None:
    if not found >= least:
        raise SpecError(f"{what}: found {found:g}, expected {least:g} or more")


@dataclass(frozen=True)
class RepeatedScans:
    """Scans of one panel with nothing changed between them but the noise."""

    simulation: str
    """A simulation specification: the name of one that ships with Flushline, or a TOML file beside the study's."""
    scans: int = 10
    positions: int = 10
    """Places along each seam whose step and width are followed."""

    def __post_init__(self) -> None:
        _at_least(2, "scans", self.scans)
        _at_least(1, "positions", self.positions)


@dataclass(frozen=True)
class GageSpec:
    """A crossed gage study: the rivets and seam positions are the parts, the simulation's placements the operators."""

    simulation: str = "gage"
    trials: int = 3
    positions: int = 10

    def __post_init__(self) -> None:
        _at_least(2, "trials", self.trials)
        _at_least(2, "positions", self.positions)


@dataclass(frozen=True)
class BudgetSpec:
    """How strong each disturbance is when it is switched on alone."""

    simulation: str = "skin"
    """Its skin, surface, blur and sensor are what is switched on."""
    scans: int = 3
    """Of each condition that differs from scan to scan."""
    gamma: float = 2.2
    vibration_px: float = 0.05
    ambient_drift: float = 0.2
    warming_k: float = 5.0
    """gamma, vibration_px, ambient_drift, warming_k: as in a simulation specification."""
    sharp_blur_px: float = 0.3
    """Blur of the cameras while the edges' influence is switched off."""
    quiet: float = 0.1
    """Share of the noise that stays while it is switched off: thresholds that follow the noise make no sense without.
    """

    def __post_init__(self) -> None:
        _at_least(2, "scans", self.scans)
        if not 0 < self.quiet < 1:
            raise SpecError(f"quiet: found {self.quiet:g}, expected above 0, below 1")


@dataclass(frozen=True)
class DetectionSpec:
    """Random panels whose rivets' rings all have one contrast."""

    simulation: str = "skin"
    """Its rig, light and cameras."""
    ring_levels: tuple[float, ...] = (2.0, 3.0, 4.0, 6.0, 10.0, 20.0)
    """Contrast of the rings, grey levels."""
    panels: int = 2
    """Panels of each contrast."""
    seed: int = 1
    clutter: bool = False
    """Add what a hall adds: letters, marks, chips, open holes, temporary fasteners, recesses, dents and scratches."""

    def __post_init__(self) -> None:
        _at_least(1, "panels", self.panels)
        _at_least(0, "seed", self.seed)
        if not self.ring_levels or min(self.ring_levels) <= 0:
            raise SpecError(f"ring_levels: found {list(self.ring_levels)}, expected positive grey levels")


@dataclass(frozen=True)
class StudySpec:
    """A study; a block that is left out is not done.

    `calibration` is the capture from which the calibrated rigs come, `tolerance_mm` the width of the tolerance of
    heights and steps.
    """

    format: Literal["flushline-study/1"]
    study: Kind
    tolerance_mm: float = 0.15
    calibration: CalibrationSpec = field(default_factory=CalibrationSpec)
    standard_part: RepeatedScans | None = None
    skin: RepeatedScans | None = None
    gage: GageSpec | None = None
    budget: BudgetSpec | None = None
    detection: DetectionSpec | None = None

    def __post_init__(self) -> None:
        if not self.tolerance_mm > 0:
            raise SpecError(f"tolerance_mm: found {self.tolerance_mm:g}, expected more than 0")
        if not self.blocks:
            raise SpecError("found no block, expected standard_part, skin, gage, budget or detection")

    @property
    def blocks(self) -> tuple[RepeatedScans | GageSpec | BudgetSpec | DetectionSpec, ...]:
        """What is to be done."""
        asked = (self.standard_part, self.skin, self.gage, self.budget, self.detection)
        return tuple(block for block in asked if block is not None)


@dataclass(frozen=True)
class Study:
    """A study with the simulations that its blocks name."""

    spec: StudySpec
    simulations: Mapping[str, SimulationSpec]

    @property
    def document(self) -> dict[str, Any]:
        """Everything that determines the study, as plain values."""
        simulations = {name: asdict(simulation) for name, simulation in self.simulations.items()}
        return {"spec": asdict(self.spec), "simulations": simulations}


def shipped_study(kind: Kind, quick: bool = False) -> Study:
    """One of the studies that come with Flushline."""
    name = f"{kind}{'-quick' if quick else ''}.toml"
    text = (resources.files("flows.study") / "specs" / name).read_text(encoding="utf-8")
    return parse_study(text, Path(name), kind)


def read_study(path: Path, kind: Kind) -> Study:
    """A study from a TOML file."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as problem:
        raise SpecError(f"{path}: found {problem}, expected a readable TOML file") from None
    return parse_study(text, path, kind)


def parse_study(text: str, path: Path, kind: Kind) -> Study:
    """A study from TOML text; `path` names it in messages, and simulations are looked for beside it."""
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as problem:
        raise SpecError(f"{path}: found {problem}, expected TOML") from None
    check_format(table, FORMAT, path, SpecError)
    try:
        spec = build(StudySpec, table, "")
    except SpecError as problem:
        raise SpecError(f"{path}: {problem}") from None
    if spec.study != kind:
        raise SpecError(f"{path}: study: found {spec.study!r}, expected {kind!r} as the command says")
    simulations = {block.simulation: _simulation(block.simulation, path) for block in spec.blocks}
    rigs = {simulation.rig.id: simulation.rig for simulation in simulations.values()}
    for name, simulation in simulations.items():
        if rigs[simulation.rig.id] != simulation.rig:
            raise SpecError(f"{path}: {name}: found another rig {simulation.rig.id!r}, expected one rig of that id")
    return Study(spec, simulations)


def _simulation(name: str, path: Path) -> SimulationSpec:
    return read_spec(path.parent / name) if name.endswith(".toml") else shipped_spec(name)
