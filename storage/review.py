"""What people decided about findings: an append-only log of dispositions and sign-offs beside the archive.

An entry is a JSON document in a database (`storage.review_database`). It is never changed or removed; each names the
checksum of the one before it, so a change made behind Flushline's back shows. Measurements are not touched by this.

A decision is about what was on the screen: whoever records one says what was shown, and it is refused where somebody
else decided since. `storage.archive.decisions` also sees to it that the archive still shows the same values.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from metrology.errors import OutdatedError, UsageError
from storage.review_entries import (
    ASKS_FOR_WORK,
    DISPOSITIONS,
    FORMAT,
    MAX_COMMENT,
    Disposition,
    Entry,
    Feature,
    Review,
    ShownFinding,
    ShownScene,
    format_of,
)
from storage.review_head import Head
from storage.review_keeping import Check, Keeping

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
        from storage import review_database

        return self._keeping.some(
            lambda connection: review_database.entries_of_scenes(connection, scenes),
            lambda entry: entry.scene_id in scenes,
        )

    def sign_offs(self) -> Review:
        """All sign-offs, and no other entries."""
        from storage import review_database

        return self._keeping.some(review_database.sign_off_entries, lambda entry: entry.action == "sign-off")

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
        wanted = [{**_of_feature(s, "disposition"), "disposition": disposition} for s in shown]

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
        if not reason.strip():
            raise UsageError("undo: found no reason, expected why the decision is undone")
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

    def sign_off(self, who: str, shown: ShownScene, comment: str = "") -> Entry:
        """Close a scene; see `sign_off_all`."""
        return self.sign_off_all(who, [shown], comment)[0]

    def sign_off_all(self, who: str, shown: Sequence[ShownScene], comment: str = "") -> list[Entry]:
        """Close scenes, all of them or none: from now on their dispositions and the runs that were signed off stay.

        Refused where something was decided about one of them since it was shown. `storage.archive.decisions` also sees
        to it that the archive still shows those runs, and that nothing of the scenes waits.
        """
        if not shown:
            raise UsageError("sign-off: found no scene, expected at least one")
        wanted = [
            {"action": "sign-off", "scene_id": scene.scene_id, "run_id": scene.run_id, "shown": dict(scene.values)}
            for scene in shown
        ]

        def check(review: Review) -> None:
            for scene in shown:
                _check_open(review, scene.scene_id)
                _check_nothing_decided_since(review, scene)

        return self._append(who, comment, wanted, check)

    def _append(self, who: str, comment: str, wanted: list[dict[str, Any]], check: Check) -> list[Entry]:
        for what, text in (("name", who), ("comment", comment)):
            if "\0" in text or any("\ud800" <= character <= "\udfff" for character in text):
                raise UsageError(f"review: found a {what} with characters that are no text, expected plain text")
        if not who.strip():
            raise UsageError("review: found no name, expected who decides")
        if len(comment) > MAX_COMMENT:
            raise UsageError(f"review: found a comment of {len(comment)} characters, expected at most {MAX_COMMENT}")
        same = {"format": FORMAT, "who": who.strip(), "comment": comment.strip()}
        scenes = sorted({str(part["scene_id"]) for part in wanted})
        return self._keeping.append([{**same, **part} for part in wanted], scenes, check)


def _of_feature(shown: ShownFinding, action: str) -> dict[str, Any]:
    if not shown.features:
        raise UsageError(f"{shown.scene_id} {shown.feature.id}: found no positions, expected those of the stretch")
    return {
        "format": format_of(action, shown.feature.is_stretch),
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
