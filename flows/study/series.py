"""Series of simulated scans: one panel in one condition, inspected with one rig or two, and the truth of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import timedelta
from typing import Literal

from metrology.moments import moment_of
from metrology.results import SceneKey
from metrology.rig import Rig
from simulator.pack import pack
from simulator.rig import warmed
from simulator.scene import make_rig, place
from simulator.spec import SimulationSpec
from simulator.truth import Pose, Truth, truth

RigKind = Literal["true", "calibrated"]
"""With which calibration a scan is inspected: the rig that the simulator built, or what a calibration made of it."""


@dataclass(frozen=True)
class Series:
    """Scans of a panel in one condition."""

    name: str
    """The store knows the series by it, as aircraft_serial."""
    simulation: SimulationSpec
    """With the number of scans as `repeats`."""
    rigs: tuple[RigKind, ...] = ("calibrated",)

    def __len__(self) -> int:
        return len(self.simulation.placements) * self.simulation.repeats * len(self.rigs)

    def station(self, placement: int, rig: RigKind) -> str:
        """Placement and calibration as one word, as the store's station has it."""
        return f"{self.simulation.placements[placement].station or f'S{placement + 1}'}-{rig}"

    def scans(self, rig: RigKind) -> Iterator[Scan]:
        """Every scan, as inspected with one rig."""
        for placement in range(len(self.simulation.placements)):
            for repeat in range(self.simulation.repeats):
                yield Scan(self, placement, repeat, rig)


@dataclass(frozen=True)
class Scan:
    """One scan of a series, inspected with one rig."""

    series: Series
    placement: int
    repeat: int
    rig: RigKind

    @property
    def key(self) -> SceneKey:
        """What names it in the store."""
        keys = self.series.simulation.scene
        captured = moment_of(keys.captured_at) + timedelta(minutes=keys.interval_min * self.repeat)
        return SceneKey(self.series.name, keys.panel, self.series.station(self.placement, self.rig), captured)


@dataclass(frozen=True)
class Known:
    """Where the panel stands in one placement, and what is true of it there."""

    pose: Pose
    truth: Truth


def real_rig(simulation: SimulationSpec) -> Rig:
    """The rig as it stands while it scans: warmed, where the disturbances say so."""
    return warmed(make_rig(simulation), simulation.disturbances.warming_k)


def known(simulation: SimulationSpec, placement: int) -> Known:
    """The truth of a placement, without rendering it."""
    rig = real_rig(simulation)
    pose = place(rig, simulation.placements[placement])
    return Known(pose, truth(simulation.panel, pack(simulation.panel), rig, pose))
