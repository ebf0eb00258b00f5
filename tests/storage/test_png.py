"""PNG frames: what they hold is read back, and what is sound in its chunks but not in its stream is refused."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from metrology.errors import SceneError
from storage.frames import read_frame, read_header
from storage.png import encode


def chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png(image: NDArray, lines: bytes, interlaced: bool = False, pieces: int = 2) -> bytes:
    """A PNG of grey lines as they are to be compressed, in several IDAT chunks as large files have them."""
    height, width = image.shape
    stream = zlib.compress(lines)
    cut = len(stream) // pieces + 1
    data = b"".join(chunk(b"IDAT", stream[k : k + cut]) for k in range(0, len(stream), cut))
    header = struct.pack(">IIBBBBB", width, height, 8 * image.itemsize, 0, 0, 0, int(interlaced))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + data + chunk(b"IEND", b"")


def read(path: Path, content: bytes) -> NDArray:
    path.write_bytes(content)
    return read_frame(path, read_header(path, SceneError), SceneError)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_what_opencv_writes_is_read_back(tmp_path: Path, dtype: type) -> None:
    image = np.random.default_rng(5).integers(0, np.iinfo(dtype).max, (31, 57), dtype)
    content = cv2.imencode(".png", image)[1].tobytes()
    np.testing.assert_array_equal(read(tmp_path / "frame.png", content), image)


def test_an_interlaced_frame_is_read_too(tmp_path: Path) -> None:
    image = np.random.default_rng(6).integers(0, 255, (17, 13), np.uint8)
    passes = [(0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1)]
    lines = b"".join(b"\0" + row.tobytes() for y, x, dy, dx in passes for row in image[y::dy, x::dx])
    np.testing.assert_array_equal(read(tmp_path / "frame.png", png(image, lines, interlaced=True)), image)


@pytest.mark.parametrize("lines", [b"\0" * 11 * 9, b"\5" * 11 * 10], ids=["a row short", "an unknown filter"])
def test_a_frame_with_other_content_than_its_header_says_is_refused(tmp_path: Path, lines: bytes) -> None:
    with pytest.raises(SceneError, match="does not decode"):
        read(tmp_path / "frame.png", png(np.zeros((10, 10), np.uint8), lines))


def test_a_stream_damaged_where_chunks_are_sound_is_refused(tmp_path: Path) -> None:
    image = np.zeros((10, 10), np.uint8)
    stream = bytearray(zlib.compress(b"\0" * 110))
    stream[-1] ^= 1  # the stream's own checksum
    content = png(image, b"")
    start = content.index(b"IDAT") - 4
    damaged = content[:start] + chunk(b"IDAT", bytes(stream)) + chunk(b"IEND", b"")
    with pytest.raises(SceneError, match="does not decode"):
        read(tmp_path / "frame.png", damaged)


@pytest.mark.parametrize("shape", [(1, 1), (7, 5), (31, 57), (9, 4, 3)])
def test_what_is_encoded_is_what_opencv_and_this_reader_decode(tmp_path: Path, shape: tuple[int, ...]) -> None:
    picture = np.random.default_rng(7).integers(0, 255, shape, np.uint8)
    content = encode(picture)
    decoded = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(decoded[..., ::-1] if picture.ndim == 3 else decoded, picture)
    if picture.ndim == 2:
        np.testing.assert_array_equal(read(tmp_path / "picture.png", content), picture)
