"""Centre lines on synthetic bars: accuracy and time of `detect_lines`, beside skimage's sato filter where installed.

python benchmarks/bench_seams.py
"""

from __future__ import annotations

import time

import numpy as np
from scipy.special import erf

from metrology.seams import detect_lines

WIDTH, HEIGHT = 1624, 1234


def bar_image(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """An image with one dark bar in a random direction, and the bar's signed distance from each pixel."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    angle, width = rng.uniform(0, np.pi), rng.uniform(5, 15)
    distance = -(u - WIDTH / 2) * np.sin(angle) + (v - HEIGHT / 2) * np.cos(angle) - rng.uniform(-80, 80)
    bar = 0.5 * (erf((distance + width / 2) / 0.9) - erf((distance - width / 2) / 0.9))
    skin = np.where(distance < 0, 1.0, 1.0 + rng.uniform(-0.06, 0.06)) * 120
    return skin * (1 - bar) + 70 * bar + rng.normal(0, 2, skin.shape), distance


def rms(points: np.ndarray, distance: np.ndarray) -> float:
    """RMS distance of points (n, 2) from the bar's centre line."""
    u, v = np.round(points).astype(int).T
    slope_v, slope_u = (np.median(slope) for slope in np.gradient(distance))
    offset = distance[v, u] + slope_u * (points[:, 0] - u) + slope_v * (points[:, 1] - v)
    return float(np.sqrt(np.mean(offset**2)))


def main() -> None:
    detect_lines(bar_image(0)[0])  # compiles
    for seed in range(1, 7):
        image, distance = bar_image(seed)
        start = time.process_time()
        lines = detect_lines(image)
        seconds = time.process_time() - start
        print(
            f"seed {seed}: {len(lines)} line(s), RMS {rms(lines[0].centre_px, distance):.3f} px, {seconds * 1e3:.0f} ms"
        )
        sato(image, distance)


def sato(image: np.ndarray, distance: np.ndarray) -> None:
    """The same with skimage, if it is installed."""
    try:
        from skimage.filters import sato as ridge_filter
        from skimage.morphology import skeletonize
    except ImportError:
        return
    start = time.process_time()
    strength = ridge_filter(image, sigmas=(2, 4, 6))
    v, u = np.nonzero(skeletonize(strength > 0.5 * strength.max()))
    points = np.stack([u, v], axis=-1).astype(float)
    print(f"    skimage: RMS {rms(points, distance):.3f} px, {(time.process_time() - start) * 1e3:.0f} ms")


if __name__ == "__main__":
    main()
