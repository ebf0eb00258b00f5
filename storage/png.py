"""Structure and checksums of grey PNG files, as cameras' frames come; OpenCV decodes them."""

from __future__ import annotations

import mmap
import struct
import zlib
from collections.abc import Iterator

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHUNK_OVERHEAD = 12  # length, type and CRC


class DamagedPng(Exception):
    """What was found, and what was expected; the file's name is added by who knows it."""


def size_and_bits(data: bytes | mmap.mmap) -> tuple[int, int, int]:
    """Height, width and bits per sample that the header of a grey, whole PNG says; nothing is decoded."""
    width, height, bits, colour = struct.unpack(">IIBB", data[16:26])
    if data[12:16] != b"IHDR":
        raise DamagedPng("found a PNG that does not begin with its header, expected a whole one")
    if colour != 0:
        kind = {2: "colour", 3: "palette", 4: "grey with alpha", 6: "colour with alpha"}.get(colour, "unknown")
        raise DamagedPng(f"found a {kind} PNG, expected a grey one")
    for _ in _chunks(data):
        pass
    return height, width, bits


def stated_sums(data: bytes) -> bytes:
    """The checksums that a whole PNG states of its chunks, one after the other."""
    return b"".join(data[start + length : start + length + 4] for _, start, length in _chunks(data))


def check_sums(data: bytes) -> None:
    """Refuse a PNG with a chunk that is not what its checksum says."""
    view = memoryview(data)
    for _, start, length in _chunks(data):
        (stated,) = struct.unpack(">I", view[start + length : start + length + 4])
        if zlib.crc32(view[start - 4 : start + length]) != stated:
            raise DamagedPng(f"found a damaged PNG (checksum differs at byte {start}), expected a whole one")


def _chunks(data: bytes | mmap.mmap) -> Iterator[tuple[bytes, int, int]]:
    """Type, start and length of the content of each chunk up to IEND; a file that ends before it is refused."""
    offset = len(SIGNATURE)
    while offset + _CHUNK_OVERHEAD <= len(data):
        length, kind = struct.unpack(">I4s", data[offset : offset + 8])
        if offset + _CHUNK_OVERHEAD + length > len(data):
            break
        yield kind, offset + 8, length
        if kind == b"IEND":
            return
        offset += _CHUNK_OVERHEAD + length
    raise DamagedPng(f"found a PNG truncated after {len(data)} bytes, expected a whole one")
