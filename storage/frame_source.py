"""Bytes of a frame file, read piece by piece at given places: a header is small, whatever it says of itself.

Files are read, not mapped: a process that touches a mapped file which someone cuts short is killed.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path


class BadFrame(Exception):
    """What was found in a frame, and what was expected; the file's name is added by who knows it."""


class OtherFrame(BadFrame):
    """A picture of a kind that frames do not have, but can be turned into: in colour, or of another format."""


class ShortFrame(BadFrame):
    """A frame that ends before its header does."""


@dataclass(frozen=True)
class FrameSource:
    """A frame's bytes."""

    size: int
    """Bytes in all."""
    take: Callable[[int, int], bytes]
    """`take(at, count)` gives at most `count` bytes from `at` on."""

    def read(self, at: int, count: int) -> bytes:
        """Exactly `count` bytes."""
        data = self.take(at, count) if at + count <= self.size else b""
        if len(data) < count:
            raise ShortFrame("found a damaged or truncated header, expected a whole image")
        return data


def source_of(data: bytes) -> FrameSource:
    """A frame that is in memory."""
    return FrameSource(len(data), lambda at, count: data[at : at + count])


@contextmanager
def open_source(path: Path) -> Iterator[FrameSource]:
    """A frame on disk, of the size that it has now."""
    with path.open("rb", buffering=0) as file:
        descriptor = file.fileno()
        yield FrameSource(os.fstat(descriptor).st_size, lambda at, count: os.pread(descriptor, count, at))
