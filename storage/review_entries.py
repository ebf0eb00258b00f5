"""Entries of the review log, what they are about, and what follows from all of them together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, model_validator

from storage.documents import utc_text
from storage.models import StrictModel, UtcTime

FORMAT = "flushline-review/1"
FORMAT_OF_CLOSES = "flushline-review/2"
"""Of entries that versions before closes cannot read; all others keep the format that they know."""
Disposition = Literal["use as is", "rework", "repair", "scrap", "re-scan"]
DISPOSITIONS: tuple[Disposition, ...] = get_args(Disposition)
ASKS_FOR_WORK: tuple[Disposition, ...] = ("rework", "repair", "re-scan")
"""What leaves work open, until a later scan passes or a person closes it."""
FeatureKind = Literal["rivet", "seam station"]
MAX_COMMENT = 4000


class Entry(StrictModel):
    """A line of the log.

    `shown` holds what the person had before them: values, verdict, reason, revision of the limits, software version,
    settings and rig. A close says, as its comment, why the work that a disposition asked for is done.
    """

    format: Literal["flushline-review/1", "flushline-review/2"]
    number: Annotated[int, Field(ge=1)]
    at: UtcTime
    who: str
    action: Literal["disposition", "sign-off", "close"]
    scene_id: str
    run_id: str
    feature_kind: FeatureKind | None = None
    feature_id: str | None = None
    disposition: Disposition | None = None
    comment: str = ""
    shown: Annotated[dict[str, Any], Field(default_factory=dict)]
    previous: str

    @model_validator(mode="after")
    def _check_format(self) -> Entry:
        if (self.action == "close") != (self.format == FORMAT_OF_CLOSES):
            raise ValueError(f"{FORMAT_OF_CLOSES} for a close, {FORMAT} for all else")
        return self

    @property
    def feature(self) -> Feature | None:
        """What it is about; None where that is the scene."""
        return Feature(self.feature_kind, self.feature_id) if self.feature_kind and self.feature_id else None

    @property
    def what(self) -> str:
        """What was decided."""
        return {"sign-off": "signed off", "close": "work closed"}.get(self.action, str(self.disposition))

    @property
    def said(self) -> str:
        """What was decided, by whom and when, in one line."""
        return f"{self.what} by {self.who} at {utc_text(self.at)}"


@dataclass(frozen=True)
class Feature:
    """A rivet, or a position along a seam, of a scene.

    Attributes
    ----------
    kind : "rivet" or "seam station"
    id : str
        rivet_id, or seam_id@s_mm with one decimal.
    """

    kind: FeatureKind
    id: str


def station_id(seam_id: str, s_mm: float) -> str:
    """Name of a seam station within its scene, such as ``S1@24.0``."""
    return f"{seam_id}@{s_mm:.1f}"


@dataclass(frozen=True)
class ShownFinding:
    """A finding as a person had it before them.

    Attributes
    ----------
    scene_id, run_id : str
    feature : Feature
    values : mapping
        What was shown, as JSON knows it.
    last_entry : int
        Number of the last entry about the feature that was shown; 0 for none.
    """

    scene_id: str
    run_id: str
    feature: Feature
    values: Mapping[str, Any] = field(default_factory=dict)
    last_entry: int = 0


@dataclass(frozen=True)
class ShownScene:
    """A scene with its decisions as a person had them before them.

    Attributes
    ----------
    scene_id, run_id : str
    values : mapping
    last_entry : int
        Number of the last entry about the scene or one of its features that was shown; 0 for none.
    """

    scene_id: str
    run_id: str
    values: Mapping[str, Any] = field(default_factory=dict)
    last_entry: int = 0


@dataclass(frozen=True)
class Review:
    """All that was decided so far.

    Attributes
    ----------
    entries : tuple of Entry
        From the first to the last.
    problem : str or None
        Where the log was damaged or changed; entries before that place only are given.
    """

    entries: tuple[Entry, ...] = ()
    problem: str | None = None

    def current(self) -> dict[tuple[str, Feature], Entry]:
        """The last disposition of each feature, by scene and feature."""
        return {
            (entry.scene_id, entry.feature): entry
            for entry in self.entries
            if entry.action == "disposition" and entry.feature
        }

    def sign_offs(self) -> dict[str, Entry]:
        """The sign-off of each scene that has one."""
        return {entry.scene_id: entry for entry in self.entries if entry.action == "sign-off"}

    def work(self) -> dict[tuple[str, Feature], Entry]:
        """Last dispositions that asked for work which no person closed; whether a later scan passed, a store knows."""
        return {
            key: entry
            for key, entry in self._last_by_feature.items()
            if entry.action == "disposition" and entry.disposition in ASKS_FOR_WORK
        }

    def closes(self) -> dict[tuple[str, Feature], Entry]:
        """The close of each feature whose work a person closed, and about which nothing was decided since."""
        return {key: entry for key, entry in self._last_by_feature.items() if entry.action == "close"}

    def last_about(self, scene_id: str, feature: Feature) -> Entry | None:
        """The last entry about a feature of a scene."""
        return self._last_by_feature.get((scene_id, feature))

    def last_of_scene(self, scene_id: str) -> int:
        """Number of the last entry about a scene or one of its features; 0 for none."""
        return self._last_by_scene.get(scene_id, 0)

    @cached_property
    def _last_by_feature(self) -> dict[tuple[str, Feature], Entry]:
        return {(entry.scene_id, entry.feature): entry for entry in self.entries if entry.feature}

    @cached_property
    def _last_by_scene(self) -> dict[str, int]:
        return {entry.scene_id: entry.number for entry in self.entries}
