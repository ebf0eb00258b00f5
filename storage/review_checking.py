"""Looking at the whole review log: its chain, what the database makes of it, its head and the marks of sign-offs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from metrology.errors import StoreError
from storage.review_chain import sound_part
from storage.review_entries import Entry
from storage.review_head import Head
from storage.review_keeping import Keeping


@dataclass(frozen=True)
class CheckedLog:
    """A log that was looked at."""

    place: str
    """Where it is kept."""
    entries: tuple[Entry, ...]
    """Up to the first damaged or changed one."""
    problems: tuple[str, ...]
    """One line each."""

    @property
    def sign_offs(self) -> tuple[Entry, ...]:
        """All sign-offs."""
        return tuple(entry for entry in self.entries if entry.action == "sign-off")

    def contradiction(self, head: Head, kept_in: str) -> str | None:
        """What is wrong with the log if it once had a head that was kept elsewhere."""
        if not head.number:
            return None
        if head.number > len(self.entries):
            found = f"found {len(self.entries)} sound entries"
        elif self.entries[head.number - 1].checksum != head.checksum:
            found = f"found another entry {head.number} ({self.entries[head.number - 1].checksum[:12]}…)"
        else:
            return None
        return f"{self.place}: {found}, expected entry {head.number} ({head.checksum[:12]}…) that {kept_in} names"


def check_log(root: Path) -> CheckedLog:
    """Read and compare all of a store's log."""
    from storage import review_database

    keeping = Keeping(root)
    if old := keeping.only_old_log():
        return CheckedLog(str(keeping.old_log), old.entries, (old.problem,) if old.problem else ())
    problems: list[str] = []
    sound: list[Entry] = []
    place = keeping.place
    try:
        with keeping.looking() as (connection, problem):
            entries = review_database.entries_after(connection, 0) if connection is not None else []
            sound, broken = sound_part(entries, Head(), place, documents=True)
            problems += [text for text in (broken, problem) if text]
    except StoreError as problem_of_database:
        problems.append(str(problem_of_database))
    return CheckedLog(place, tuple(sound), (*problems, *_mark_problems(keeping, sound)))


def _mark_problems(keeping: Keeping, entries: list[Entry]) -> list[str]:
    signed = {entry.scene_id: entry.run_id for entry in entries if entry.action == "sign-off"}
    marked = keeping.marks.all()
    problems = [
        f"{keeping.marks.folder / scene}: found no mark of run {run}, expected one as the scene is signed off"
        for scene, run in sorted(signed.items())
        if marked.get(scene) != run
    ]
    return problems + [
        f"{keeping.place}: found no sign-off of {scene}, expected that of run {run}, which "
        f"{keeping.marks.folder.name}/{scene} marks"
        for scene, run in sorted(marked.items())
        if scene not in signed
    ]
