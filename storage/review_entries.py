"""Entries of the review log, what they are about, and what follows from all of them together."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from typing import Annotated, Any, Literal, NamedTuple, get_args

from pydantic import Field, model_validator

from storage.documents import utc_text
from storage.models import StrictModel, UtcTime
from storage.review_details import ADDED, NO_NUMBERS, Mark, Numbers, Signature, wrong_details
from storage.review_file import checksum

FORMAT = "flushline-review/1"
FORMAT_OF_CLOSES = "flushline-review/2"
FORMAT_OF_STRETCHES = "flushline-review/3"
FORMAT_OF_UNDOS = "flushline-review/4"
FORMAT_OF_DETAILS = "flushline-review/5"
"""Of entries that versions before closes, stretches, undos and `storage.review_details` cannot read; all others keep
the format they know."""
Disposition = Literal["use as is", "rework", "repair", "scrap", "re-scan"]
DISPOSITIONS: tuple[Disposition, ...] = get_args(Disposition)
ASKS_FOR_WORK: tuple[Disposition, ...] = ("rework", "repair", "re-scan")
"""What leaves work open, until a later scan passes or a person closes it."""
MAX_COMMENT = 4000
SHOWN_NUMBERS = ("value_mm", "tilt_deg", "width_mm")
"""What was shown of a finding that is compared with what another run measures."""
POSITIONS = "positions"
"""Of what was shown of a stretch: each of its positions."""
SHOWN_OF_POSITION = ("feature_id", "decision", "u95_mm", *SHOWN_NUMBERS)


class EntryModel(StrictModel):
    """The document of an entry, one line of JSON.

    `shown` holds what the person had before them: values, verdict, reason, revision of the limits, software version,
    settings and rig. A close says, as its comment, why the work that a disposition asked for is done; an undo, why the
    last disposition or close that holds does so no more, and the one before it does again. An entry about a stretch
    of a course holds, as `shown.positions`, id, verdict and values of each position: it is about all of them. A mark
    says, as its comment, why no fastener is there or what was missed; an unmark, why the mark that it takes back,
    named by its number, holds no more. Neither decides anything.
    """

    format: Literal[
        "flushline-review/1", "flushline-review/2", "flushline-review/3", "flushline-review/4", "flushline-review/5"
    ]
    number: Annotated[int, Field(ge=1)]
    at: UtcTime
    who: str
    action: Literal["disposition", "sign-off", "close", "undo", "mark", "unmark"]
    scene_id: str
    run_id: str
    feature_kind: str | None = None
    feature_id: str | None = None
    disposition: Disposition | None = None
    comment: str = ""
    shown: Annotated[dict[str, Any], Field(default_factory=dict)]
    previous: str
    numbers: Numbers | None = None
    mark: Mark | None = None
    takes_back: Annotated[int, Field(ge=1)] | None = None
    signature: Signature | None = None

    @model_validator(mode="after")
    def _check_format(self) -> EntryModel:
        stretch = Feature(self.feature_kind or "", self.feature_id or "").is_stretch
        detailed = any(getattr(self, name) is not None for name in ADDED)
        if (expected := format_of(self.action, stretch, detailed)) != self.format:
            raise ValueError(f"{expected} for a {self.action}{' of a stretch' if stretch else ''}")
        if wrong := wrong_details(self):
            raise ValueError(wrong)
        if stretch and not all(
            isinstance(each, dict) and isinstance(each.get("feature_id"), str)
            for each in self.shown.get(POSITIONS) or [None]
        ):
            raise ValueError("each position of a stretch with its feature_id")
        return self

    @property
    def document(self) -> str:
        """As it is written: without what its format does not have."""
        return self.model_dump_json(exclude={name for name in ADDED if getattr(self, name) is None})


def format_of(action: str, stretch: bool, detailed: bool = False) -> str:
    """Format of an entry: the oldest that has such entries.

    Parameters
    ----------
    detailed : bool
        Whether it has one of the parts of `storage.review_details`.
    """
    if detailed or action in ("mark", "unmark"):
        return FORMAT_OF_DETAILS
    if action == "undo":
        return FORMAT_OF_UNDOS
    return FORMAT_OF_STRETCHES if stretch else FORMAT_OF_CLOSES if action == "close" else FORMAT


class Entry(NamedTuple):
    """An entry of the log: its document, and what of it is asked for often."""

    number: int
    document: str
    """As it was written."""
    checksum: str
    """SHA-256 of the document."""
    format: str
    decided_at: str
    who: str
    action: str
    scene_id: str
    run_id: str
    feature_kind: str | None
    feature_id: str | None
    disposition: Disposition | None
    comment: str
    decided_verdict: str | None
    decided_value_mm: float | None
    decided_tilt_deg: float | None
    decided_width_mm: float | None
    """decided_verdict, decided_value_mm, decided_tilt_deg, decided_width_mm: of the finding as it was shown."""
    previous: str
    """Checksum of the entry before."""

    @classmethod
    def of_document(cls, document: str) -> Entry:
        """An entry from its document; pydantic's ValidationError where that is not one."""
        EntryModel.model_validate_json(document)
        said = json.loads(document)
        shown = said.get("shown", {})
        numbers = [_number(shown.get(name)) for name in SHOWN_NUMBERS]
        return cls._make(
            (said["number"], document, checksum(document.encode()), said["format"], said["at"], said["who"],
             said["action"], said["scene_id"], said["run_id"], said.get("feature_kind"), said.get("feature_id"),
             said.get("disposition"), said.get("comment", ""), _text(shown.get("decision")), *numbers,
             said["previous"])
        )  # fmt: skip

    @property
    def at(self) -> datetime:
        """When it was decided."""
        return datetime.fromisoformat(self.decided_at)

    @property
    def shown(self) -> dict[str, Any]:
        """What the person had before them."""
        shown: dict[str, Any] = json.loads(self.document).get("shown", {})
        return shown

    @property
    def feature(self) -> Feature | None:
        """What it is about; None where that is the scene."""
        return Feature(self.feature_kind, self.feature_id) if self.feature_kind and self.feature_id else None

    @property
    def parts(self) -> tuple[Entry, ...]:
        """The entry of a stretch as one of each position that it is about; any other entry alone."""
        has_stretches = self.format in (FORMAT_OF_STRETCHES, FORMAT_OF_UNDOS, FORMAT_OF_DETAILS)
        if not has_stretches or not (self.feature and self.feature.is_stretch):
            return (self,)
        return tuple(
            self._replace(
                feature_id=each["feature_id"],
                decided_verdict=_text(each.get("decision")),
                decided_value_mm=_number(each.get("value_mm")),
                decided_tilt_deg=_number(each.get("tilt_deg")),
                decided_width_mm=_number(each.get("width_mm")),
            )
            for each in self.shown[POSITIONS]
        )

    @property
    def what(self) -> str:
        """What was decided."""
        if self.action == "mark":
            return "no fastener here" if self.feature else "fastener missed"
        done = {
            "sign-off": "signed off",
            "close": "work closed",
            "undo": "decision undone",
            "unmark": "mark taken back",
        }
        return done.get(self.action, str(self.disposition))

    @property
    def numbers(self) -> Numbers:
        """Concession, part and work order of a disposition."""
        said = self._detail("numbers")
        return NO_NUMBERS if said is None else Numbers.model_validate(said)

    @property
    def mark(self) -> Mark | None:
        """What a person marked; None for all other entries."""
        said = self._detail("mark")
        return None if said is None else Mark.model_validate(said)

    @property
    def takes_back(self) -> int | None:
        """Number of the mark that this entry takes back."""
        number: int | None = self._detail("takes_back")
        return number

    @property
    def signature(self) -> Signature | None:
        """Role and meaning of a signature; None of other entries, and of versions that did not ask."""
        said = self._detail("signature")
        return None if said is None else Signature.model_validate(said)

    def _detail(self, name: str) -> Any:
        return json.loads(self.document).get(name) if self.format == FORMAT_OF_DETAILS else None

    @property
    def said(self) -> str:
        """What was decided, by whom and when, in one line."""
        return f"{self.what} by {self.who} at {utc_text(self.at)}"


# From and to along a course, where they are written as ids are; no other id ends so.
_STRETCH_ID = re.compile(r"@-?\d+\.\d-(?=-?\d+\.\d$)")


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None


def _text(value: object) -> str | None:
    return value if isinstance(value, str) else None


@dataclass(frozen=True)
class Feature:
    """A feature of a scene, such as a rivet, a position along a seam, or a stretch of positions."""

    kind: str
    """Name of its kind."""
    id: str
    """As the kind makes it (`metrology.kinds.Kind.id_of`); of a stretch ``COURSE@FROM-TO``."""

    @property
    def is_stretch(self) -> bool:
        """Whether it is several positions of a course."""
        return _STRETCH_ID.search(self.id) is not None


_Held = dict[tuple[str, Feature], tuple[Entry, ...]]


@dataclass(frozen=True)
class Review:
    """All that was decided so far."""

    entries: tuple[Entry, ...] = ()
    """From the first to the last."""
    problem: str | None = None
    """Where the log was damaged or changed; entries before that place only are given."""

    def with_more(self, entries: Sequence[Entry]) -> Review:
        """A review that goes on with further entries; what is known of the former ones is not looked for again."""
        more = Review(tuple(entries))
        longer = Review(self.entries + more.entries)
        for name in ("_sign_offs", "_last_by_feature", "_last_by_scene", "_marks", "_taken_back"):
            if name in self.__dict__:
                longer.__dict__[name] = {**self.__dict__[name], **getattr(more, name)}
        if "_held" in self.__dict__:
            longer.__dict__["_held"] = _held_after(self._held, more.entries)
        return longer

    def current(self) -> dict[tuple[str, Feature], Entry]:
        """The last disposition of each feature that holds, by scene and feature: of a stretch, of each position."""
        return self._dispositions

    def sign_offs(self) -> dict[str, Entry]:
        """The sign-off of each scene that has one."""
        return self._sign_offs

    def work(self) -> dict[tuple[str, Feature], Entry]:
        """Last dispositions that asked for work which no person closed; whether a later scan passed, a store knows."""
        return self._work

    def closes(self) -> dict[tuple[str, Feature], Entry]:
        """The close of each feature whose work a person closed, and about which nothing was decided since."""
        return {key: held[-1] for key, held in self._held.items() if held[-1].action == "close"}

    def held(self, scene_id: str, feature: Feature) -> tuple[Entry, ...]:
        """Dispositions and closes of a feature that nobody undid, the last one last."""
        return self._held.get((scene_id, feature), ())

    def undoable(self, scene_id: str, *features: Feature) -> Entry | None:
        """The disposition or close that an undo would take back: the last that holds, of all these features alike."""
        held = [self.held(scene_id, feature) for feature in features]
        last = {entries[-1].number: entries[-1] for entries in held if entries}
        return next(iter(last.values())) if len(last) == 1 and all(held) else None

    def marks(self) -> list[tuple[Entry, Entry | None]]:
        """Every mark that a person made, the first one first, and what took it back."""
        return [(entry, self._taken_back.get(number)) for number, entry in self._marks.items()]

    def standing_marks(self, scene_id: str) -> list[Entry]:
        """Marks of a scene that nobody took back."""
        return [entry for entry, back in self.marks() if back is None and entry.scene_id == scene_id]

    def last_about(self, scene_id: str, *features: Feature) -> Entry | None:
        """The last entry about any of some features of a scene; of a stretch all positions are to be named."""
        found = (self._last_by_feature.get((scene_id, feature)) for feature in features)
        return max((entry for entry in found if entry), key=lambda entry: entry.number, default=None)

    def last_of_scene(self, scene_id: str) -> int:
        """Number of the last entry about a scene or one of its features; 0 for none."""
        last = self.last_entry_of_scene(scene_id)
        return last.number if last else 0

    def last_entry_of_scene(self, scene_id: str) -> Entry | None:
        """The last entry about a scene or one of its features."""
        return self._last_by_scene.get(scene_id)

    @cached_property
    def _dispositions(self) -> dict[tuple[str, Feature], Entry]:
        last = {
            key: next((entry for entry in reversed(held) if entry.action == "disposition"), None)
            for key, held in self._held.items()
        }
        return {key: entry for key, entry in last.items() if entry}

    @cached_property
    def _held(self) -> _Held:
        """Dispositions and closes of each feature that nobody undid, the last one last."""
        return _held_after({}, self.entries)

    @cached_property
    def _sign_offs(self) -> dict[str, Entry]:
        return {entry.scene_id: entry for entry in self.entries if entry.action == "sign-off"}

    @cached_property
    def _marks(self) -> dict[int, Entry]:
        return {entry.number: entry for entry in self.entries if entry.action == "mark"}

    @cached_property
    def _taken_back(self) -> dict[int, Entry]:
        return {entry.takes_back or 0: entry for entry in self.entries if entry.action == "unmark"}

    @cached_property
    def _work(self) -> dict[tuple[str, Feature], Entry]:
        return {
            key: held[-1]
            for key, held in self._held.items()
            if held[-1].action == "disposition" and held[-1].disposition in ASKS_FOR_WORK
        }

    @cached_property
    def _last_by_feature(self) -> dict[tuple[str, Feature], Entry]:
        return {(part.scene_id, part.feature): part for entry in self.entries for part in entry.parts if part.feature}

    @cached_property
    def _last_by_scene(self) -> dict[str, Entry]:
        return {entry.scene_id: entry for entry in self.entries}


def _held_after(held: _Held, entries: Sequence[Entry]) -> _Held:
    """What holds of each feature after further entries: an undo takes the last one away."""
    after = dict(held)
    for part in (part for entry in entries for part in entry.parts):
        if part.feature and part.action not in ("mark", "unmark"):
            key = (part.scene_id, part.feature)
            before = after.pop(key, ())
            now = before[:-1] if part.action == "undo" else (*before, part)
            if now:
                after[key] = now
    return after
