"""The log as versions before the database kept it: lines of which each names the checksum of the one before it."""

from __future__ import annotations

import hashlib
from pathlib import Path

from metrology.errors import StoreError

FIRST = "0" * 64
"""What the first entry names as the one before it."""


def read_lines(path: Path) -> list[bytes]:
    """The complete lines of a log; what lies beyond them is a write that a crash cut short."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return []
    except OSError as problem:
        raise StoreError(f'{path}: found "{problem.strerror}", expected a readable review log') from None
    return content[: content.rfind(b"\n") + 1].splitlines()


def checksum(line: bytes) -> str:
    """SHA-256 of a line without its end."""
    return hashlib.sha256(line).hexdigest()
