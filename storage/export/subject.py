"""What is exported: a scene, or the newest scans of a panel's stations, as characteristics with values and limits."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any
from uuid import UUID, uuid5

from metrology.errors import StoreError
from metrology.kinds import KINDS, Kind, Quantity
from metrology.limits import Limit, PanelSpec
from metrology.panel import Placement
from metrology.requirements import downstream_of, limit_of
from metrology.results import Decision
from metrology.verdicts import DECISIONS, IN_ORDER, gravity
from storage.archive.bundle import MANIFEST
from storage.archive.rows import named_rows
from storage.archive.store import Store
from storage.documents import read_json
from storage.panel_spec import judged_by

Row = Mapping[str, Any]

NAMESPACE = UUID("6f1c7a52-7a41-5e0e-9a35-0f1d8a1f6f10")
"""Of every UUID that Flushline gives: the same thing has the same one in every export."""


def stable_uuid(*parts: object) -> UUID:
    """The UUID of a thing, from the words that name it."""
    return uuid5(NAMESPACE, "\x1f".join(map(str, parts)))


@dataclass(frozen=True)
class ExportedScene:
    """A scene with what its files say."""

    row: Row
    """Its row of the table scenes."""
    limits: PanelSpec | None
    """As it was judged by; None where this version cannot read them."""
    placement: Placement | None
    """Rig frame to the panel's frame; None where the scene was not recognised by a specification's pattern."""
    features: Mapping[str, tuple[Row, ...]]
    """mapping of str to tuple of rows: by the name of the kind, in the order of their ids."""

    @property
    def scene_id(self) -> str:
        """Its id."""
        return str(self.row["scene_id"])


@dataclass(frozen=True)
class Characteristic:
    """One quantity of one feature of a scene, numbered within what is exported."""

    number: int
    """From 1."""
    kind: Kind
    quantity: Quantity
    feature: str
    """Id within the scene."""
    row: Row
    """The feature's row."""
    scene: ExportedScene
    value: float | None
    u95: float | None
    """value, u95: None where it was not measured."""
    limit: Limit | None
    decision: Decision
    """Of this quantity alone."""

    @property
    def uuid(self) -> UUID:
        """Names the characteristic of the panel's design; the same on every aircraft and in every export."""
        scene = self.scene.row
        return stable_uuid("characteristic", scene["panel"], scene["station"], *self.path)

    @property
    def path(self) -> tuple[str, str, str]:
        """Kind, feature, quantity."""
        return self.kind.name, self.feature, self.quantity.name


@dataclass(frozen=True)
class Subject:
    """A scene, or the newest scans of a panel's stations."""

    name: str
    """Begins the names of its files."""
    aircraft_serial: str
    panel: str
    scenes: tuple[ExportedScene, ...]

    @cached_property
    def characteristics(self) -> tuple[Characteristic, ...]:
        """Every quantity of every feature: scene by scene, kind by kind."""
        numbered = enumerate((c for scene in self.scenes for c in _measured(scene)), 1)
        return tuple(Characteristic(number, *parts) for number, parts in numbered)

    @cached_property
    def lines(self) -> tuple[Characteristic, ...]:
        """The same for a person: of each stretch of a course one line for a quantity, with its worst value.

        Positions that simply pass are one line together. Lines are numbered anew.
        """
        groups: dict[tuple[str, str, str, str], list[Characteristic]] = {}
        for c in self.characteristics:
            groups.setdefault((c.scene.scene_id, c.kind.name, _line_of(c), c.quantity.name), []).append(c)
        found = []
        for number, ((_, _, name, _), group) in enumerate(groups.items(), 1):
            decision = min((c.row["decision"] for c in group), key=gravity)
            worst = max(group, key=_beyond)
            found.append(replace(worst, number=number, feature=name, row={**worst.row, "decision": decision}))
        return tuple(found)

    @property
    def features(self) -> Iterator[Row]:
        """The rows of all features."""
        return (row for scene in self.scenes for rows in scene.features.values() for row in rows)

    @property
    def decision(self) -> str:
        """The gravest decision of its features; "not measured" where there is none."""
        return min((row["decision"] for row in self.features), key=gravity, default="not measured")

    @property
    def counts(self) -> dict[str, int]:
        """How often each decision occurs."""
        found = [row["decision"] for row in self.features]
        return {decision: found.count(decision) for decision in DECISIONS if decision in found}


def scene_subject(store: Store, scene_id: str) -> Subject:
    """A scene's current run."""
    found = _subjects(store, "SELECT * FROM scenes WHERE scene_id = ?", [scene_id])
    for scene in found:
        return Subject(scene.scene_id, scene.row["aircraft_serial"], scene.row["panel"], (scene,))
    raise StoreError(f"{store.root}: found no scene {scene_id!r}, expected a scene_id of the table scenes")


def panel_subject(store: Store, aircraft_serial: str, panel: str) -> Subject:
    """The newest scan of each station of a panel."""
    query = "SELECT * FROM latest_scenes WHERE aircraft_serial = ? AND panel = ? ORDER BY station"
    scenes = tuple(_subjects(store, query, [aircraft_serial, panel]))
    if not scenes:
        raise StoreError(f"{store.root}: found no scene of {aircraft_serial} {panel}, expected at least one")
    return Subject(f"{aircraft_serial}~{panel}", aircraft_serial, panel, scenes)


def panels_of(store: Store, aircraft_serial: str) -> list[str]:
    """The panels of an aircraft."""
    with contextlib.closing(store.connect()) as connection:
        found = connection.execute(
            "SELECT DISTINCT panel FROM scenes WHERE aircraft_serial = ? ORDER BY panel", [aircraft_serial]
        ).fetchall()
    if not found:
        raise StoreError(f"{store.root}: found no scene of aircraft {aircraft_serial!r}, expected at least one")
    return [panel for (panel,) in found]


def _subjects(store: Store, sql: str, values: list[str]) -> Iterator[ExportedScene]:
    with contextlib.closing(store.connect()) as connection:
        scenes = named_rows(connection, sql, values)
        names = [scene["scene_id"] for scene in scenes]
        features = {
            kind.name: named_rows(
                connection,
                f"SELECT * FROM {kind.table} WHERE list_contains(?, scene_id) ORDER BY {', '.join(kind.id_columns)}",
                [names],
            )
            for kind in KINDS
        }
    for scene in scenes:
        path = store.file(f"{scene['bundle_path']}/{MANIFEST}")
        manifest = read_json(path, StoreError)
        own = {
            name: tuple(row for row in rows if row["scene_id"] == scene["scene_id"]) for name, rows in features.items()
        }
        yield ExportedScene(scene, judged_by(manifest, path), _placement(manifest, scene), own)


def _placement(manifest: Mapping[str, Any], scene: Row) -> Placement | None:
    """Where the panel's frame is that of a specification, and not of the scan that the station enrolled."""
    spec, found = manifest.get("panel_spec") or {}, (manifest.get("registration") or {}).get("placement")
    common = bool(spec.get("rivets") or spec.get("seams")) and spec.get("panel") == scene["panel"]
    return Placement(found["R"], found["t_mm"]) if found and common else None


def _measured(scene: ExportedScene) -> Iterator[tuple[Any, ...]]:
    for kind in KINDS:
        for row in scene.features[kind.name]:
            for quantity in kind.quantities:
                value, u95 = row[quantity.column], row[quantity.u95_column]
                zone = scene.limits.zone(row["zone"]) if scene.limits else {}
                limit = limit_of(zone, quantity, downstream_of(quantity, row))
                decision = _decision(value, u95, limit)
                yield kind, quantity, kind.id_of(row), row, scene, value, u95, limit, decision


def _line_of(c: Characteristic) -> str:
    """The name of what a characteristic is listed with."""
    if not c.kind.is_course:
        return c.feature
    passes = c.row["decision"] in IN_ORDER
    return str(c.row[c.kind.id_columns[0]] if passes else c.row.get("stretch") or c.feature)


def _beyond(c: Characteristic) -> tuple[bool, float]:
    """How far a value lies beyond its limit or, without one, its amount; what was not measured is never the worst."""
    if c.value is None:
        return False, 0.0
    return True, abs(c.value) if c.limit is None else -c.limit.margin(c.value)


def _decision(value: float | None, u95: float | None, limit: Limit | None) -> Decision:
    if value is None or (limit is not None and u95 is None):
        return "not measured"
    return limit.decision(value, u95 or 0.0) if limit else "no limit"
