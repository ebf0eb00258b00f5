"""Ends, crossings and T joints of seams on painted textures: how far off they are found.

python benchmarks/seam_ends.py [--images 20]

Bands 4 to 16 px wide, 20 to 55 grey levels dark, noise of 2 levels; three images for each number.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.optimize import fsolve
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from metrology.seams import ImageLine, detect_lines
from tests.support.seam_textures import Band, paint

SHAPE = (900, 1200)


def ends(rng: np.random.Generator) -> list[float]:
    """Distances of a line's ends from the true ones."""
    through = tuple(rng.uniform((550, 400), (650, 500)))
    reach = (-rng.uniform(200, 330), rng.uniform(200, 330))
    band = Band(
        through, rng.uniform(0, 180), rng.uniform(4, 16), rng.uniform(20, 55), reach, rng.uniform(0, 4),
        rng.uniform(900, 1600), rng.uniform(-6, 6),
    )  # fmt: skip
    lines = detect_lines(paint([band], SHAPE, rng))
    if len(lines) != 1:
        return [np.nan, np.nan]
    return [float(np.linalg.norm(lines[0].centre_px[[0, -1]] - band.end(k), axis=1).min()) for k in (0, 1)]


def two_bands(rng: np.random.Generator) -> list[Band]:
    first = Band(
        (600, 450), rng.uniform(0, 180), rng.uniform(4, 16), rng.uniform(20, 55), bow_px=rng.uniform(0, 4),
        other_side=rng.uniform(-5, 5),
    )  # fmt: skip
    through = tuple(rng.uniform((550, 400), (650, 500)))
    second = Band(
        through, first.angle_deg + rng.uniform(40, 140), rng.uniform(4, 16), rng.uniform(20, 55),
        bow_px=rng.uniform(0, 4), other_side=rng.uniform(-5, 5),
    )  # fmt: skip
    return [first, second]


def crossing_of(bands: list[Band]) -> np.ndarray:
    return fsolve(lambda p: [float(band.offsets(p[None])[0]) for band in bands], [600, 450])


def intersection(a: ImageLine, b: ImageLine) -> np.ndarray:
    """Where two lines cross: straight pieces around the places nearest to each other."""
    distance, index = cKDTree(b.centre_px).query(a.centre_px)
    k = int(distance.argmin())
    p, q = a.centre_px[k - 3 : k + 4], b.centre_px[index[k] - 3 : index[k] + 4]
    along_a, along_b = p[-1] - p[0], q[-1] - q[0]
    s = np.linalg.solve(np.stack([along_a, -along_b], axis=1), q.mean(axis=0) - p.mean(axis=0))
    return p.mean(axis=0) + s[0] * along_a


def crossing(rng: np.random.Generator) -> list[float]:
    """Distance of two lines' crossing from the true one."""
    bands = two_bands(rng)
    lines = detect_lines(paint(bands, SHAPE, rng))
    if len(lines) != 2:
        return [np.nan]
    return [float(np.linalg.norm(intersection(*lines) - crossing_of(bands)))]


def joint(rng: np.random.Generator) -> list[float]:
    """How far a line that runs into another one ends from that one's border."""
    first, second = two_bands(rng)
    place = crossing_of([first, second])
    ending = Band(tuple(place), second.angle_deg, second.width_px, first.contrast, (0, 3000))
    lines = detect_lines(paint([first, ending], SHAPE, rng))
    if len(lines) != 2:
        return [np.nan]
    line = min(lines, key=lambda found: np.abs(ending.offsets(found.centre_px)).mean())
    return [float(abs(np.abs(first.offsets(line.centre_px[[0, -1]])).min() - 0.5 * first.width_px))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=20)
    arguments = parser.parse_args()
    for name, measure in (("ends", ends), ("crossings", crossing), ("T joints", joint)):
        errors = np.concatenate([measure(np.random.default_rng([3, k])) for k in range(arguments.images)])
        print(
            f"{name}: median {np.nanmedian(errors):.3f} px, greatest {np.nanmax(errors):.3f}, "
            f"{(errors < 0.15).sum()} of {len(errors)} within 0.15, {np.isnan(errors).sum()} not found",
            flush=True,
        )


if __name__ == "__main__":
    main()
