"""The head of the review log, kept outside of its database: number and checksum of the last entry.

Whoever adds entries first writes down, durably, which entry will be the last one, then adds them, then says that they
are there. After a crash in between, the database ends with the entry before or with the one announced, and the next
writer goes on from there. A database that ends with any other entry was changed by something else.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path

from metrology.errors import StoreError, UsageError
from storage.archive.files import replacing
from storage.documents import read_json
from storage.review_file import FIRST

FORMAT = "flushline-head/1"
_TEXT = re.compile(r"(\d{1,18}):([0-9a-f]{64})")


@dataclass(frozen=True)
class Head:
    """The last entry of a log."""

    number: int = 0
    """0 where there is none."""
    checksum: str = FIRST
    """SHA-256 of its document; of an empty log what its first entry will name as the one before."""

    def __str__(self) -> str:
        return f"{self.number}:{self.checksum}"

    @classmethod
    def parse(cls, text: str) -> Head:
        """A head as it is printed: NUMBER:CHECKSUM."""
        if not (match := _TEXT.fullmatch(text.strip())):
            raise UsageError(
                f"head: found {text!r}, expected NUMBER:CHECKSUM as 'flushline archive head' or a report gives it"
            )
        return cls(int(match[1]), match[2])


@dataclass(frozen=True)
class KeptHead:
    """What head.json says."""

    head: Head = Head()
    following: Head | None = None
    """What was going to be the head when a writer was stopped."""

    def allows(self, found: Head) -> bool:
        """Whether a log may end with an entry."""
        return found in (self.head, self.following)


class HeadFile:
    """reviews/head.json."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def read(self) -> KeptHead:
        """What it says; of a log that nobody wrote to, that it is empty."""
        if not self.path.exists():
            return KeptHead()
        document = read_json(self.path, StoreError)
        try:
            following = document.get("following")
            return KeptHead(Head.parse(document["head"]), Head.parse(following) if following else None)
        except (KeyError, AttributeError, UsageError):
            raise StoreError(f"{self.path}: found it damaged, expected a head of {FORMAT}") from None

    def write(self, head: Head, following: Head | None = None) -> None:
        """Keep a head, durably; the caller holds the log's lock."""
        document = {"format": FORMAT, "head": str(head)} | ({"following": str(following)} if following else {})
        with replacing(self.path) as partial:
            partial.write_text(json.dumps(document), encoding="ascii")
