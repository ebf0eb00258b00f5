"""What people decided about findings: an append-only log of dispositions and sign-offs beside the archive.

`reviews/log.jsonl` in the store has one JSON object per line. A line is never changed or removed; each names the
checksum of the one before it, so a change made behind Flushline's back shows. Measurements are not touched by this.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, ValidationError

from metrology.errors import StoreError, UsageError
from storage.archive.files import locked, sync
from storage.documents import utc_text
from storage.models import StrictModel, UtcTime

FORMAT = "flushline-review/1"
Disposition = Literal["use as is", "rework", "repair", "scrap", "re-scan"]
DISPOSITIONS: tuple[Disposition, ...] = get_args(Disposition)
FeatureKind = Literal["rivet", "seam station"]

_FIRST = "0" * 64
MAX_COMMENT = 4000


class Entry(StrictModel):
    """A line of the log.

    `shown` holds what the person had before them: values, verdict, reason, revision of the limits, software version,
    settings and rig.
    """

    format: Literal["flushline-review/1"]
    number: Annotated[int, Field(ge=1)]
    at: UtcTime
    who: str
    action: Literal["disposition", "sign-off"]
    scene_id: str
    run_id: str
    feature_kind: FeatureKind | None = None
    feature_id: str | None = None
    disposition: Disposition | None = None
    comment: str = ""
    shown: Annotated[dict[str, Any], Field(default_factory=dict)]
    previous: str


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
            (entry.scene_id, Feature(entry.feature_kind, entry.feature_id)): entry
            for entry in self.entries
            if entry.action == "disposition" and entry.feature_kind and entry.feature_id
        }

    def sign_offs(self) -> dict[str, Entry]:
        """The sign-off of each scene that has one."""
        return {entry.scene_id: entry for entry in self.entries if entry.action == "sign-off"}


class ReviewLog:
    """The log of a store.

    Parameters
    ----------
    root : Path
        The store's folder.
    """

    def __init__(self, root: Path) -> None:
        self.path = Path(root) / "reviews" / "log.jsonl"

    @property
    def version(self) -> tuple[int, int]:
        """Changes with every new entry: size and time of the file."""
        try:
            status = self.path.stat()
        except OSError:
            return 0, 0
        return status.st_size, status.st_mtime_ns

    def read(self) -> Review:
        """Everything decided so far; a damaged or changed log is read up to that place."""
        return _parse(self._content(), self.path)

    def dispose(
        self,
        who: str,
        scene_id: str,
        run_id: str,
        features: Iterable[Feature],
        disposition: Disposition,
        comment: str,
        shown: Mapping[Feature, Mapping[str, Any]],
    ) -> list[Entry]:
        """Record what shall happen with features of one scene; refused where the scene is signed off.

        Parameters
        ----------
        shown : mapping
            What the person had before them, by feature.
        """
        if disposition not in DISPOSITIONS:
            raise UsageError(f"disposition: found {disposition!r}, expected one of {', '.join(DISPOSITIONS)}")
        wanted = [
            {
                "action": "disposition",
                "feature_kind": feature.kind,
                "feature_id": feature.id,
                "disposition": disposition,
                "shown": dict(shown.get(feature, {})),
            }
            for feature in features
        ]
        if not wanted:
            raise UsageError("disposition: found no feature, expected at least one")
        return self._append(who, scene_id, run_id, comment, wanted)

    def sign_off(self, who: str, scene_id: str, run_id: str, comment: str, shown: Mapping[str, Any]) -> Entry:
        """Close a scene: from now on its dispositions and the run that was signed off stay as they are.

        `storage.archive.sign_off` also sees to it that the archive still shows that run.
        """
        return self._append(who, scene_id, run_id, comment, [{"action": "sign-off", "shown": dict(shown)}])[0]

    def _append(self, who: str, scene_id: str, run_id: str, comment: str, wanted: list[dict[str, Any]]) -> list[Entry]:
        if not who.strip():
            raise UsageError("review: found no name, expected who decides")
        if len(comment) > MAX_COMMENT:
            raise UsageError(f"review: found a comment of {len(comment)} characters, expected at most {MAX_COMMENT}")
        try:
            self.path.parent.mkdir(exist_ok=True)
            with locked(self.path.parent / ".lock"):
                return self._append_locked(who.strip(), scene_id, run_id, comment.strip(), wanted)
        except OSError as problem:
            raise StoreError(
                f'{self.path}: found "{problem.strerror}", expected a review log that can be written'
            ) from None

    def _append_locked(
        self, who: str, scene_id: str, run_id: str, comment: str, wanted: list[dict[str, Any]]
    ) -> list[Entry]:
        content = self._content()
        review = _parse(content, self.path)
        if review.problem:
            raise StoreError(f"{review.problem}; nothing more is written to it until that is cleared up")
        if closed := review.sign_offs().get(scene_id):
            raise UsageError(
                f"{scene_id}: found it signed off by {closed.who} at {utc_text(closed.at)}, expected an open scene"
            )
        previous = _checksum(content.splitlines()[-1]) if content else _FIRST
        lines: list[bytes] = []
        entries: list[Entry] = []
        for part in wanted:
            entry = Entry.model_validate(
                {
                    "format": FORMAT,
                    "number": len(review.entries) + len(entries) + 1,
                    "at": datetime.now(UTC),
                    "who": who,
                    "scene_id": scene_id,
                    "run_id": run_id,
                    "comment": comment,
                    "previous": previous,
                    **part,
                }
            )
            line = entry.model_dump_json().encode()
            previous = _checksum(line)
            lines.append(line + b"\n")
            entries.append(entry)
        self._write(b"".join(lines), len(content))
        return entries

    def _write(self, lines: bytes, length: int) -> None:
        """Append after `length` bytes; what lies beyond them is a write that a crash cut short."""
        fresh = not self.path.exists()
        descriptor = os.open(self.path, os.O_WRONLY | os.O_CREAT, 0o666)
        try:
            os.ftruncate(descriptor, length)
            os.lseek(descriptor, length, os.SEEK_SET)
            written = 0
            while written < len(lines):
                written += os.write(descriptor, lines[written:])
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        if fresh:
            sync(self.path.parent)

    def _content(self) -> bytes:
        """The complete lines of the file."""
        try:
            content = self.path.read_bytes()
        except FileNotFoundError:
            return b""
        except OSError as problem:
            raise StoreError(f'{self.path}: found "{problem.strerror}", expected a readable review log') from None
        return content[: content.rfind(b"\n") + 1]


def _parse(content: bytes, path: Path) -> Review:
    entries: list[Entry] = []
    previous = _FIRST
    for number, line in enumerate(content.splitlines(), start=1):
        try:
            entry = Entry.model_validate_json(line)
        except ValidationError:
            return Review(tuple(entries), f"{path}: found line {number} damaged, expected an entry of {FORMAT}")
        if entry.number != number or entry.previous != previous:
            return Review(
                tuple(entries), f"{path}: found the lines before line {number} changed, expected them as written"
            )
        entries.append(entry)
        previous = _checksum(line)
    return Review(tuple(entries))


def _checksum(line: bytes) -> str:
    return hashlib.sha256(line).hexdigest()
