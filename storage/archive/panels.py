"""Panel specifications and enrolled patterns that a store keeps.

panels/PANEL/spec-0001.toml …       every version that was ever in force, unchanged; the highest number is in force
panels/PANEL/enrolled/STATION.toml  the pattern that a station's first scan enrolled; the name of a replaced one ends
                                    in .replaced-1, .replaced-2 …
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from metrology.errors import SpecError, StoreError
from metrology.panel import PanelLayout
from storage.archive.files import make_folders, sync, write_first
from storage.models import IDENTIFIER_PATTERN
from storage.panel_spec import PanelSpecification, load_panel_spec, pattern_toml

SEAL = b"# sha256 of the lines above: "
"""Begins the last line of a pattern that a person enrolled."""


@dataclass(frozen=True)
class SpecVersion:
    """A specification that is or was in force."""

    number: int
    path: Path


class PatternTaken(StoreError):
    """A scan was to be its station's pattern, but another one was stored first."""


class Panels:
    """The panels of a store.

    Parameters
    ----------
    root : Path
        The store's `panels` folder; made when something is kept.
    """

    def __init__(self, root: Path) -> None:
        self.root = Path(root)

    def names(self) -> list[str]:
        """Panels that have a specification or an enrolled pattern."""
        return sorted(folder.name for folder in self.root.glob("*") if folder.is_dir())

    def versions(self, panel: str) -> list[SpecVersion]:
        """Specifications of a panel, oldest first."""
        found = [(re.fullmatch(r"spec-(\d{4,})\.toml", path.name), path) for path in self._folder(panel).glob("spec-*")]
        return sorted((SpecVersion(int(name[1]), path) for name, path in found if name), key=lambda v: v.number)

    def in_force(self, panel: str) -> PanelSpecification | None:
        """A panel's newest specification."""
        versions = self.versions(panel)
        return load_panel_spec(versions[-1].path) if versions else None

    def add(self, path: Path) -> SpecVersion:
        """Put a specification in force; the one that is in force already is not added again."""
        specification = load_panel_spec(path)
        if specification.example:
            raise SpecError(f"{path}: found a specification marked as an example, expected one of your own")
        content = Path(path).read_bytes()
        folder = self._folder(specification.limits.panel)
        make_folders(folder, self.root.parent)
        while True:
            versions = self.versions(specification.limits.panel)
            if versions and versions[-1].path.read_bytes() == content:
                return versions[-1]
            number = versions[-1].number + 1 if versions else 1
            target = folder / f"spec-{number:04d}.toml"
            if write_first(target, content):
                return SpecVersion(number, target)

    def stations(self, panel: str) -> list[str]:
        """Stations with an enrolled pattern."""
        return sorted(path.stem for path in (self._folder(panel) / "enrolled").glob("*.toml"))

    def pattern_path(self, panel: str, station: str) -> Path:
        """Where the enrolled pattern of a station is kept."""
        return self._folder(panel) / "enrolled" / f"{_checked(station)}.toml"

    def pattern(self, panel: str, station: str) -> PanelLayout | None:
        """The enrolled pattern of a station."""
        path = self.pattern_path(panel, station)
        return load_panel_spec(path).layout if path.exists() else None

    def enrol(self, layout: PanelLayout, panel: str, station: str, scene_id: str, replace: bool = False) -> bool:
        """Keep the pattern of a station.

        Of scans enrolled at the same time the first one stays.

        Returns
        -------
        bool
            Whether this one is kept.
        """
        path = self.pattern_path(panel, station)
        make_folders(path.parent, self.root.parent)
        if replace and path.exists():
            number = 1 + len(list(path.parent.glob(f"{station}.replaced-*")))
            path.replace(path.with_name(f"{station}.replaced-{number}"))
            sync(path.parent)
        return write_first(path, _sealed(pattern_toml(layout, panel, "enrolled", scene_id)))

    def _folder(self, panel: str) -> Path:
        return self.root / _checked(panel)


def _sealed(text: str) -> bytes:
    """A pattern with a last line by which an alteration is told."""
    content = text.encode()
    return content + SEAL + sha256(content).hexdigest().encode() + b"\n"


def _checked(name: str) -> str:
    """An identifier: nothing else may become part of a path."""
    if not re.fullmatch(IDENTIFIER_PATTERN, name):
        raise StoreError(f"panel or station {name!r}: expected letters, digits, '.', '_' and '-' only")
    return name
