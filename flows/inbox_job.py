"""What an inbox run is asked for, and what becomes of each scene folder: plain data that can go to another process."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from metrology.errors import UsageError

Runner = Literal["processes", "threads", "dask"]
State = Literal["inspected", "known", "signed off", "copying", "waiting", "quarantined", "failed"]
"""inspected: just now; known: earlier, alike; signed off: earlier, otherwise, and that result stays; copying: still
being written; waiting: its rig is not in the store; quarantined: broken, put aside; failed: not the scene's fault,
left for the next run."""


@dataclass(frozen=True)
class InboxJob:
    """An inbox and what its scenes are inspected with; paths only, so that it can go to another process."""

    inbox: Path
    store: Path
    rig: Path | None = None
    panel_spec: Path | None = None
    settings: Path | None = None
    """rig, panel_spec, settings: as for one scene."""
    settle_s: float = 30.0
    """A folder whose newest change is younger than this is still being copied."""
    compact: bool = False
    """Write the tables as Parquet for other engines when something new was inspected."""

    def __post_init__(self) -> None:
        if self.settle_s < 0:
            raise UsageError(f"settle time: found {self.settle_s:g} s, expected 0 or more")


@dataclass(frozen=True)
class Way:
    """How an inbox's scenes are run side by side."""

    runner: Runner = "processes"
    """Threads and Dask under Prefect only."""
    workers: int = 1
    """Scenes at a time."""
    dask_address: str | None = None
    """Scheduler of a Dask cluster that stands already."""

    def __post_init__(self) -> None:
        if self.workers < 1:
            raise UsageError(f"--workers: found {self.workers}, expected at least 1")


@dataclass(frozen=True)
class Outcome:
    """What became of one scene folder."""

    folder: Path
    """Where it was found."""
    state: State
    scene_id: str | None = None
    """None where the manifest could not be read."""
    text: str = ""
    """What was found, or the reason."""
    seconds: float = 0.0
    """Wall time of the inspection."""


@dataclass(frozen=True)
class Plan:
    """What is to be done in an inbox."""

    ready: list[Path]
    """Scene folders to inspect."""
    settled: list[Outcome]
    """What needs nothing more: known, signed off, still copying, waiting, or broken and put aside already."""
