"""PNG frames decoded in one pass are those that OpenCV reads, whatever filters an encoder chose."""

from __future__ import annotations

import struct
import zlib
from itertools import pairwise

import cv2
import numpy as np
import pytest

from metrology.errors import SceneError
from storage import png
from storage.frame_source import source_of
from storage.frames import FrameHeader, read_frame


@pytest.fixture
def rng() -> np.random.Generator:
    """Random pictures, the same each time."""
    return np.random.default_rng(11)


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def _predicted(kind: int, left: np.ndarray, up: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """What a filter expects of a byte, after the table of the specification."""
    if kind == 4:
        distance = np.abs(np.stack([up - corner, left - corner, left + up - 2 * corner]))
        return np.choose(distance.argmin(0), [left, up, corner])
    return (np.zeros_like(up), left, up, (left + up) // 2, np.zeros_like(up))[min(kind, 4)]


def _encoded(frame: np.ndarray, kinds: np.ndarray, interlace: int = 0, parts: int = 1) -> bytes:
    """A PNG whose rows have the given filters."""
    height, width = frame.shape
    size = frame.itemsize
    rows = np.frombuffer(frame.astype(f">u{size}").tobytes(), np.uint8).reshape(height, width * size).astype(int)
    padded = np.zeros((height + 1, width * size + size), int)
    padded[1:, size:] = rows
    left, up, corner = padded[1:, :-size], padded[:-1, size:], padded[:-1, :-size]
    stored = np.array(
        [[kind, *((rows[y] - _predicted(kind, left[y], up[y], corner[y])) & 255)] for y, kind in enumerate(kinds)]
    )
    packed = zlib.compress(stored.astype(np.uint8).tobytes())
    cuts = np.linspace(0, len(packed), parts + 1).astype(int)
    head = struct.pack(">IIBBBBB", width, height, 8 * size, 0, 0, 0, interlace)
    data = b"".join(_chunk(b"IDAT", packed[a:b]) for a, b in pairwise(cuts))
    return png.SIGNATURE + _chunk(b"IHDR", head) + data + _chunk(b"IEND", b"")


def decoded(frame: np.ndarray, data: bytes) -> bool:
    """Whether the one pass decodes a file into the frame."""
    return png.decode_into(frame, data, png.checked_image_data(data, png.chunks_of(source_of(data))))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("size", [(40, 31), (3, 1), (1, 5)])
def test_every_filter_gives_the_picture_that_was_stored(rng, dtype, size):
    frame = rng.integers(0, np.iinfo(dtype).max, size, dtype, endpoint=True)
    data = _encoded(frame, rng.permutation(np.arange(size[0]) % 5), parts=3)
    found = np.zeros_like(frame)
    assert decoded(found, data)
    assert (found == frame).all()
    assert (cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) == frame).all()


@pytest.mark.parametrize("level", [0, 1, 9])
def test_frames_of_another_encoder_are_read_alike(rng, level, tmp_path):
    frame = np.cumsum(rng.integers(0, 3, (60, 70)), axis=1).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "f.png"), frame, [cv2.IMWRITE_PNG_COMPRESSION, level])
    found = np.zeros_like(frame)
    assert decoded(found, (tmp_path / "f.png").read_bytes())
    assert (found == frame).all()


def test_what_has_another_form_is_left_to_the_general_decoder(rng):
    frame = rng.integers(0, 255, (8, 8), np.uint8)
    kinds = np.zeros(8, int)
    found = np.zeros_like(frame)
    assert not decoded(found, _encoded(frame, kinds, interlace=1))
    assert not decoded(found.astype(np.uint16), _encoded(frame, kinds))
    assert not decoded(found, _encoded(np.vstack([frame, frame]), np.zeros(16, int)))
    assert not decoded(found, _encoded(frame, np.where(np.arange(8) == 4, 5, 0)))  # no filter has this number


def test_image_data_that_end_early_are_refused(rng, tmp_path):
    frame = rng.integers(0, 255, (8, 8), np.uint8)
    whole = _encoded(frame, np.zeros(8, int))
    at = whole.index(b"IDAT") - 4
    packed = zlib.compress(np.zeros((4, 9), np.uint8).tobytes())  # four of the eight rows
    path = tmp_path / "f.png"
    path.write_bytes(whole[:at] + _chunk(b"IDAT", packed) + _chunk(b"IEND", b""))
    with pytest.raises(SceneError, match=r"f\.png: found"):
        read_frame(path, FrameHeader(8, 8, 8), SceneError)
