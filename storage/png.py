"""PNG files: structure, checksums and samples of grey ones, as cameras' frames come, and pictures written as PNG.

OpenCV decodes frames of unusual form.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from storage.frame_source import BadFrame, FrameSource, OtherFrame, ShortFrame, source_of
from storage.tiff import TiffDirectory, check_orientation

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHUNK_OVERHEAD = 12  # length, type and CRC
_MAX_CHUNKS = 100_000
_MAX_EXIF_BYTES = 65_536
_GREY, _COLOUR, _PALETTE = 0, 2, 3
_UP = 2  # filter of a row: differences to the one above
Chunk = tuple[bytes, int, int]
"""Type, and start and length of the content."""
_COLOURS = {_COLOUR: "colour", _PALETTE: "palette", 4: "grey with alpha", 6: "colour with alpha"}


def size_and_bits(source: FrameSource, walked: list[Chunk] | None = None) -> tuple[int, int, int]:
    """Height, width and bits per sample that the header of a grey, whole PNG says; nothing is decoded.

    A palette of greys, as programs that shrink files make it of a grey picture, counts as 8 bits.

    Parameters
    ----------
    walked : list, optional
        Gets the PNG's chunks.
    """
    width, height, bits, colour = struct.unpack(">IIBB", source.read(16, 10))
    if source.read(12, 4) != b"IHDR":
        raise BadFrame("found a PNG that does not begin with its header, expected a whole one")
    grey = colour == _GREY
    for chunk in chunks_of(source):
        kind, start, length = chunk
        if walked is not None:
            walked.append(chunk)
        if kind == b"PLTE" and colour == _PALETTE and length <= 3 * 256:
            palette = np.frombuffer(source.read(start, length // 3 * 3), np.uint8).reshape(-1, 3)
            grey, bits = bool((palette == palette[:, :1]).all()), 8
        elif kind == b"tRNS" and colour == _PALETTE:
            grey = False
        elif kind == b"eXIf":
            _check_exif(source.read(start, min(length, _MAX_EXIF_BYTES)))
        if kind in (b"IDAT", b"tRNS") and not grey:
            break
    if not grey:
        raise OtherFrame(f"found a {_COLOURS.get(colour, 'unknown')} PNG, expected a grey one")
    return height, width, bits


def stated_sums(data: bytes, chunks: Iterable[Chunk]) -> bytes:
    """The checksums that a whole PNG states of its chunks, one after the other."""
    return b"".join(data[start + length : start + length + 4] for _, start, length in chunks)


def checked_image_data(data: bytes, chunks: Iterable[Chunk]) -> bytes:
    """The compressed samples of a PNG; one with a chunk that is not what its checksum says is refused."""
    view = memoryview(data)
    parts = []
    for kind, start, length in chunks:
        (stated,) = struct.unpack(">I", view[start + length : start + length + 4])
        if isal_zlib.crc32(view[start - 4 : start + length]) != stated:
            raise BadFrame(f"found a damaged PNG (checksum differs at byte {start}), expected a whole one")
        if kind == b"IDAT":
            parts.append(view[start : start + length])
    return b"".join(parts)


def decode_into(frame: NDArray[np.uint8] | NDArray[np.uint16], data: bytes, image_data: bytes) -> bool:
    """Decode a PNG with samples of the frame's type, in one pass; False where it has another form or is damaged.

    Other threads go on meanwhile, and it takes half of OpenCV's time: ISA-L inflates, compiled code undoes the filters.
    """
    from storage.png_filters import unfilter  # compiled code, which other commands than inspections do not need

    height, width = frame.shape
    row_bytes = width * frame.itemsize
    if struct.unpack_from(">IIBBBBB", data, 16) != (width, height, 8 * frame.itemsize, _GREY, 0, 0, 0):
        return False
    stream = isal_zlib.decompressobj()
    try:
        inflated = stream.decompress(image_data, height * (row_bytes + 1) + 1)
    except isal_zlib.error:  # type: ignore[misc]  # its stub does not say that it is an exception
        return False
    if not stream.eof or len(inflated) != height * (row_bytes + 1):
        return False
    stored = np.frombuffer(inflated, np.uint8).reshape(height, row_bytes + 1)
    if frame.itemsize == 1:
        return bool(unfilter(stored, 1, frame))
    samples = np.empty((height, row_bytes), np.uint8)
    known = bool(unfilter(stored, frame.itemsize, samples))
    frame[:] = samples.view(">u2")
    return known


def encode(picture: NDArray[np.uint8]) -> bytes:
    """A grey (h, w) picture, or one in red, green and blue (h, w, 3), as a PNG.

    Each row is stored as its differences to the one above, deflated by ISA-L.
    """
    height, width = picture.shape[:2]
    rows = picture.reshape(height, -1)
    stored = np.full((height, rows.shape[1] + 1), _UP, np.uint8)
    stored[:1, 1:] = rows[:1]
    np.subtract(rows[1:], rows[:-1], out=stored[1:, 1:])
    header = struct.pack(">IIBBBBB", width, height, 8, _GREY if picture.ndim == 2 else _COLOUR, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", isal_zlib.compress(stored, 1)), (b"IEND", b""))
    return SIGNATURE + b"".join(_chunk(kind + content) for kind, content in chunks)


def _chunk(content: bytes) -> bytes:
    """A chunk of a PNG: length, kind and content, checksum."""
    return struct.pack(">I", len(content) - 4) + content + struct.pack(">I", isal_zlib.crc32(content))


def _check_exif(data: bytes) -> None:
    """Refuse a PNG that is to be turned before it is shown; what else Exif says, right or not, is nobody's concern."""
    try:
        directory = TiffDirectory.read(source_of(data))
    except BadFrame:
        return
    check_orientation(directory)


def chunks_of(source: FrameSource) -> Iterator[Chunk]:
    """Each chunk up to IEND; a file that ends before it is refused."""
    offset = len(SIGNATURE)
    for _ in range(_MAX_CHUNKS):
        if offset + _CHUNK_OVERHEAD > source.size:
            break
        try:
            length, kind = struct.unpack(">I4s", source.read(offset, 8))
        except ShortFrame:
            break
        if offset + _CHUNK_OVERHEAD + length > source.size:
            break
        yield kind, offset + 8, length
        if kind == b"IEND":
            return
        offset += _CHUNK_OVERHEAD + length
    else:
        raise BadFrame(f"found a PNG of more than {_MAX_CHUNKS:,} chunks, expected a camera's frame")
    raise BadFrame(f"found a PNG truncated after {source.size} bytes, expected a whole one")
