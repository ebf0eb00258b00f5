"""Outlines that may be dots."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Contour = NDArray[np.int32]

_LEAST_AREA_PX = 40.0
_LEAST_ASPECT = 0.2
_ELLIPSE_AREA = 0.12  # how much an outline's area may differ from its ellipse's
_KERNEL_PART = 8  # dots are smaller than this part of the image's width
_DARK_BACKGROUND = 0.15  # of the brightest level: no board there


def printed_blobs(lit: NDArray[np.float64]) -> list[Contour]:
    """Outlines of dark dots on a light board.

    The board's own level is the grey closing over more than a dot; a dot lies below half of it.

    Parameters
    ----------
    lit : (h, w) float array
        White minus dark frame.
    """
    reduced = cv2.resize(lit.astype(np.float32), None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    size = max(3, reduced.shape[1] // _KERNEL_PART | 1)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    board = cv2.morphologyEx(reduced, cv2.MORPH_CLOSE, kernel)
    board = cv2.resize(board, lit.shape[::-1], interpolation=cv2.INTER_LINEAR)
    dark = (lit < 0.5 * board) & (board > _DARK_BACKGROUND * np.quantile(lit, 0.99))
    return elliptic_outlines(dark)


def elliptic_outlines(mask: NDArray[np.bool_]) -> list[Contour]:
    """Outer outlines of a mask's parts that are ellipses and do not touch the image's border."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    height, width = mask.shape
    found = []
    for contour in contours:
        area = cv2.contourArea(contour)
        u, v, w, h = cv2.boundingRect(contour)
        on_border = u == 0 or v == 0 or u + w == width or v + h == height
        if area < _LEAST_AREA_PX or len(contour) < 12 or on_border:
            continue
        (_, axes, _) = cv2.fitEllipse(contour)
        ellipse = np.pi * axes[0] * axes[1] / 4
        # An outline through pixel centres encloses half a pixel less all around.
        seen = area + len(contour) / 2
        if min(axes) > _LEAST_ASPECT * max(axes) and abs(seen - ellipse) < _ELLIPSE_AREA * ellipse + len(contour) / 2:
            found.append(np.asarray(contour, np.int32))
    return found
