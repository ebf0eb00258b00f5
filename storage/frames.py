"""Grey camera frames on disk: PNG, TIFF, BMP, npy, 8 or 16 bit.

A header is read and judged before anything is decoded, and the file must be whole: image libraries allocate what a
header asks for, and some return the part of a truncated image that they could read.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.errors import StoreError
from storage import png, tiff
from storage.documents import ErrorType, brief, check_regular_file, read_bytes
from storage.frame_source import BadFrame, FrameSource, OtherFrame, ShortFrame, open_source, source_of

Frame = NDArray[np.uint8] | NDArray[np.uint16]

MAX_FRAME_PIXELS = 200_000_000
_MAX_FRAME_BYTES = 4 * MAX_FRAME_PIXELS
_BMP_HEADERS = (40, 52, 56, 64, 108, 124)  # bytes of the header versions that state sizes alike
_NPY_SIGNATURE = b"\x93NUMPY"
_MAX_NPY_HEADER_BYTES = 4096
# As numpy and others write it; whole numbers may end in L, as Python 2 wrote them.
_NPY_HEADER = re.compile(
    r"\{'descr': (.+), 'fortran_order': (True|False), 'shape': \(([0-9]*L?(?:, ?[0-9]+L?)*),?\),? *\} *\n?"
)
_NPY_TYPES = {f"'{order}u{size}'": np.dtype(f"{order}u{size}") for order in ("<", ">", "|") for size in (1, 2)}
_SWAPPED = 3.0  # times rougher than with its bytes swapped: grey levels of a lens are smooth
_ROUGHNESS_STRIDE = 8


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


def read_header(path: Path, error: ErrorType) -> FrameHeader:
    """Size and bit depth of a grey frame that is whole as far as its structure shows, without decoding it."""
    if not check_regular_file(path, error).st_size:
        raise error(f"{path}: found an empty file, expected a grey image")
    try:
        with open_source(path) as source:
            return _header_of(source)
    except BadFrame as problem:
        raise error(f"{path}: {problem}") from None
    except OSError as problem:
        raise error(f'{path}: found "{problem.strerror}", expected a readable file') from None


def can_be_turned(path: Path) -> bool:
    """Whether a picture that is no frame is one of another kind: in colour or of another format, not a damaged one."""
    try:
        with open_source(path) as source:
            _header_of(source)
    except OtherFrame:
        return True
    except (BadFrame, OSError):
        pass
    return False


def read_frame(path: Path, expected: FrameHeader, error: ErrorType) -> Frame:
    """Decode one frame whose header is known to be `expected`."""
    frame: Frame = np.empty((expected.height, expected.width), expected.dtype)
    _read_into(frame, path, expected, error)
    return frame


def _read_into(frame: Frame, path: Path, expected: FrameHeader, error: ErrorType) -> int:
    """Decode a file into `frame`; returns the file's checksum."""
    data = read_bytes(path, error, _MAX_FRAME_BYTES)
    try:
        chunks: list[png.Chunk] = []  # found once, as a camera's PNG may have some hundred
        header = _header_of(source_of(data), chunks)
        if header != expected:
            raise BadFrame(f"found {header}, expected {expected}")
        _decode_into(frame, data, expected, chunks)
        _check_byte_order(frame)
        return checksum(data, chunks)
    except BadFrame as problem:
        raise error(f"{path}: {problem}") from None
    except cv2.error:
        raise error(f"{path}: found a damaged image, expected {expected}") from None


def read_preview(path: Path) -> NDArray[np.uint8]:
    """A scene's texture, (h, w), as the store keeps it."""
    texture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if texture is None:
        raise StoreError(f"{path}: found no readable picture, expected the scene's preview")
    return np.asarray(texture, np.uint8)


def read_as_grey(path: Path, error: ErrorType) -> Frame | None:
    """A picture of any format in grey, with its own depth; None where it is none that can be read.

    Raises
    ------
    error
        Where the file says that it is to be turned or mirrored, as OpenCV would: the rig has the sensor's pixels.
    """
    try:
        with open_source(path) as source:
            if source.take(0, 4) in tiff.SIGNATURES:
                tiff.check_orientation(tiff.TiffDirectory.read(source))
    except (ShortFrame, OSError):
        return None
    except BadFrame as problem:
        raise error(f"{path}: {problem}") from None
    flags = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR
    picture, stored = (cv2.imread(str(path), flags | more) for more in (0, cv2.IMREAD_IGNORE_ORIENTATION))
    if picture is None or stored is None or picture.dtype not in (np.uint8, np.uint16):
        return None
    if not np.array_equal(picture, stored):
        raise error(
            f"{path}: found an orientation in its Exif data by which it is to be turned or mirrored, expected pictures "
            "as the sensor has them, of scans and of the rig's calibration alike; take the tag out of all of them "
            "(exiftool -Orientation= FILES)"
        )
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)  # of three equal channels: these, exactly
    return grey.astype(np.uint8) if picture.dtype == np.uint8 else grey.astype(np.uint16)


def checksum(data: bytes, chunks: Iterable[png.Chunk] | None = None) -> int:
    """CRC-32 of a file's content.

    A PNG states one of each chunk, which decoding verifies anyway: the CRC-32 of these stands for it and costs nothing.

    Parameters
    ----------
    chunks : iterable, optional
        A PNG's, where they are known.
    """
    if data[:8] == png.SIGNATURE:
        return zlib.crc32(png.stated_sums(data, png.chunks_of(source_of(data)) if chunks is None else chunks))
    return zlib.crc32(data)


def file_checksum(path: Path, error: ErrorType) -> int:
    """The checksum that reading a frame would give; nothing is decoded."""
    try:
        return checksum(read_bytes(path, error))
    except BadFrame as problem:
        raise error(f"{path}: {problem}") from None


@dataclass(frozen=True)
class FrameStack:
    """Decoded frames of one kind."""

    frames: Frame
    """(n, height, width) of uint8 or uint16."""
    checksums: tuple[int, ...]
    """Of the files, in the same order."""


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


def _header_of(source: FrameSource, chunks: list[png.Chunk] | None = None) -> FrameHeader:
    """What a frame's header says; of a PNG, `chunks` gets what it consists of."""
    start = source.take(0, 8)
    if start == png.SIGNATURE:
        header = FrameHeader(*png.size_and_bits(source, chunks))
    elif start[:4] in tiff.SIGNATURES:
        header = FrameHeader(*tiff.size_and_bits(source))
    elif start[:2] == b"BM":
        header = _bmp_header(source)
    elif start[:6] == _NPY_SIGNATURE:
        header = _npy_header(source)
    else:
        raise OtherFrame("found none of the known image signatures, expected a PNG, TIFF, BMP or npy file")
    if header.height < 1 or header.width < 1 or header.height * header.width > MAX_FRAME_PIXELS:
        raise BadFrame(
            f"found a header that says {header.width}×{header.height} pixels, expected 1 to {MAX_FRAME_PIXELS:,} pixels"
        )
    if header.bits not in (8, 16):
        raise OtherFrame(f"found {header.bits} bits per pixel, expected 8 or 16")
    return header


def _bmp_header(source: FrameSource) -> FrameHeader:
    pixels_at, header_size, width, height, _, bits, compression = struct.unpack("<IIiiHHI", source.read(10, 24))
    height = abs(height)  # negative: stored top-down
    if header_size not in _BMP_HEADERS:
        raise BadFrame(f"found a BMP with a header of {header_size} bytes, expected one of {_BMP_HEADERS[0]} or more")
    if bits != 8 or compression not in (0, 1):
        raise OtherFrame(
            f"found a BMP with {bits} bits per pixel (compression {compression}), expected a grey one with 8"
        )
    palette_at = 14 + header_size
    (stated,) = struct.unpack("<I", source.read(46, 4))
    entries = stated or 256
    if entries > 256 or pixels_at < palette_at + 4 * entries:
        raise BadFrame("found a BMP whose header contradicts itself, expected a whole one")
    palette = np.frombuffer(source.read(palette_at, 4 * entries), np.uint8).reshape(-1, 4)
    if (palette[:, :3] != palette[:, :1]).any():
        raise OtherFrame("found a BMP with a colour palette, expected a grey one")
    if compression == 0 and pixels_at + (width + 3) // 4 * 4 * height > source.size:
        raise BadFrame(f"found a BMP truncated after {source.size} bytes, expected a whole one")
    return FrameHeader(height, width, bits)


def _npy_header(source: FrameSource) -> FrameHeader:
    shape, dtype, _, start = _npy_layout(source)
    if start + shape[0] * shape[1] * dtype.itemsize > source.size:
        raise BadFrame(f"found an npy file truncated after {source.size} bytes, expected a whole one")
    return FrameHeader(shape[0], shape[1], 8 * dtype.itemsize)


def _npy_layout(source: FrameSource) -> tuple[tuple[int, int], np.dtype, Literal["C", "F"], int]:
    """Shape, type and order of an npy file's array, and where its numbers begin.

    The header is Python text, but only its one usual form is read: nothing of a file is ever evaluated.
    """
    major, _ = source.read(6, 2)
    size_at_8 = "<H" if major == 1 else "<I"
    (size,) = struct.unpack(size_at_8, source.read(8, struct.calcsize(size_at_8)))
    start = 8 + struct.calcsize(size_at_8) + size
    if major not in (1, 2, 3) or size > _MAX_NPY_HEADER_BYTES:
        raise BadFrame(f"found an npy header of version {major} with {size} bytes, expected a usual one")
    text = source.read(start - size, size).decode("latin-1")
    match = _NPY_HEADER.fullmatch(text)
    if not match:
        raise BadFrame(f"found a damaged npy header ({brief(text.strip())}), expected a whole one")
    kind, fortran, lengths = match.groups()
    shape = [int(length.rstrip("L")) for length in lengths.split(",") if length.strip()]
    if len(shape) != 2 or kind not in _NPY_TYPES:
        raise BadFrame(
            f"found an npy array of shape {brief(str(tuple(shape)))} and type {brief(kind)}, expected (h, w) of uint8 "
            "or uint16"
        )
    return (shape[0], shape[1]), _NPY_TYPES[kind], "F" if fortran == "True" else "C", start


def _decode_into(frame: Frame, data: bytes, expected: FrameHeader, chunks: Sequence[png.Chunk]) -> None:
    if data[:6] == _NPY_SIGNATURE:
        shape, dtype, order, start = _npy_layout(source_of(data))
        frame[:] = np.frombuffer(data, dtype, shape[0] * shape[1], start).reshape(shape, order=order)
        return
    if data[:8] == png.SIGNATURE and png.decode_into(frame, data, png.checked_image_data(data, chunks)):
        return
    decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if decoded is not None and decoded.ndim == 3 and (decoded == decoded[..., :1]).all():
        decoded = decoded[..., 0]  # a palette of greys
    if decoded is None or decoded.shape != (expected.height, expected.width) or decoded.dtype != expected.dtype:
        raise BadFrame(f"found an image that does not decode, expected {expected}")
    frame[:] = decoded


def _check_byte_order(frame: Frame) -> None:
    """Refuse 16-bit samples that would be smooth if their bytes were swapped, and are not as they are."""
    if frame.dtype != np.uint16:
        return
    k = _ROUGHNESS_STRIDE
    here, beside, below = frame[:-1:k, :-1:k], frame[:-1:k, 1::k], frame[1::k, :-1:k]
    rough = _roughness(here, beside, below)
    swapped = _roughness(here.byteswap(), beside.byteswap(), below.byteswap())
    if rough > _SWAPPED * swapped:
        raise BadFrame(
            "found 16-bit samples whose bytes look swapped (the high bytes are noisier than the low ones), expected "
            "them in the order that the file's format has"
        )


def _roughness(here: Frame, beside: Frame, below: Frame) -> float:
    """Mean difference of neighbouring pixels over the picture's spread, along rows or columns, whichever is less."""
    if not here.size or here.min() == here.max():
        return 0.0
    level = here.astype(np.float32)
    return float(min(np.abs(beside - level).mean(), np.abs(below - level).mean()) / level.std())
