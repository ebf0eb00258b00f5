"""The file of the review log: lines that are only ever added, each of which the next one names by its checksum."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from metrology.errors import StoreError
from storage.archive.files import sync

FIRST = "0" * 64
"""What the first line names as the one before it."""


class ReviewFile:
    """A log of lines.

    Parameters
    ----------
    path : Path
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def version(self) -> tuple[int, int]:
        """Changes with every new line: size and time of the file."""
        try:
            status = self.path.stat()
        except OSError:
            return 0, 0
        return status.st_size, status.st_mtime_ns

    def content(self) -> bytes:
        """The complete lines; what lies beyond them is a write that a crash cut short."""
        try:
            content = self.path.read_bytes()
        except FileNotFoundError:
            return b""
        except OSError as problem:
            raise StoreError(f'{self.path}: found "{problem.strerror}", expected a readable review log') from None
        return content[: content.rfind(b"\n") + 1]

    def append(self, lines: bytes, length: int) -> None:
        """Write lines durably after the first `length` bytes; the caller holds the log's lock."""
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


def last_checksum(content: bytes) -> str:
    """The checksum that the next line must name."""
    return checksum(content.splitlines()[-1]) if content else FIRST


def checksum(line: bytes) -> str:
    """SHA-256 of a line without its end."""
    return hashlib.sha256(line).hexdigest()
