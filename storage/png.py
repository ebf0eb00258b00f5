"""Grey PNG files, as cameras' frames come: their structure, and decoding them without detours.

Frames are most of what a scan has to read. A general decoder inflates with zlib and goes through a picture row by row
in code for every kind of PNG; here ISA-L inflates, two and a half times as fast, and one kernel undoes the filters
straight into the stack of frames. Interlaced pictures are left to OpenCV.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrology.jit import kernel

inflating: Any
try:
    from isal import isal_zlib as inflating
except ImportError:  # no wheel for this kind of processor: the same by the standard library
    inflating = zlib

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHUNK_OVERHEAD = 12  # length, type and CRC
_NONE, _SUB, _UP, _AVERAGE, _PAETH = range(5)


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


def check_sums(data: bytes) -> None:
    """Refuse a PNG with a chunk that is not what its checksum says."""
    view = memoryview(data)
    for _, start, length in _chunks(data):
        (stated,) = struct.unpack(">I", view[start + length : start + length + 4])
        if zlib.crc32(view[start - 4 : start + length]) != stated:
            raise DamagedPng(f"found a damaged PNG (checksum differs at byte {start}), expected a whole one")


def is_plain(data: bytes) -> bool:
    """Whether `decode_plain` decodes a grey PNG of 8 or 16 bits: one that is not interlaced."""
    compression, filtering, interlacing = data[26:29]
    return compression == filtering == interlacing == 0


def decode_plain(data: bytes, frame: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """Decode a plain grey PNG into a frame of its size and depth.

    Parameters
    ----------
    data : bytes
        With sound checksums.
    frame : (h, w) ndarray of uint8 or uint16, contiguous
    """
    height, width = frame.shape
    row = width * frame.itemsize
    content = b"".join(data[start : start + length] for kind, start, length in _chunks(data) if kind == b"IDAT")
    stream = inflating.decompressobj()
    try:
        # One byte more than there can be: what a damaged or malicious stream would inflate to is never allocated.
        lines = stream.decompress(content, height * (1 + row) + 1)
    except inflating.error as problem:
        raise DamagedPng(f"found a damaged PNG ({problem}), expected a whole one") from None
    if len(lines) != height * (1 + row) or not stream.eof:
        raise DamagedPng(f"found a PNG with other than {width}×{height} pixels in it, expected what its header says")
    filtered = np.frombuffer(lines, np.uint8).reshape(height, 1 + row)
    if filtered[:, 0].max() > _PAETH:
        raise DamagedPng("found a PNG with an unknown filter, expected a whole one")
    unfilter(filtered, frame.itemsize, frame.view(np.uint8))
    if frame.itemsize == 2:
        frame[:] = frame.view(">u2")


@kernel
def unfilter(filtered, step, pixels):  # type: ignore[no-untyped-def]
    """Undo the filters of PNG, clause 9 of its specification.

    Parameters
    ----------
    filtered : (h, 1 + n) uint8
        Rows with the kind of their filter before them.
    step : int
        Bytes per pixel.
    pixels : (h, n) uint8
        Written.
    """
    above = np.zeros(pixels.shape[1], np.uint8)
    n = np.uintp(pixels.shape[1])
    first = np.uintp(step)
    for y in range(pixels.shape[0]):
        kind, coded, row = filtered[y, 0], filtered[y, 1:], pixels[y]
        if kind == _NONE:
            for x in range(n):
                row[x] = coded[x]
        elif kind == _UP:
            for x in range(n):
                row[x] = coded[x] + above[x]
        else:
            for x in range(first):
                up = np.int32(above[x])
                row[x] = coded[x] + (up >> 1 if kind == _AVERAGE else up if kind == _PAETH else 0)
            if kind == _SUB:
                for x in range(first, n):
                    row[x] = coded[x] + row[x - first]
            elif kind == _AVERAGE:
                for x in range(first, n):
                    row[x] = coded[x] + ((np.int32(row[x - first]) + np.int32(above[x])) >> 1)
            else:
                for x in range(first, n):
                    left, up, corner = np.int32(row[x - first]), np.int32(above[x]), np.int32(above[x - first])
                    # How far left + up − corner is from each of the three; of equals the left, then the upper one wins.
                    to_left, to_up, to_corner = abs(up - corner), abs(left - corner), abs(left + up - 2 * corner)
                    if to_left <= to_up and to_left <= to_corner:
                        row[x] = coded[x] + left
                    elif to_up <= to_corner:
                        row[x] = coded[x] + up
                    else:
                        row[x] = coded[x] + corner
        above = row


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
