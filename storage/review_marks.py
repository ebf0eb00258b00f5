"""Marks of what was signed off, beside the bundles: an empty file `signed-off/SCENE_ID/RUN_ID` in the store.

They hold what was signed off when the review log is damaged, lost or out of reach.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from storage.archive.files import make_folders, sync

FOLDER = "signed-off"


class SignOffMarks:
    """The marks of a store.

    Parameters
    ----------
    root : Path
        The store's folder.
    """

    def __init__(self, root: Path) -> None:
        self._root = Path(root)
        self.folder = self._root / FOLDER

    def add(self, runs: Iterable[tuple[str, str]]) -> None:
        """Mark runs, given as scene and run, durably."""
        for scene_id, run_id in runs:
            mark = self.folder / scene_id / run_id
            if not mark.exists():
                make_folders(mark.parent, self._root)
                mark.touch()
                sync(mark.parent)

    def of_scene(self, scene_id: str) -> str | None:
        """The run on which a scene was signed off; None where there is no mark."""
        return min(_names(self.folder / scene_id), default=None)

    def all(self) -> dict[str, str]:
        """The run on which each scene was signed off."""
        return {scene: run for scene in _names(self.folder) if (run := self.of_scene(scene))}


def _names(folder: Path) -> list[str]:
    try:
        return [name for name in os.listdir(folder) if not name.startswith(".")]
    except (FileNotFoundError, NotADirectoryError):
        return []
