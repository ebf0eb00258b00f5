"""Pictures of the store made small enough for a page."""

from __future__ import annotations

import base64
from pathlib import Path
from urllib.parse import quote

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.errors import StoreError

_JPEG_QUALITY = 85


def load_picture(path: Path) -> NDArray[np.uint8]:
    """A picture as grey levels (h, w)."""
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if picture is None:
        raise StoreError(f"{path}: found a file that is no picture, expected a PNG")
    return np.asarray(picture, np.uint8)


def shrunk(picture: NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    """A picture at most `width` pixels wide."""
    if picture.shape[1] <= width:
        return picture
    height = max(1, round(picture.shape[0] * width / picture.shape[1]))
    return np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def data_uri(picture: NDArray[np.uint8]) -> str:
    """A picture as a JPEG inside a URI."""
    return _uri(picture, "jpeg", [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])


def masked_uri(picture: NDArray[np.uint8], seen: NDArray[np.bool_]) -> str:
    """A picture inside a URI, transparent where `seen` (h, w) is false.

    A JPEG behind a mask: formats that know transparency take fifty times as long to write.
    """
    height, width = picture.shape
    size = f'width="{width}" height="{height}"'
    mask = _uri(np.where(seen, 255, 0).astype(np.uint8), "png", [])
    drawing = (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} viewBox="0 0 {width} {height}" preserveAspectRatio="none">'
        f'<mask id="seen"><image href="{mask}" {size}/></mask>'
        f'<image href="{data_uri(picture)}" {size} mask="url(#seen)"/></svg>'
    )
    return "data:image/svg+xml," + quote(drawing, safe=" =/:;,+()")


def _uri(picture: NDArray[np.uint8], kind: str, options: list[int]) -> str:
    ok, data = cv2.imencode(f".{kind}", picture, options)
    if not ok:
        raise StoreError(f"found a picture of shape {picture.shape} that does not encode, expected grey levels")
    return f"data:image/{kind};base64," + base64.b64encode(data.tobytes()).decode()


def around(picture: NDArray[np.uint8], u: float, v: float, reach: float) -> NDArray[np.uint8]:
    """The part of a picture within `reach` pixels of (u, v); at least one pixel."""
    height, width = picture.shape
    u, v = min(max(u, 0), width - 1), min(max(v, 0), height - 1)
    rows = slice(max(0, int(v - reach)), int(v + reach) + 1)
    columns = slice(max(0, int(u - reach)), int(u + reach) + 1)
    return picture[rows, columns]
