"""Clouds for other programs: PLY and PCD through Open3D, which is imported only here (it takes seconds)."""

from __future__ import annotations

import ctypes
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from metrology.errors import StoreError
from storage.cloud import StoredCloud


def write_point_cloud(path: Path, cloud: StoredCloud, texture: NDArray[np.uint8]) -> int:
    """Write the points (mm, grey as the left camera saw them) as PLY or PCD (binary), by the ending of the name.

    Parameters
    ----------
    texture : (h, w) uint8

    Returns
    -------
    int
        Number of points written.
    """
    open3d = load_open3d()
    valid = np.isfinite(cloud.points[..., 2])
    points = open3d.t.geometry.PointCloud(cloud.points[valid])
    points.point.colors = np.repeat(texture[valid][:, None], 3, axis=1)
    if not open3d.t.io.write_point_cloud(str(path), points):
        raise StoreError(f"{path}: found it not writable, expected a place for a cloud")
    return int(valid.sum())


def load_open3d() -> ModuleType:
    """Open3D with the libusb that it needs."""
    import libusb_package

    library = libusb_package.get_library_path()
    if library:
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
    try:
        import open3d
    except (ImportError, OSError) as problem:
        raise StoreError(
            f"open3d: found {problem}, expected the system's OpenGL libraries (Debian: libgl1 libegl1 libx11-6)"
        ) from None
    return open3d
