"""Grey camera frames on disk: PNG, TIFF, BMP, npy, 8 or 16 bit.

A header is read and judged before anything is decoded, and the file must be whole: image libraries allocate what a
header asks for, and some return the part of a truncated image that they could read.
"""

from __future__ import annotations

import io
import mmap
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from storage import png
from storage.documents import ErrorType, check_regular_file, read_bytes

Frame = NDArray[np.uint8] | NDArray[np.uint16]

MAX_FRAME_PIXELS = 200_000_000
_TIFF_SIZES = {1: 1, 3: 2, 4: 4, 16: 8}  # bytes of BYTE, SHORT, LONG, LONG8
_TIFF_CODES = {1: "B", 3: "H", 4: "I", 16: "Q"}


@dataclass(frozen=True)
class FrameHeader:
    """What a frame's header says; equality is what frames of one camera must share."""

    height: int
    width: int
    bits: int

    def __str__(self) -> str:
        return f"{self.width}×{self.height} with {self.bits} bit"

    @property
    def dtype(self) -> np.dtype[np.uint8] | np.dtype[np.uint16]:
        """The array type that holds the frame."""
        return np.dtype(np.uint8) if self.bits == 8 else np.dtype(np.uint16)


class _BadFrame(Exception):
    """What is wrong with a frame, before the file's name is added."""


_WRONG = (_BadFrame, png.DamagedPng)


def read_header(path: Path, error: ErrorType) -> FrameHeader:
    """Size and bit depth of a grey frame that is whole as far as its structure tells, without decoding it."""
    if not check_regular_file(path, error).st_size:
        raise error(f"{path}: found an empty file, expected a grey image")
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            return _header_of(data)
    except _WRONG as problem:
        raise error(f"{path}: {problem}") from None
    except (struct.error, IndexError):
        raise error(f"{path}: found a damaged or truncated header, expected a whole image") from None
    except OSError as problem:
        raise error(f'{path}: found "{problem.strerror}", expected a readable file') from None


def read_frame(path: Path, expected: FrameHeader, error: ErrorType) -> Frame:
    """Decode one frame whose header is known to be `expected`."""
    frame: Frame = np.empty((expected.height, expected.width), expected.dtype)
    _read_into(frame, path, expected, error)
    return frame


def _read_into(frame: Frame, path: Path, expected: FrameHeader, error: ErrorType) -> int:
    """Decode a file into `frame`; returns the file's checksum."""
    data = read_bytes(path, error)
    try:
        header = _header_of(data)
        if header != expected:
            raise _BadFrame(f"found {header}, expected {expected}")
        _decode_into(frame, data, expected)
        return checksum(data)
    except _WRONG as problem:
        raise error(f"{path}: {problem}") from None
    except (struct.error, IndexError, ValueError, cv2.error):
        raise error(f"{path}: found a damaged image, expected {expected}") from None


def checksum(data: bytes) -> int:
    """CRC-32 of a file's content.

    A PNG states one of each chunk, which decoding verifies anyway: the CRC-32 of these stands for it and costs nothing.
    """
    if data[:8] == png.SIGNATURE:
        return zlib.crc32(png.stated_sums(data))
    return zlib.crc32(data)


def file_checksum(path: Path, error: ErrorType) -> int:
    """The checksum that reading a frame would give; nothing is decoded."""
    try:
        return checksum(read_bytes(path, error))
    except png.DamagedPng as problem:
        raise error(f"{path}: {problem}") from None


@dataclass(frozen=True)
class FrameStack:
    """Decoded frames of one kind.

    Attributes
    ----------
    frames : (n, height, width) ndarray of uint8 or uint16
    checksums : tuple of int
        Of the files, in the same order.
    """

    frames: Frame
    checksums: tuple[int, ...]


def read_stack(
    paths: Sequence[Path], expected: FrameHeader, error: ErrorType, executor: Executor | None = None
) -> FrameStack:
    """Decode several frames of one kind.

    Parameters
    ----------
    executor : Executor, optional
        Threads that decode side by side (decoders release the interpreter lock).
    """
    stack: Frame = np.empty((len(paths), expected.height, expected.width), expected.dtype)

    def place(index: int) -> int:
        return _read_into(stack[index], paths[index], expected, error)

    run: Callable[..., Iterator[int]] = executor.map if executor else map
    return FrameStack(stack, tuple(run(place, range(len(paths)))))


def write_frame(path: Path, frame: Frame) -> None:
    """Write a grey frame as PNG, at the fast end of its compression."""
    ok, data = cv2.imencode(".png", frame, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not ok:
        raise OSError(f"{path}: OpenCV could not encode a frame of {frame.shape} {frame.dtype} as PNG")
    path.write_bytes(data.tobytes())


def _header_of(data: bytes | mmap.mmap) -> FrameHeader:
    start = data[:8]
    if start == png.SIGNATURE:
        header = FrameHeader(*png.size_and_bits(data))
    elif start[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        header = _tiff_header(data)
    elif start[:2] == b"BM":
        header = _bmp_header(data)
    elif start[:6] == b"\x93NUMPY":
        header = _npy_header(data)
    else:
        raise _BadFrame("found none of the known image signatures, expected a PNG, TIFF, BMP or npy file")
    if header.height < 1 or header.width < 1 or header.height * header.width > MAX_FRAME_PIXELS:
        raise _BadFrame(
            f"found a header that says {header.width}×{header.height} pixels, expected 1 to {MAX_FRAME_PIXELS:,} pixels"
        )
    if header.bits not in (8, 16):
        raise _BadFrame(f"found {header.bits} bits per pixel, expected 8 or 16")
    return header


def _bmp_header(data: bytes | mmap.mmap) -> FrameHeader:
    pixels_at, header_size, width, height, _, bits, compression = struct.unpack("<IIiiHHI", data[10:34])
    height = abs(height)  # negative: stored top-down
    if bits != 8 or compression not in (0, 1):
        raise _BadFrame(
            f"found a BMP with {bits} bits per pixel (compression {compression}), expected a grey one with 8"
        )
    palette = np.frombuffer(data[14 + header_size : pixels_at], np.uint8)
    palette = palette[: len(palette) // 4 * 4].reshape(-1, 4)
    if (palette[:, :3] != palette[:, :1]).any():
        raise _BadFrame("found a BMP with a colour palette, expected a grey one")
    if compression == 0 and pixels_at + (width + 3) // 4 * 4 * height > len(data):
        raise _BadFrame(f"found a BMP truncated after {len(data)} bytes, expected a whole one")
    return FrameHeader(height, width, bits)


def _tiff_header(data: bytes | mmap.mmap) -> FrameHeader:
    tags, following = _tiff_tags(data)
    bits, samples = tags.get(258, [1]), tags.get(277, [1])[0]
    if samples != 1 or tags.get(262, [1])[0] != 1:
        raise _BadFrame(f"found a TIFF with {samples} samples per pixel or a palette, expected a grey one")
    if tags.get(339, [1])[0] != 1:
        raise _BadFrame("found a TIFF of signed or floating-point numbers, expected whole numbers from 0")
    if following:
        raise _BadFrame("found a TIFF of several pages, expected one frame per file")
    offsets = tags.get(273) or tags.get(324) or []
    counts = tags.get(279) or tags.get(325) or []
    if (
        not offsets
        or len(offsets) != len(counts)
        or any(a + n > len(data) for a, n in zip(offsets, counts, strict=True))
    ):
        raise _BadFrame(f"found a TIFF truncated after {len(data)} bytes, expected a whole one")
    return FrameHeader(tags[257][0] if 257 in tags else 0, tags[256][0] if 256 in tags else 0, bits[0])


def _tiff_tags(data: bytes | mmap.mmap) -> tuple[dict[int, list[int]], int]:
    """Whole-number tags of the first page (classic or BigTIFF), and where the next page begins (0: nowhere)."""
    order = "<" if data[:2] == b"II" else ">"
    big = data[2:4] in (b"+\0", b"\0+")
    word, entry_size, inline = ("Q", 20, 8) if big else ("I", 12, 4)
    at = struct.unpack(order + word, data[8:16] if big else data[4:8])[0]
    count_size = 8 if big else 2
    (count,) = struct.unpack(order + ("Q" if big else "H"), data[at : at + count_size])
    if at + count_size + count * entry_size > len(data):
        raise _BadFrame(f"found a TIFF truncated after {len(data)} bytes, expected a whole one")
    tags = {}
    for index in range(count):
        start = at + count_size + index * entry_size
        tag, kind, n = struct.unpack(order + "HH" + word, data[start : start + 4 + inline])
        if kind not in _TIFF_SIZES:
            continue
        size = _TIFF_SIZES[kind] * n
        place = start + 4 + inline
        if size > inline:
            (place,) = struct.unpack(order + word, data[place : place + inline])
        if place + size > len(data):
            raise _BadFrame(f"found a TIFF truncated after {len(data)} bytes, expected a whole one")
        tags[tag] = list(struct.unpack(f"{order}{n}{_TIFF_CODES[kind]}", data[place : place + size]))
    end = at + count_size + count * entry_size
    return tags, struct.unpack(order + word, data[end : end + inline])[0]


def _npy_header(data: bytes | mmap.mmap) -> FrameHeader:
    head = io.BytesIO(data[:65536])
    try:
        version = np.lib.format.read_magic(head)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(head)
    except ValueError as problem:
        raise _BadFrame(f"found a damaged npy header ({problem}), expected a whole one") from None
    if len(shape) != 2 or dtype.kind != "u":
        raise _BadFrame(f"found an npy array of shape {shape} and type {dtype}, expected (h, w) of uint8 or uint16")
    if head.tell() + shape[0] * shape[1] * dtype.itemsize > len(data):
        raise _BadFrame(f"found an npy file truncated after {len(data)} bytes, expected a whole one")
    return FrameHeader(shape[0], shape[1], 8 * dtype.itemsize)


def _decode_into(frame: Frame, data: bytes, expected: FrameHeader) -> None:
    if data[:6] == b"\x93NUMPY":
        frame[:] = np.load(io.BytesIO(data), allow_pickle=False)
        return
    if data[:8] == png.SIGNATURE:
        png.check_sums(data)
    decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if decoded is None or decoded.shape != (expected.height, expected.width) or decoded.dtype != expected.dtype:
        raise _BadFrame(f"found an image that does not decode, expected {expected}")
    frame[:] = decoded
