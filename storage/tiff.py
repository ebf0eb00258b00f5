"""The first directory of a grey TIFF file (classic or BigTIFF), read within bounds; OpenCV decodes the pixels."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass

from storage.frame_source import BadFrame, FrameSource, OtherFrame, ShortFrame

SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")

_SIZES = {1: 1, 3: 2, 4: 4, 16: 8}  # bytes of BYTE, SHORT, LONG, LONG8
_CODES = {1: "B", 3: "H", 4: "I", 16: "Q"}
_WIDTH, _HEIGHT, _BITS, _PHOTOMETRIC, _ORIENTATION, _SAMPLES = 256, 257, 258, 262, 274, 277
_SAMPLE_FORMAT, _TILE_WIDTH, _TILE_HEIGHT = 339, 322, 323
_STRIP_OFFSETS, _STRIP_COUNTS, _TILE_OFFSETS, _TILE_COUNTS = 273, 279, 324, 325
_SINGLE = (_WIDTH, _HEIGHT, _BITS, _PHOTOMETRIC, _ORIENTATION, _SAMPLES, _SAMPLE_FORMAT, _TILE_WIDTH, _TILE_HEIGHT)
_LISTS = (_STRIP_OFFSETS, _STRIP_COUNTS, _TILE_OFFSETS, _TILE_COUNTS)
_MAX_TAGS = 65_535  # what a classic file can have
_MAX_PIECES = 1_000_000  # strips or tiles
_MAX_TILE_SIDE = 65_536
_WHITE_IS_ZERO, _BLACK_IS_ZERO = 0, 1
_ORIENTATIONS = {
    2: "mirrored left to right", 3: "turned by 180°", 4: "mirrored top to bottom", 5: "mirrored and turned by 90°",
    6: "to be turned by 90°", 7: "mirrored and turned by 90°", 8: "to be turned by 270°",
}  # fmt: skip


@dataclass(frozen=True)
class TiffDirectory:
    """What is asked of a directory."""

    values: Mapping[int, tuple[int, ...]]
    """mapping of tag to tuple of int: of the tags that say how the pixels lie; of others than lists only the first
    value."""
    following: int
    """Where the next directory begins; 0: nowhere."""

    def first(self, tag: int, default: int) -> int:
        """A tag's first value."""
        return (self.values.get(tag) or (default,))[0]

    @classmethod
    def read(cls, source: FrameSource) -> TiffDirectory:
        """The first directory of a file; other tags than those asked for are passed over, and never followed."""
        start = source.read(0, 8)
        if start[:4] not in SIGNATURES:
            raise BadFrame("found no TIFF header, expected one")
        order = "<" if start[:2] == b"II" else ">"
        big = start[2:4] in (b"+\0", b"\0+")
        word, entry_size, inline, count_size = ("Q", 20, 8, 8) if big else ("I", 12, 4, 2)
        (at,) = struct.unpack(order + word, source.read(8, 8) if big else start[4:8])
        (count,) = struct.unpack(order + ("Q" if big else "H"), source.read(at, count_size))
        if count > _MAX_TAGS:
            raise BadFrame(f"found a TIFF of {count} tags, expected at most {_MAX_TAGS}")
        entries = source.read(at + count_size, count * entry_size)
        values: dict[int, tuple[int, ...]] = {}
        for tag, kind, n, content in struct.iter_unpack(f"{order}HH{word}{inline}s", entries):
            if kind not in _SIZES or (tag not in _SINGLE and tag not in _LISTS):
                continue
            if tag in values:
                raise BadFrame(f"found tag {tag} of a TIFF twice, expected it once")
            values[tag] = _values(source, order, kind, n if tag in _LISTS else min(n, 1), n, content)
        (following,) = struct.unpack(order + word, source.read(at + count_size + count * entry_size, inline))
        return cls(values, following)


def size_and_bits(source: FrameSource) -> tuple[int, int, int]:
    """Height, width and bits per sample that the header of a grey, whole TIFF of one page says; nothing is decoded."""
    try:
        directory = TiffDirectory.read(source)
    except ShortFrame:
        raise BadFrame(
            f"found a TIFF with a damaged header, or truncated after {source.size} bytes, expected a whole one"
        ) from None
    samples, photometric = directory.first(_SAMPLES, 1), directory.first(_PHOTOMETRIC, _BLACK_IS_ZERO)
    if samples == 1 and photometric == _WHITE_IS_ZERO:
        raise BadFrame(
            "found a TIFF in which 0 is white (photometric interpretation WhiteIsZero), expected one in which 0 is "
            "black: grey levels upside down are no camera's"
        )
    if directory.following:
        raise BadFrame("found a TIFF of several pages, expected one frame per file (scene guess writes its pages)")
    check_orientation(directory)
    if samples != 1 or photometric != _BLACK_IS_ZERO:
        raise OtherFrame(f"found a TIFF with {samples} samples per pixel or a palette, expected a grey one")
    if directory.first(_SAMPLE_FORMAT, 1) != 1:
        raise BadFrame("found a TIFF of signed or floating-point numbers, expected whole numbers from 0")
    _check_pieces(directory, source.size)
    return directory.first(_HEIGHT, 0), directory.first(_WIDTH, 0), directory.first(_BITS, 1)


def check_orientation(directory: TiffDirectory) -> None:
    """Refuse a picture that is to be turned or mirrored: the rig knows the camera's pixels as the sensor has them."""
    orientation = directory.first(_ORIENTATION, 1)
    if orientation > 1:
        meaning = _ORIENTATIONS.get(orientation, "unknown")
        raise BadFrame(
            f"found orientation tag {orientation} ({meaning}), expected 1: frames as the sensor has them, "
            "as in the rig's calibration"
        )


def _values(source: FrameSource, order: str, kind: int, wanted: int, stated: int, content: bytes) -> tuple[int, ...]:
    """The first `wanted` of `stated` values, which lie in the entry itself if they fit, else where it points."""
    if wanted > _MAX_PIECES:
        raise BadFrame(f"found a TIFF of {stated} strips or tiles, expected at most {_MAX_PIECES:,}")
    size = _SIZES[kind] * wanted
    if _SIZES[kind] * stated > len(content):
        (place,) = struct.unpack(order + ("Q" if len(content) == 8 else "I"), content)
        content = source.read(place, size)
    return struct.unpack(f"{order}{wanted}{_CODES[kind]}", content[:size])


def _check_pieces(directory: TiffDirectory, size: int) -> None:
    """Strips or tiles must lie in the file, and tiles must not be far larger than pictures are."""
    offsets = directory.values.get(_STRIP_OFFSETS) or directory.values.get(_TILE_OFFSETS) or ()
    counts = directory.values.get(_STRIP_COUNTS) or directory.values.get(_TILE_COUNTS) or ()
    whole = offsets and len(offsets) == len(counts)
    if not whole or any(at + n > size for at, n in zip(offsets, counts, strict=True)):
        raise BadFrame(f"found a TIFF truncated after {size} bytes, expected a whole one")
    side = max(directory.first(_TILE_WIDTH, 1), directory.first(_TILE_HEIGHT, 1))
    if side > _MAX_TILE_SIDE:
        raise BadFrame(f"found a TIFF with tiles of {side} pixels, expected at most {_MAX_TILE_SIDE}")
