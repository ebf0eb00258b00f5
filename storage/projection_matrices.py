"""Cameras by their 3×4 projection matrices P = K [R | t], as photogrammetry and direct linear transforms give them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from metrology.arrays import Array
from storage.calibration_documents import numbers
from storage.calibration_names import side_of_file

_LEAST_DETERMINANT = 1e-12
_NO_SKEW = 1e-4  # of the focal length: what rounding of printed numbers leaves


def from_projections(values: Mapping[str, Any], first: int, file_side: int | None = None) -> dict[str, Array]:
    """M, D, and each camera's pose, of every 3×4 matrix whose name tells its camera; images are taken as undistorted.

    Parameters
    ----------
    values : mapping
        Flat names to values.
    first : int
        The number of the left camera in names: 0 or 1.
    file_side : 1 or 2, optional
        The camera that the file as a whole is of, for names that tell none.
    """
    found: dict[str, Array] = {}
    for name, value in values.items():
        matrix = numbers(value)
        side = _side(name, first) or (file_side if re.search("(?i)proj|^P$", name) else None)
        if side is None or matrix is None or matrix.shape not in ((3, 4), (12,), (1, 12)):
            continue
        taken = _taken_apart(matrix.reshape(3, 4))
        if taken is not None:
            names = (f"M{side}", f"posedR{side}", f"posedT{side}")
            found |= dict(zip(names, taken, strict=True)) | {f"D{side}": np.zeros((1, 5))}
        if name.endswith("projection_matrix"):  # of ROS, in metres
            found["unit"] = np.array(1000.0)
    return found


def _side(name: str, first: int) -> int | None:
    """1 or 2: by a word or letter, a camera's number, or the last number, of which 1 is left."""
    if (side := side_of_file([name], first)) is not None:
        return side if side < 3 else None
    spelled = re.search(r"(left|right|(?<=[a-z])[LR](?![a-z]))", name)
    if spelled:
        return 1 if spelled[1].lower().startswith("l") else 2
    numbered = re.fullmatch(r"(?:.*?[^a-z])?(?:p|proj|projection|cam|camera|c|m)[a-z_]*?_?([12])", name, re.I)
    return int(numbered[1]) if numbered else None


def _taken_apart(P: Array) -> tuple[Array, Array, Array] | None:
    """K, R, t; None where the left part has no inverse."""
    scale = np.linalg.norm(P[2, :3])
    if not np.isfinite(P).all() or scale < _LEAST_DETERMINANT or abs(np.linalg.det(P[:, :3] / scale)) < 1e-9:
        return None
    P = P / scale * np.sign(np.linalg.det(P[:, :3]))
    flip = np.eye(3)[::-1]
    Q, upper = np.linalg.qr((flip @ P[:, :3]).T)
    K, R = flip @ upper.T @ flip, flip @ Q.T
    signs = np.diag(np.sign(np.diag(K)))
    K, R = K @ signs, signs @ R
    t = np.linalg.solve(K, P[:, 3])
    K /= K[2, 2]
    if abs(K[0, 1]) < _NO_SKEW * K[0, 0]:
        K[0, 1] = 0.0
    return K, R, t
