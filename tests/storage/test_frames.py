"""Frame files as other programs write them: read right, or refused with the true reason."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from metrology.errors import SceneError
from storage.frames import FrameHeader, read_as_grey, read_frame, read_header

HEIGHT, WIDTH = 40, 60


def picture(dtype: type) -> NDArray:
    """A shaded, noisy picture that fills its range."""
    top = np.iinfo(dtype).max
    shade = np.linspace(0.1 * top, 0.9 * top, WIDTH) + np.random.default_rng(1).normal(0, 0.002 * top, (HEIGHT, WIDTH))
    return shade.astype(dtype)


def tiff(image: NDArray, order: str = "<", more: tuple[tuple[int, int, int], ...] = (), **tags: int) -> bytes:
    """An uncompressed TIFF of one strip; `more` are further tags (number, count, content) of type LONG."""
    height, width = image.shape
    data = image.astype(image.dtype.newbyteorder(order)).tobytes()
    entries = [
        (256, 1, width), (257, 1, height), (258, 1, 8 * image.itemsize), (259, 1, 1),
        (262, 1, tags.get("photometric", 1)), (273, 1, 8), (274, 1, tags.get("orientation", 1)), (277, 1, 1),
        (278, 1, height), (279, 1, len(data)), *more,
    ]  # fmt: skip
    start = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", 8 + len(data)) + data
    directory = b"".join(struct.pack(order + "HHII", tag, 4, count, value) for tag, count, value in entries)
    following = struct.pack(order + "I", tags.get("following", 0))
    return start + struct.pack(order + "H", len(entries)) + directory + following


def chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png(image: NDArray, colour: int = 0, before: bytes = b"") -> bytes:
    """A PNG whose rows are as they are; `before` are chunks that stand before its pixels."""
    height, width = image.shape
    header = struct.pack(">IIBBBBB", width, height, 8 * image.itemsize, colour, 0, 0, 0)
    rows = b"".join(b"\0" + row.tobytes() for row in image.astype(image.dtype.newbyteorder(">")))
    pixels = chunk(b"IDAT", zlib.compress(rows))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + before + pixels + chunk(b"IEND", b"")


def exif(orientation: int) -> bytes:
    entry = struct.pack("<HHIHH", 274, 3, 1, orientation, 0)
    return chunk(b"eXIf", b"II*\0" + struct.pack("<IH", 8, 1) + entry + struct.pack("<I", 0))


def npy(header: bytes, data: bytes) -> bytes:
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(header)) + header + data


def read(tmp_path: Path, content: bytes) -> NDArray:
    path = tmp_path / "frame"
    path.write_bytes(content)
    return read_frame(path, read_header(path, SceneError), SceneError)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_tiff_of_either_byte_order_is_read_right(tmp_path: Path, order: str, dtype: type) -> None:
    np.testing.assert_array_equal(read(tmp_path, tiff(picture(dtype), order)), picture(dtype))


@pytest.mark.parametrize("order", ["<u2", ">u2"])
@pytest.mark.parametrize("layout", ["C", "F"])
def test_npy_of_either_byte_order_and_layout_is_read_right(tmp_path: Path, order: str, layout: str) -> None:
    np.save(tmp_path / "f.npy", np.array(picture(np.uint16).astype(order), order=layout))
    np.testing.assert_array_equal(read(tmp_path, (tmp_path / "f.npy").read_bytes()), picture(np.uint16))


def test_a_palette_of_greys_is_read_as_the_greys(tmp_path: Path) -> None:
    greys = np.arange(255, -1, -1, dtype=np.uint8)
    content = png(picture(np.uint8), 3, chunk(b"PLTE", np.repeat(greys, 3).tobytes()))
    np.testing.assert_array_equal(read(tmp_path, content), greys[picture(np.uint8)])


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize(
    ("tags", "said"),
    [
        ({"photometric": 0}, "0 is white"),
        ({"photometric": 3}, "a palette"),
        ({"orientation": 3}, r"orientation tag 3 \(turned by 180°\), expected 1"),
        ({"orientation": 6}, r"orientation tag 6 \(to be turned by 90°\)"),
        ({"following": 8}, "several pages"),
    ],
)
def test_a_tiff_that_means_other_pixels_is_refused_by_its_reason(
    tmp_path: Path, dtype: type, tags: dict[str, int], said: str
) -> None:
    with pytest.raises(SceneError, match=said):
        read(tmp_path, tiff(picture(dtype), **tags))


def test_an_orientation_in_a_png_is_refused_and_other_exif_is_not(tmp_path: Path) -> None:
    image = picture(np.uint8)
    with pytest.raises(SceneError, match="orientation tag 8"):
        read(tmp_path, png(image, before=exif(8)))
    for harmless in (exif(1), chunk(b"eXIf", b"II*\0 nothing of use")):
        np.testing.assert_array_equal(read(tmp_path, png(image, before=harmless)), image)


@pytest.mark.parametrize("bits", [10, 12, 16])
def test_swapped_bytes_are_recognised(tmp_path: Path, bits: int) -> None:
    image = picture(np.uint16) >> (16 - bits)
    np.testing.assert_array_equal(read(tmp_path, png(image)), image)
    for content in (png(image.byteswap()), tiff(image.byteswap())):
        with pytest.raises(SceneError, match="bytes look swapped"):
            read(tmp_path, content)


def test_noise_and_even_frames_are_not_taken_for_swapped(tmp_path: Path) -> None:
    noise = np.random.default_rng(2).integers(0, 2**16, (HEIGHT, WIDTH), np.uint16)
    for image in (noise, np.full((HEIGHT, WIDTH), 256, np.uint16), noise % 9 + 250, np.zeros((1, 1), np.uint16)):
        np.testing.assert_array_equal(read(tmp_path, png(image)), image)


def test_a_tiff_of_thousands_of_tags_is_read_within_bounds(tmp_path: Path) -> None:
    image = np.zeros((1000, 1000), np.uint8)
    many = tuple((40_000 + k, 250_000, 8) for k in range(2000))  # each of them points at a megabyte
    path = tmp_path / "frame"
    path.write_bytes(tiff(image, more=many))
    assert read_header(path, SceneError) == FrameHeader(1000, 1000, 8)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (((324, 2_000_000, 8), (325, 2_000_000, 8)), "2000000 strips or tiles, expected at most"),
        (((279, 1, 100),), "tag 279 of a TIFF twice"),
        (((322, 1, 2**31),), "tiles of 2147483648 pixels"),
    ],
)
def test_a_tiff_that_asks_for_too_much_is_refused(
    tmp_path: Path, more: tuple[tuple[int, int, int], ...], said: str
) -> None:
    with pytest.raises(SceneError, match=said):
        read(tmp_path, tiff(picture(np.uint8), more=more))


@pytest.mark.parametrize(
    ("header", "said"),
    [
        (b"{'descr': '|O', 'fortran_order': False, 'shape': (4, 4), }\n", "type '|O'"),
        (b"{'descr': '<f4', 'fortran_order': False, 'shape': (4, 4), }\n", "type '<f4'"),
        (b"{'descr': '<u2', 'fortran_order': False, 'shape': (4,), }\n", "shape (4,"),
        (b"{'descr': '<u2', 'fortran_order': False, 'shape': (99999999999999999999, 4), }\n", "truncated"),
        (b"{'descr': '<u2', 'fortran_order': False, 'shape': (4, 4) + (1,), }\n", "damaged npy header"),
        (b"{'descr': '\\d', 'fortran_order': False, 'shape': ((((((((\n", "damaged npy header"),
        (b"\xff\xfe\n", "damaged npy header"),
    ],
)
def test_an_npy_header_is_never_evaluated(tmp_path: Path, header: bytes, said: str) -> None:
    with pytest.raises(SceneError, match="frame: found") as caught:
        read(tmp_path, npy(header, bytes(64)))
    assert said in str(caught.value)
    assert str(caught.value).isprintable()


def test_every_changed_byte_of_an_npy_header_is_read_or_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "f.npy", picture(np.uint8))
    content = (tmp_path / "f.npy").read_bytes()
    said = []
    for at in range(128):
        for value in (content[at] ^ 1, 0, 255, ord("("), ord("\\")):
            try:
                read(tmp_path, content[:at] + bytes([value]) + content[at + 1 :])
            except SceneError as problem:
                said.append(str(problem))
    assert len(said) > 200
    assert all(text.isprintable() for text in said)


def test_a_frame_cut_short_while_it_is_read_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "frame"
    path.write_bytes(png(picture(np.uint8)))
    whole = path.stat().st_size
    monkeypatch.setattr("storage.frame_source.os.fstat", lambda _: type("Status", (), {"st_size": whole}))
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(SceneError, match="truncated"):
        read_header(path, SceneError)


def test_a_bmp_whose_pixels_begin_in_its_palette_is_refused(tmp_path: Path) -> None:
    content = bytearray(cv2.imencode(".bmp", picture(np.uint8))[1].tobytes())
    content[10:14] = struct.pack("<I", struct.unpack("<I", content[10:14])[0] - 1)
    with pytest.raises(SceneError, match="BMP whose header contradicts itself"):
        read(tmp_path, bytes(content))


@pytest.mark.parametrize("kind", ["jpg", "png", "tif"])
@pytest.mark.parametrize("mode", ["L", "RGB"])
@pytest.mark.parametrize("orientation", [2, 3, 6, 8])
def test_pictures_that_are_to_be_turned_are_refused(kind: str, mode: str, orientation: int, tmp_path: Path) -> None:
    tags = Image.Exif()
    tags[274] = 1
    image, path = Image.fromarray(picture(np.uint8)).convert(mode), tmp_path / f"x.{kind}"
    image.save(path, exif=tags)
    upright = read_as_grey(path, SceneError)
    assert upright is not None
    assert upright.shape == (HEIGHT, WIDTH)
    tags[274] = orientation
    image.save(path, exif=tags)
    with pytest.raises(SceneError, match=f"x.{kind}: found .*orientation.*expected .*as the sensor has them"):
        read_as_grey(path, SceneError)
