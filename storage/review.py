"""What people decided about findings: an append-only log of dispositions and sign-offs beside the archive.

An entry is a JSON document in a database (`storage.review_database`). It is never changed or removed; each names the
checksum of the one before it, so a change made behind Flushline's back shows. Measurements are not touched by this.

A decision is about what was on the screen: whoever records one says what was shown, and it is refused where somebody
else decided since. `storage.archive.decisions` also sees to it that the archive still shows the same values.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrology.errors import OutdatedError, UsageError
from storage.review_details import Mark, MarkKind, Numbers, Signature
from storage.review_entries import (
    ASKS_FOR_WORK,
    DISPOSITIONS,
    MAX_COMMENT,
    Disposition,
    Entry,
    Feature,
    Review,
    format_of,
)
from storage.review_head import Head
from storage.review_keeping import Check, Keeping
from storage.review_shown import ShownFinding, ShownScene

if TYPE_CHECKING:
    from sqlalchemy import Connection

__all__ = [
    "ASKS_FOR_WORK",
    "DISPOSITIONS",
    "MAX_COMMENT",
    "Disposition",
    "Entry",
    "Feature",
    "Review",
    "ReviewLog",
    "ShownFinding",
    "ShownScene",
]


class ReviewLog:
    """The log of a store.

    Parameters
    ----------
    root : Path
        The store's folder.
    """

    def __init__(self, root: Path) -> None:
        self._keeping = Keeping(Path(root))

    @property
    def path(self) -> Path:
        """The database's file, where no server holds it."""
        return self._keeping.folder / "decisions.sqlite"

    @property
    def version(self) -> tuple[int, ...]:
        """Changes with every new entry, and where files were changed behind Flushline's back."""
        return self._keeping.version

    def head(self) -> Head:
        """The last entry's number and checksum, as they are kept outside of the database."""
        return self._keeping.head()

    def read(self) -> Review:
        """Everything decided so far; a damaged or changed log is read up to that place.

        What this process read before is not read again.
        """
        return self._keeping.read()

    def of_scenes(self, scenes: Sequence[str]) -> Review:
        """What was decided about some scenes."""

        def asked(connection: Connection) -> list[Entry]:
            from storage.review_database import entries_of_scenes

            return entries_of_scenes(connection, scenes)

        return self._keeping.some(asked, lambda entry: entry.scene_id in scenes)

    def sign_offs(self) -> Review:
        """All sign-offs, and no other entries."""

        def asked(connection: Connection) -> list[Entry]:
            from storage.review_database import sign_off_entries

            return sign_off_entries(connection)

        return self._keeping.some(asked, lambda entry: entry.action == "sign-off")

    def dispose(
        self, who: str, shown: Sequence[ShownFinding], disposition: Disposition, comment: str = "",
        numbers: Numbers | None = None,
    ) -> list[Entry]:  # fmt: skip
        """Record what shall happen with findings: with all of them or, where one is refused, with none.

        Refused where the scene is signed off, or where something was decided about a finding since it was shown.
        """
        if disposition not in DISPOSITIONS:
            raise UsageError(f"disposition: found {disposition!r}, expected one of {', '.join(DISPOSITIONS)}")
        if not shown:
            raise UsageError("disposition: found no feature, expected at least one")
        more = {"numbers": numbers} if numbers and numbers.given else {}
        wanted = [{**_of_feature(s, "disposition", bool(more)), "disposition": disposition, **more} for s in shown]

        def check(review: Review) -> None:
            for finding in shown:
                _check_open(review, finding.scene_id)
                _check_undecided_since(review, finding)

        return self._append(who, comment, wanted, check)

    def close(self, who: str, shown: Sequence[ShownFinding], reason: str) -> list[Entry]:
        """Record why the work that the last disposition of features asked for is done, or is not needed any more.

        Refused where a feature has no open work, or where something was decided about it since it was shown.
        """
        _check_reason(reason, "close", "why the work is done")
        if not shown:
            raise UsageError("close: found no feature, expected at least one")
        wanted = [_of_feature(s, "close") for s in shown]

        def check(review: Review) -> None:
            work = review.work()
            for finding in shown:
                _check_undecided_since(review, finding)
                if any((finding.scene_id, feature) not in work for feature in finding.features):
                    raise UsageError(
                        f"{finding.scene_id} {finding.feature.id}: found no open work, expected a disposition such as "
                        f"{' or '.join(ASKS_FOR_WORK)} that nobody closed"
                    )

        return self._append(who, reason, wanted, check)

    def undo(self, who: str, shown: Sequence[ShownFinding], reason: str) -> list[Entry]:
        """Take back the last disposition or close of features, and say why: what was decided before it holds again.

        Refused where the scene is signed off, where nothing that is about all positions of a stretch alike holds, or
        where something was decided since it was shown.
        """
        _check_reason(reason, "undo", "why the decision is undone")
        if not shown:
            raise UsageError("undo: found no feature, expected at least one")
        wanted = [_of_feature(s, "undo") for s in shown]

        def check(review: Review) -> None:
            for finding in shown:
                _check_open(review, finding.scene_id)
                _check_undecided_since(review, finding)
                if review.undoable(finding.scene_id, *finding.features) is None:
                    raise UsageError(
                        f"{finding.scene_id} {finding.feature.id}: found no decision about it as a whole that holds, "
                        "expected one to undo"
                    )

        return self._append(who, reason, wanted, check)

    def mark_false(self, who: str, shown: ShownFinding, reason: str, pixel: tuple[float, float] | None) -> Entry:
        """Record that no fastener is where the software found one. It decides nothing, and changes no measured row.

        Refused where the scene is signed off, where a mark says so already, or where something was decided about it
        since it was shown.
        """
        _check_reason(reason, "mark", "why no fastener is there")
        feature = shown.feature
        wanted = {**_of_feature(shown, "mark"), "mark": _mark("false", pixel)}

        def check(review: Review) -> None:
            _check_open(review, shown.scene_id)
            _check_undecided_since(review, shown)
            if same := [mark for mark in review.standing_marks(shown.scene_id) if mark.feature == feature]:
                raise UsageError(f"{shown.scene_id} {feature.id}: found it marked ({same[0].said}), expected no mark")

        return self._append(who, reason, [wanted], check)[0]

    def mark_missed(self, who: str, shown: ShownScene, note: str, pixel: tuple[float, float] | None) -> Entry:
        """Record that a fastener was missed. It decides nothing, and changes no measured row.

        Parameters
        ----------
        note : str
            What and where; it may be empty where `pixel` is given.
        pixel : (float, float), optional
            Column and row in the scan's picture.
        """
        if not note.strip() and pixel is None:
            raise UsageError("mark: found neither a place nor a note, expected where the missed fastener is")
        wanted = {**_of_scene(shown, "mark", detailed=True), "mark": _mark("missed", pixel)}
        return self._append(who, note, [wanted], lambda review: _check_open(review, shown.scene_id))[0]

    def unmark(self, who: str, scene_id: str, number: int, reason: str) -> Entry:
        """Take a mark back, which is named by the number of its entry, and say why."""
        _check_reason(reason, "unmark", "why the mark is taken back")
        mark = next((entry for entry, _ in self.of_scenes([scene_id]).marks() if entry.number == number), None)
        if mark is None:
            raise UsageError(f"{scene_id}: found no mark by entry {number}, expected one")
        wanted = {
            "format": format_of("unmark", stretch=False), "action": "unmark", "scene_id": scene_id,
            "run_id": mark.run_id, "feature_kind": mark.feature_kind, "feature_id": mark.feature_id,
            "takes_back": number,
        }  # fmt: skip

        def check(review: Review) -> None:
            _check_open(review, scene_id)
            if number not in {entry.number for entry in review.standing_marks(scene_id)}:
                raise OutdatedError(f"{scene_id}: found that mark {number} was taken back, expected it to hold")

        return self._append(who, reason, [wanted], check)[0]

    def sign_off(self, who: str, shown: ShownScene, comment: str = "") -> Entry:
        """Close a scene; see `sign_off_all`."""
        return self.sign_off_all(who, [shown], comment)[0]

    def sign_off_all(
        self, who: str, shown: Sequence[ShownScene], comment: str = "", signature: Signature | None = None
    ) -> list[Entry]:
        """Close scenes, all of them or none: from now on their dispositions and the runs that were signed off stay.

        Refused where something was decided about one of them since it was shown. `storage.archive.decisions` also sees
        to it that the archive still shows those runs, and that nothing of the scenes waits.
        """
        if not shown:
            raise UsageError("sign-off: found no scene, expected at least one")
        more = {"signature": signature} if signature else {}
        wanted = [{**_of_scene(scene, "sign-off", bool(more)), **more} for scene in shown]

        def check(review: Review) -> None:
            for scene in shown:
                _check_open(review, scene.scene_id)
                _check_nothing_decided_since(review, scene)

        return self._append(who, comment, wanted, check)

    def _append(self, who: str, comment: str, wanted: list[dict[str, Any]], check: Check) -> list[Entry]:
        details = [text for part in wanted for text in _texts_of(part)]
        for what, text in (("name", who), ("comment", comment), *(("number or role", text) for text in details)):
            if "\0" in text or any("\ud800" <= character <= "\udfff" for character in text):
                raise UsageError(f"review: found a {what} with characters that are no text, expected plain text")
        if not who.strip():
            raise UsageError("review: found no name, expected who decides")
        if len(comment) > MAX_COMMENT:
            raise UsageError(f"review: found a comment of {len(comment)} characters, expected at most {MAX_COMMENT}")
        same = {"who": who.strip(), "comment": comment.strip()}
        scenes = sorted({str(part["scene_id"]) for part in wanted})
        return self._keeping.append([{**same, **part} for part in wanted], scenes, check)


def _texts_of(part: dict[str, Any]) -> list[str]:
    """Texts that people give beside their name and comment."""
    numbers, signature = part.get("numbers"), part.get("signature")
    return [
        *(numbers.given.values() if numbers else ()),
        *((signature.role, signature.meaning) if signature else ()),
    ]


def _check_reason(reason: str, what: str, expected: str) -> None:
    if not reason.strip():
        raise UsageError(f"{what}: found no reason, expected {expected}")


def _mark(kind: MarkKind, pixel: tuple[float, float] | None) -> Mark:
    return Mark(kind=kind) if pixel is None else Mark(kind=kind, u_px=pixel[0], v_px=pixel[1])


def _of_scene(shown: ShownScene, action: str, detailed: bool) -> dict[str, Any]:
    return {
        "format": format_of(action, stretch=False, detailed=detailed),
        "action": action,
        "scene_id": shown.scene_id,
        "run_id": shown.run_id,
        "shown": dict(shown.values),
    }


def _of_feature(shown: ShownFinding, action: str, detailed: bool = False) -> dict[str, Any]:
    if not shown.features:
        raise UsageError(f"{shown.scene_id} {shown.feature.id}: found no positions, expected those of the stretch")
    return {
        "format": format_of(action, shown.feature.is_stretch, detailed),
        "action": action,
        "scene_id": shown.scene_id,
        "run_id": shown.run_id,
        "feature_kind": shown.feature.kind,
        "feature_id": shown.feature.id,
        "shown": dict(shown.values),
    }


def _check_open(review: Review, scene_id: str) -> None:
    if signed := review.sign_offs().get(scene_id):
        raise UsageError(f"{scene_id}: found it {signed.said}, expected an open scene")


def _check_nothing_decided_since(review: Review, shown: ShownScene) -> None:
    last = review.last_entry_of_scene(shown.scene_id)
    if (last.number if last else 0) != shown.last_entry:
        about = f"{last.feature.id} was decided" if last and last.feature else "other decisions"
        said = f" ({last.said})" if last else ""
        raise OutdatedError(
            f"{shown.scene_id}: found that {about} since it was shown{said}, expected the "
            "decisions that were on the screen"
        )


def _check_undecided_since(review: Review, shown: ShownFinding) -> None:
    last = review.last_about(shown.scene_id, *shown.features)
    if (last.number if last else 0) != shown.last_entry:
        found = f"decided since it was shown ({last.said})" if last else "shown with a decision that the log lacks"
        raise OutdatedError(f"{shown.scene_id} {shown.feature.id}: found it {found}, expected it as it was shown")
