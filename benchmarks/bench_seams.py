"""Centre lines of seams on painted textures: accuracy, completeness and time beside other line detectors.

python benchmarks/bench_seams.py [--images 12] [--peers PYTHON]

--peers names the Python of an environment with the extra "bench". Images are
1624 × 1234 with one or two seams 4 to 16 px wide, 12 to 55 grey levels dark, noise of 2 levels, unequal brightness on
both sides. Times are process times: `warm` of a second call on the same image.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from metrology.seams import detect_lines
from tests.support.seam_textures import Band, paint, random_bands

SHAPE = (1234, 1624)
# A point farther than this from every centre line belongs to none, px.
NEAR_PX = 3.0
PEERS = ("ridge-detector", "sato", "meijering")


def ours(image: np.ndarray) -> tuple[np.ndarray, float]:
    detect_lines(image)
    start = time.process_time()
    lines = detect_lines(image)
    seconds = time.process_time() - start
    return np.concatenate([line.centre_px for line in lines]) if lines else np.empty((0, 2)), seconds


def peer(python: str, name: str, image: np.ndarray) -> tuple[np.ndarray, float]:
    with tempfile.TemporaryDirectory() as folder:
        source, out = Path(folder) / "image.npy", Path(folder) / "found.npz"
        np.save(source, image)
        script = Path(__file__).with_name("seam_peers.py")
        subprocess.run([python, str(script), name, str(source), str(out)], check=True)
        found = np.load(out)
        return found["points"], float(found["seconds"])


def compare(points: np.ndarray, bands: Sequence[Band]) -> tuple[list[float], list[np.ndarray], list[float], float]:
    """RMS per seam, errors per seam, share of each seam found, and length of false lines over the true one."""
    offsets = np.array([np.abs(band.offsets(points)) for band in bands]).reshape(len(bands), -1)
    rms, errors, complete, length = [], [], [], 0.0
    for k, band in enumerate(bands):
        mine = points[(offsets[k] < NEAR_PX) & (offsets.argmin(axis=0) == k)]
        error = np.abs(band.offsets(mine))
        angle = np.deg2rad(band.angle_deg)
        t = np.arange(-1500.0, 1500.0)
        axis = np.array(band.through) + t[:, None] * (np.cos(angle), np.sin(angle))
        seen = np.all((axis >= 0) & (axis <= np.array(SHAPE[::-1]) - 1), axis=1)
        covered = np.zeros(len(t) + 1, bool)
        if len(mine):
            along = np.round(band.local(mine[:, 0], mine[:, 1])[0] + 1500).astype(int)
            covered[np.clip(along, 0, len(t))] = True
            # Points up to two pixels apart are one line.
            covered = np.convolve(covered, np.ones(3), "same") > 0
            rms.append(float(np.sqrt(np.mean(error**2))))
            errors.append(error)
        complete.append(float(covered[:-1][seen].mean()))
        length += float(seen.sum())
    return rms, errors, complete, float((offsets.min(axis=0) > NEAR_PX).sum()) / length


def report(name: str, results: list[tuple[np.ndarray, float]], truths: Sequence[Sequence[Band]]) -> float:
    """One line of the table; returns the median time."""
    compared = [compare(points, bands) for (points, _), bands in zip(results, truths, strict=True)]
    rms = [value for c in compared for value in c[0]]
    errors = [e for c in compared for e in c[1]]
    seconds = float(np.median([s for _, s in results]))
    print(
        f"| {name} | {np.mean([v for c in compared for v in c[2]]):.3f} | {np.mean([c[3] for c in compared]):.3f} | "
        f"{np.median(np.concatenate(errors)):.3f} | {np.median(rms):.3f} | {np.max(rms):.3f} | "
        f"{np.median([e.max() for e in errors]):.3f} | {seconds * 1e3:.0f} |",
        flush=True,
    )
    return seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=12)
    parser.add_argument("--peers", help="Python of an environment with the other detectors")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    truths, images = [], []
    for seed in range(arguments.images):
        generator = np.random.default_rng(seed)
        truths.append(random_bands(generator, SHAPE, 1 + seed % 2))
        images.append(paint(truths[-1], SHAPE, generator))
    print("| detector | complete | false | median error, px | median RMS, px | worst RMS, px | median worst, px | ms |")
    print("|---|---|---|---|---|---|---|---|")
    own = report("detect_lines", [ours(image) for image in images], truths)
    for name in PEERS if arguments.peers else ():
        seconds = report(name, [peer(arguments.peers, name, image) for image in images], truths)
        print(f"  {name}: {seconds / own:.0f} times our time")


if __name__ == "__main__":
    main()
