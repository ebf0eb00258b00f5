"""Where things lie in a store.

flushline-store.json           marks the folder as a store
archive.duckdb                 link to the published index: what people, the dashboard and SQL open
bundles/AIRCRAFT/PANEL/SCENE_ID/RUN_ID/   one immutable folder per scene run: the truth (see `bundles`)
rigs/RIG.json                  calibrations, found by the id that a scene names
verifications/RIG/             verifications of rigs (see `storage.evidence.verifications`)
panels/PANEL/                  panel specifications in all their versions, and patterns enrolled from scans
reviews/                       what people decided (see `storage.review_keeping`), and saved queries
signed-off/SCENE_ID/RUN_ID     marks of runs that were signed off
parquet/                       link to the compacted tables for other engines
.staging/                      runs being written
.index/                        the generations of the index, the greatest run id, the lock
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from metrology.results import SceneKey

STORE_FORMAT = "flushline-store/1"
MANIFEST = "manifest.json"
"""The file of a bundle that names all others."""


@dataclass(frozen=True)
class Layout:
    """Paths of a store."""

    root: Path

    @property
    def marker(self) -> Path:
        """Says that the folder is a store."""
        return self.root / "flushline-store.json"

    @property
    def archive(self) -> Path:
        """The published index."""
        return self.root / "archive.duckdb"

    @property
    def bundles(self) -> Path:
        """All scene runs."""
        return self.root / "bundles"

    @property
    def rigs(self) -> Path:
        """Calibrations."""
        return self.root / "rigs"

    @property
    def verifications(self) -> Path:
        """Verifications of rigs."""
        return self.root / "verifications"

    @property
    def panels(self) -> Path:
        """Panel specifications and enrolled patterns."""
        return self.root / "panels"

    @property
    def parquet(self) -> Path:
        """Compacted tables."""
        return self.root / "parquet"

    @property
    def staging(self) -> Path:
        """Runs being written: a folder RUN_ID and beside it RUN_ID.json, which its writer holds locked."""
        return self.root / ".staging"

    @property
    def index(self) -> Path:
        """The generations of the index, and what writers need."""
        return self.root / ".index"

    @property
    def generations(self) -> Path:
        """Published generations of the index."""
        return self.index / "generations"

    @property
    def newest_run(self) -> Path:
        """Holds the greatest run id that was ever given."""
        return self.index / "newest-run"

    @property
    def lock(self) -> Path:
        """Held by whoever changes the index."""
        return self.index / "lock"

    def scene_folder(self, scene_id: str) -> Path:
        """Folder of a scene's runs, by the scene's id."""
        aircraft, _, rest = scene_id.partition("~")
        return self.bundles / aircraft / rest.partition("~")[0] / scene_id

    def scene(self, key: SceneKey) -> Path:
        """Folder of a scene's runs."""
        return self.bundles / key.aircraft_serial / key.panel / key.scene_id

    def relative(self, path: Path) -> str:
        """A path as the tables have it."""
        return path.relative_to(self.root).as_posix()


@dataclass(frozen=True)
class ScenePaths:
    """Files of a scene's current run."""

    bundle: Path
    """The run's folder, with its manifest, rig and tables."""
    cloud: Path
    overlay: Path
    preview: Path
