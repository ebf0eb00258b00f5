"""Pictures of the store made small enough for a page."""

from __future__ import annotations

import base64
from pathlib import Path

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
    ok, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    if not ok:
        raise StoreError(f"found a picture of shape {picture.shape} that does not encode, expected grey levels")
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()


def around(picture: NDArray[np.uint8], u: float, v: float, reach: float) -> NDArray[np.uint8]:
    """The part of a picture within `reach` pixels of (u, v); at least one pixel."""
    height, width = picture.shape
    u, v = min(max(u, 0), width - 1), min(max(v, 0), height - 1)
    rows = slice(max(0, int(v - reach)), int(v + reach) + 1)
    columns = slice(max(0, int(u - reach)), int(u + reach) + 1)
    return picture[rows, columns]
