"""A scene that was looked at, with what it needs to be measured."""

from __future__ import annotations

from dataclasses import dataclass

from metrology.rig import Rig
from storage.archive.known import KnownScene
from storage.cloud_scene import CloudScene
from storage.scene import Scene


@dataclass(frozen=True)
class LoadedScene:
    """A sound scene and the rig that measures it."""

    scene: Scene | CloudScene
    rig: Rig
    warnings: tuple[str, ...] = ()
    known: KnownScene | None = None
    """What the store has of the scene already."""
    same_frames: tuple[str, ...] = ()
    """Other scenes of the store that have the same frames."""
