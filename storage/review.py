"""What people decided about findings: an append-only log of dispositions and sign-offs beside the archive.

`reviews/log.jsonl` in the store has one JSON object per line. A line is never changed or removed; each names the
checksum of the one before it, so a change made behind Flushline's back shows. Measurements are not touched by this.

A decision is about what was on the screen: whoever records one says what was shown, and it is refused where somebody
else decided since. `storage.archive.decisions` also sees to it that the archive still shows the same values.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from metrology.errors import OutdatedError, StoreError, UsageError
from storage.archive.files import locked
from storage.review_entries import (
    ASKS_FOR_WORK,
    DISPOSITIONS,
    FORMAT,
    FORMAT_OF_CLOSES,
    MAX_COMMENT,
    Disposition,
    Entry,
    Feature,
    FeatureKind,
    Review,
    ShownFinding,
    ShownScene,
    station_id,
)
from storage.review_file import FIRST, ReviewFile, checksum, last_checksum

__all__ = [
    "ASKS_FOR_WORK",
    "DISPOSITIONS",
    "MAX_COMMENT",
    "Disposition",
    "Entry",
    "Feature",
    "FeatureKind",
    "Review",
    "ReviewLog",
    "ShownFinding",
    "ShownScene",
    "station_id",
]

Check = Callable[[Review], None]
"""Raises where what was decided so far forbids an entry."""


class ReviewLog:
    """The log of a store.

    Parameters
    ----------
    root : Path
        The store's folder.
    """

    def __init__(self, root: Path) -> None:
        self.path = Path(root) / "reviews" / "log.jsonl"
        self._file = ReviewFile(self.path)

    @property
    def version(self) -> tuple[int, int]:
        """Changes with every new entry."""
        return self._file.version

    def read(self) -> Review:
        """Everything decided so far; a damaged or changed log is read up to that place."""
        return _parse(self._file.content(), self.path)

    def dispose(
        self, who: str, shown: Sequence[ShownFinding], disposition: Disposition, comment: str = ""
    ) -> list[Entry]:
        """Record what shall happen with findings: with all of them or, where one is refused, with none.

        Refused where the scene is signed off, or where something was decided about a finding since it was shown.
        """
        if disposition not in DISPOSITIONS:
            raise UsageError(f"disposition: found {disposition!r}, expected one of {', '.join(DISPOSITIONS)}")
        if not shown:
            raise UsageError("disposition: found no feature, expected at least one")
        wanted = [{**_of_feature(s), "action": "disposition", "disposition": disposition} for s in shown]

        def check(review: Review) -> None:
            for finding in shown:
                _check_open(review, finding.scene_id)
                _check_undecided_since(review, finding)

        return self._append(who, comment, wanted, check)

    def close(self, who: str, shown: Sequence[ShownFinding], reason: str) -> list[Entry]:
        """Record why the work that the last disposition of features asked for is done, or is not needed any more.

        Refused where a feature has no open work, or where something was decided about it since it was shown.
        """
        if not reason.strip():
            raise UsageError("close: found no reason, expected why the work is done")
        if not shown:
            raise UsageError("close: found no feature, expected at least one")
        wanted = [{**_of_feature(s), "action": "close", "format": FORMAT_OF_CLOSES} for s in shown]

        def check(review: Review) -> None:
            work = review.work()
            for finding in shown:
                _check_undecided_since(review, finding)
                if (finding.scene_id, finding.feature) not in work:
                    raise UsageError(
                        f"{finding.scene_id} {finding.feature.id}: found no open work, expected a disposition such as "
                        f"{' or '.join(ASKS_FOR_WORK)} that nobody closed"
                    )

        return self._append(who, reason, wanted, check)

    def sign_off(self, who: str, shown: ShownScene, comment: str = "") -> Entry:
        """Close a scene: from now on its dispositions and the run that was signed off stay as they are.

        Refused where something was decided about the scene since it was shown. `storage.archive.decisions` also sees
        to it that the archive still shows that run, and that nothing of the scene waits.
        """
        wanted = {
            "action": "sign-off",
            "scene_id": shown.scene_id,
            "run_id": shown.run_id,
            "shown": dict(shown.values),
        }

        def check(review: Review) -> None:
            _check_open(review, shown.scene_id)
            if review.last_of_scene(shown.scene_id) != shown.last_entry:
                last = review.entries[review.last_of_scene(shown.scene_id) - 1]
                about = f"{last.feature.id} " if last.feature else ""
                raise OutdatedError(
                    f"{shown.scene_id}: found that {about}was decided since it was shown ({last.said}), expected the "
                    "decisions that were on the screen"
                )

        return self._append(who, comment, [wanted], check)[0]

    def _append(self, who: str, comment: str, wanted: list[dict[str, Any]], check: Check) -> list[Entry]:
        if not who.strip():
            raise UsageError("review: found no name, expected who decides")
        if len(comment) > MAX_COMMENT:
            raise UsageError(f"review: found a comment of {len(comment)} characters, expected at most {MAX_COMMENT}")
        same = {"who": who.strip(), "comment": comment.strip()}
        try:
            self.path.parent.mkdir(exist_ok=True)
            with locked(self.path.parent / ".lock"):
                return self._append_locked([{**same, **part} for part in wanted], check)
        except OSError as problem:
            raise StoreError(
                f'{self.path}: found "{problem.strerror}", expected a review log that can be written'
            ) from None

    def _append_locked(self, wanted: list[dict[str, Any]], check: Check) -> list[Entry]:
        content = self._file.content()
        review = _parse(content, self.path)
        if review.problem:
            raise StoreError(f"{review.problem}; nothing more is written to it until that is cleared up")
        check(review)
        previous = last_checksum(content)
        lines: list[bytes] = []
        entries: list[Entry] = []
        for number, part in enumerate(wanted, start=len(review.entries) + 1):
            entry = Entry.model_validate(
                {"format": FORMAT, "number": number, "at": datetime.now(UTC), "previous": previous, **part}
            )
            line = entry.model_dump_json().encode()
            previous = checksum(line)
            lines.append(line + b"\n")
            entries.append(entry)
        self._file.append(b"".join(lines), len(content))
        return entries


def _of_feature(shown: ShownFinding) -> dict[str, Any]:
    return {
        "scene_id": shown.scene_id,
        "run_id": shown.run_id,
        "feature_kind": shown.feature.kind,
        "feature_id": shown.feature.id,
        "shown": dict(shown.values),
    }


def _check_open(review: Review, scene_id: str) -> None:
    if signed := review.sign_offs().get(scene_id):
        raise UsageError(f"{scene_id}: found it {signed.said}, expected an open scene")


def _check_undecided_since(review: Review, shown: ShownFinding) -> None:
    last = review.last_about(shown.scene_id, shown.feature)
    if (last.number if last else 0) != shown.last_entry:
        found = f"decided since it was shown ({last.said})" if last else "shown with a decision that the log lacks"
        raise OutdatedError(f"{shown.scene_id} {shown.feature.id}: found it {found}, expected it as it was shown")


def _parse(content: bytes, path: Path) -> Review:
    entries: list[Entry] = []
    previous = FIRST
    for number, line in enumerate(content.splitlines(), start=1):
        try:
            entry = Entry.model_validate_json(line)
        except ValidationError:
            known = f"{FORMAT} or {FORMAT_OF_CLOSES}"
            return Review(tuple(entries), f"{path}: found line {number} damaged, expected an entry of {known}")
        if entry.number != number or entry.previous != previous:
            return Review(
                tuple(entries), f"{path}: found the lines before line {number} changed, expected them as written"
            )
        entries.append(entry)
        previous = checksum(line)
    return Review(tuple(entries))
