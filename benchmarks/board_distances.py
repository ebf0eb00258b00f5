"""Distances on a board of known squares, from scans of it: what a rig's lengths are worth.

    python benchmarks/board_distances.py SCENE… --rig RIG --board 7x9:75 [--picture graycode_40.png]

Each corner is where its pixel's ray meets the plane through the board's points. Printed are the medians of neighbours'
distances and of the longest ones along rows and columns, against what the board says.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.cloud import Reconstruction
from metrology.one_camera import triangulate_one
from metrology.reconstruct import coordinate_size, decode, reconstruct
from metrology.rig import Rig
from metrology.robust import MAD
from storage.rig import load_rig
from storage.scene import load_scene

_ROUNDS = 5
_BAR = 0.002


def main() -> int:
    """Print a row for each scan; 1 where a longest distance is farther off than the bar."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--rig", type=Path, required=True)
    parser.add_argument("--board", required=True, help="inner corners and square: 7x9:75")
    parser.add_argument("--picture", help="in each scene's folder, that shows the board; by default the texture")
    options = parser.parse_args()
    size, square = options.board.split(":")
    columns, rows = (int(n) for n in size.split("x"))
    rig, worst = load_rig(options.rig), 0.0
    for folder in options.scenes:
        cloud = _cloud(folder, rig)
        texture = np.nan_to_num(cloud.left.texture)
        grey = np.clip(texture / np.quantile(texture, 0.999) * 255, 0, 255).astype(np.uint8)
        if options.picture:
            grey = cv2.imread(str(folder / options.picture), cv2.IMREAD_GRAYSCALE)
        corners, scatter = corner_points(cloud, grey, (columns, rows))
        lengths = {
            "neighbours": (1.0, [_lengths(corners, 1, 0), _lengths(corners, 0, 1)]),
            "longest rows": (columns - 1.0, [_lengths(corners, columns - 1, 0)]),
            "longest columns": (rows - 1.0, [_lengths(corners, 0, rows - 1)]),
        }
        said = []
        for name, (squares, found) in lengths.items():
            wanted = squares * float(square)
            values = np.concatenate(found)
            values = values[np.isfinite(values)]
            usual = float(np.median(values)) if values.size else np.nan
            off = usual / wanted - 1
            said.append(f"{name} {usual:.3f} of {wanted:g} mm ({off:+.2%}, n {values.size})")
            worst = max(worst, abs(off) if name != "neighbours" else 0.0)
        print(f"{folder.name}: {'; '.join(said)}; scatter about a plane {scatter:.3f} mm")
    return int(not worst <= _BAR)


def _cloud(folder: Path, rig: Rig) -> Reconstruction:
    scene = load_scene(folder)
    if rig.right is not None:
        return reconstruct(scene.frames("left"), scene.frames("right"), rig, scene.code, scene.exposures)
    size = coordinate_size(rig, scene.code)
    return triangulate_one(decode(scene.frames("left"), scene.code, size, scene.exposures), rig, scene.code, size)


def corner_points(cloud: Reconstruction, grey: NDArray, size: tuple[int, int]) -> tuple[Array, float]:
    """(rows, columns, 3) points of the board's inner corners, and how far the cloud scatters about its plane, mm."""
    found, pixels = cv2.findChessboardCorners(grey, size)
    if not found:
        raise SystemExit("found no board of that many corners in the picture")
    pixels = cv2.cornerSubPix(grey, pixels, (7, 7), (-1, -1), (3, 50, 1e-4)).reshape(size[1], size[0], 2)
    inside = np.zeros(grey.shape, np.uint8)
    outline = cv2.convexHull(pixels.reshape(-1, 2).astype(np.float32))
    cv2.fillConvexPoly(inside, np.rint(outline).astype(np.int32), 1)
    near = cloud.points[(inside > 0) & (cloud.flags == 0)].astype(float)
    for _ in range(_ROUNDS):
        middle = near.mean(0)
        normal = np.linalg.eigh(np.cov((near - middle).T))[1][:, 0]
        off = np.abs((near - middle) @ normal)
        near = near[off <= 3 * MAD * float(np.median(off))]
    rays = cloud.rig.left.rays(pixels.astype(float))
    return np.asarray(rays * ((normal @ middle) / (rays @ normal))[..., None]), MAD * float(np.median(off))


def _lengths(corners: Array, across: int, down: int) -> Array:
    rows, columns = corners.shape[:2]
    ends = corners[down:, across:], corners[: rows - down, : columns - across]
    return np.asarray(np.linalg.norm(ends[0] - ends[1], axis=-1).ravel())


if __name__ == "__main__":
    sys.exit(main())
