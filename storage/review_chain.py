"""The chain of entries: each names the checksum of the one before it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from storage.review_entries import FORMAT, FORMAT_OF_DETAILS, Entry, EntryModel, Review
from storage.review_file import checksum, read_lines
from storage.review_head import Head

_KNOWN = f"an entry of {FORMAT} to {FORMAT_OF_DETAILS}"


def chained(wanted: Sequence[Mapping[str, Any]], head: Head) -> list[Entry]:
    """Entries that follow on a head."""
    entries: list[Entry] = []
    for part in wanted:
        document = EntryModel.model_validate(
            {**part, "number": head.number + 1, "at": datetime.now(UTC), "previous": head.checksum}
        ).document
        entries.append(Entry.of_document(document))
        head = head_of(entries[-1])
    return entries


def head_of(last: Entry | None) -> Head:
    """The head of a log that ends with an entry."""
    return Head(last.number, last.checksum) if last else Head()


def sound_part(entries: Iterable[Entry], head: Head, place: str, documents: bool = False) -> tuple[list[Entry], str]:
    """Entries that follow on a head, up to the first damaged or changed one, and what is wrong with that.

    Parameters
    ----------
    documents : bool
        Also compare what the database makes of a document with the document, which takes longer.
    """
    sound: list[Entry] = []
    for entry in entries:
        if (entry.number, entry.previous) != (head.number + 1, head.checksum):
            wrong = f"found the entries before entry {entry.number} changed, expected them as written"
            return sound, f"{place}: {wrong}"
        if checksum(entry.document.encode()) != entry.checksum or (documents and not is_as_its_document(entry)):
            return sound, f"{place}: found entry {entry.number} changed, expected it as written"
        sound.append(entry)
        head = Head(entry.number, entry.checksum)
    return sound, ""


def is_as_its_document(entry: Entry) -> bool:
    """Whether all that a row says is what its document says."""
    try:
        return Entry.of_document(entry.document) == entry
    except ValidationError:
        return False


def read_old_log(path: Path) -> Review:
    """The log as a version before the database left it; a damaged or changed one is read up to that place."""
    sound: list[Entry] = []
    head = Head()
    for number, line in enumerate(read_lines(path), start=1):
        try:
            entry = Entry.of_document(line.decode())
        except (ValidationError, UnicodeDecodeError):
            return Review(tuple(sound), f"{path}: found line {number} damaged, expected {_KNOWN}")
        if (entry.number, entry.previous) != (number, head.checksum):
            wrong = f"found the lines before line {number} changed, expected them as written"
            return Review(tuple(sound), f"{path}: {wrong}")
        sound.append(entry)
        head = head_of(entry)
    return Review(tuple(sound))
