"""Pictures of a printed board, as anybody takes them with two cameras."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np


def chessboard_pictures(folder: Path, truth_distance: float, suffix: str = "jpg") -> None:
    """Coloured pairs of a chessboard of 9 × 6 corners, 25 mm, seen by two pinhole cameras; a lamp beside it."""
    K = np.array([[900.0, 0, 400], [0, 900.0, 300], [0, 0, 1]])
    tall, wide, px = 7 * 25, 10 * 25, 8
    y, x = np.mgrid[: tall * px, : wide * px] // (25 * px)
    printed = np.pad(np.where((x + y) % 2 == 0, 30, 200).astype(np.uint8), 25 * px, constant_values=200)
    tilts = ((0, 15, 3), (20, 0, -8), (-20, 15, 12), (15, -25, 5), (-15, -12, -12), (5, 25, 10), (25, 10, 0))
    for pose, tilt in enumerate(tilts):
        R = cv2.Rodrigues(np.radians(np.array(tilt, float)))[0]
        middle = np.array([20.0 * (pose % 3 - 1), 10.0 * (pose % 2), 620.0 + 20 * pose])
        t = middle - R @ np.array([wide / 2 + 25, tall / 2 + 25, 0])
        for camera, shift, yaw in (("left", 0.0, 0.0), ("right", truth_distance, -12.0)):
            turned = cv2.Rodrigues(np.radians([0, yaw, 0.0]))[0].T
            view = turned @ np.column_stack([R[:, 0], R[:, 1], t - [shift, 0, 0]])
            to_mm = np.array([[1 / px, 0, 0.5 / px], [0, 1 / px, 0.5 / px], [0, 0, 1]])
            size = (3 * 800, 3 * 600)  # drawn three times as large: smooth edges
            finer = np.array([[3.0, 0, 1], [0, 3.0, 1], [0, 0, 1]])
            drawn = cv2.warpPerspective(printed, finer @ K @ view @ to_mm, size, borderValue=90)
            picture = cv2.resize(drawn, (800, 600), interpolation=cv2.INTER_AREA)
            picture[:90, :140] = 255  # a lamp: 2.6 % of the picture, nothing of the board
            path = folder / f"{camera}_{pose}.{suffix}"
            quality = [cv2.IMWRITE_JPEG_QUALITY, 98] if suffix == "jpg" else []
            cv2.imwrite(str(path), cv2.merge([picture] * 3), quality)
