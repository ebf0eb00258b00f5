"""Other line detectors, run in an environment of their own: python seam_peers.py DETECTOR IMAGE.npy OUT.npz

DETECTOR is ridge-detector (PyPI, Steger's method), sato or meijering (skimage's ridge filters, skeletonized).
OUT holds the line points found (u, v) and the process time.
"""

from __future__ import annotations

import sys
import time

import numpy as np

# Widths and contrasts of the seams in the benchmark's images, px and grey levels.
WIDTHS_PX = (5, 10, 15)
CONTRASTS = (6, 12)
LEAST_LENGTH_PX = 100


def ridge_detector(image: np.ndarray) -> np.ndarray:
    from ridge_detector import RidgeDetector

    detector = RidgeDetector(
        line_widths=np.array(WIDTHS_PX),
        low_contrast=CONTRASTS[0],
        high_contrast=CONTRASTS[1],
        min_len=LEAST_LENGTH_PX,
        dark_line=True,
        estimate_width=True,
        correct_pos=True,
    )
    detector.detect_lines(image)
    lines = [np.column_stack([line.col, line.row]) for line in detector.contours]
    return np.concatenate(lines) if lines else np.empty((0, 2))


def skeleton(image: np.ndarray, name: str) -> np.ndarray:
    from skimage import filters, morphology

    sigmas = [width / (2 * np.sqrt(3)) for width in WIDTHS_PX]
    strength = getattr(filters, name)(image.astype(float), sigmas=sigmas, black_ridges=True)
    threshold = filters.threshold_otsu(strength)
    kept = morphology.remove_small_objects(strength > threshold, max_size=LEAST_LENGTH_PX * min(WIDTHS_PX))
    v, u = np.nonzero(morphology.skeletonize(kept))
    return np.column_stack([u, v]).astype(float)


def main() -> None:
    name, image_path, out = sys.argv[1:]
    image = np.load(image_path).astype(np.uint8)

    def detect(part: np.ndarray) -> np.ndarray:
        return ridge_detector(part) if name == "ridge-detector" else skeleton(part, name)

    # Compiles and imports.
    detect(image[:200, :200])
    start = time.process_time()
    points = detect(image)
    np.savez(out, points=points, seconds=time.process_time() - start)


if __name__ == "__main__":
    main()
