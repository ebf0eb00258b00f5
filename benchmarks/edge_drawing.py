"""OpenCV's EdgeDrawing ellipses on images from a file; needs opencv-contrib, so it runs in an environment of its own.

python edge_drawing.py IMAGES.npy ELLIPSES.npz

IMAGES.npy: (n, h, w) uint8. ELLIPSES.npz: one array (k, 5) of u, v, semi-axes, angle per image and pre-filter, and the
process time in seconds per image.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import cv2
import numpy as np


def difference_of_gaussians(image: np.ndarray) -> np.ndarray:
    """Band-passed to the width of a rim, about mid-grey."""
    grey = image.astype(np.float32)
    band = cv2.GaussianBlur(grey, (0, 0), 1.2) - cv2.GaussianBlur(grey, (0, 0), 4.0)
    return np.clip(128 + 8 * band, 0, 255).astype(np.uint8)


def hessian_ridge(image: np.ndarray) -> np.ndarray:
    """Larger eigenvalue of the Hessian at σ = 1.5: dark lines become bright ones."""
    grey = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.5)
    a, b, c = (cv2.Sobel(grey, cv2.CV_32F, *order, ksize=3) for order in ((2, 0), (1, 1), (0, 2)))
    value = 0.5 * (a + c) + np.sqrt(0.25 * (a - c) ** 2 + b * b)
    return np.clip(12 * value, 0, 255).astype(np.uint8)


FILTERS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "raw": lambda image: image,
    "DoG": difference_of_gaussians,
    "Hessian": hessian_ridge,
}


def ellipses(image: np.ndarray, threshold: int) -> np.ndarray:
    """(k, 5) u, v, semi-axes, angle (radians)."""
    detector = cv2.ximgproc.createEdgeDrawing()
    parameters = cv2.ximgproc.EdgeDrawing.Params()
    parameters.MinPathLength = 15
    parameters.PFmode = False
    parameters.NFAValidation = True
    parameters.GradientThresholdValue = threshold
    parameters.AnchorThresholdValue = 4
    parameters.Sigma = 1.0
    detector.setParams(parameters)
    detector.detectEdges(image)
    found = detector.detectEllipses()
    if found is None:
        return np.empty((0, 5))
    rows = np.asarray(found, float).reshape(-1, 6)
    # A circle has its radius in the third place and no axes.
    a = np.where(rows[:, 2] > 0, rows[:, 2], rows[:, 3])
    b = np.where(rows[:, 2] > 0, rows[:, 2], rows[:, 4])
    return np.column_stack([rows[:, 0], rows[:, 1], a, b, np.radians(rows[:, 5])])


def main() -> None:
    cv2.setNumThreads(1)
    images = np.load(sys.argv[1])
    results: dict[str, np.ndarray] = {}
    for name, prefilter in FILTERS.items():
        for threshold in (12, 20, 36):
            seconds = []
            for k, image in enumerate(images):
                start = time.process_time()
                results[f"{name}-{threshold}/{k}"] = ellipses(prefilter(image), threshold)
                seconds.append(time.process_time() - start)
            results[f"{name}-{threshold}/seconds"] = np.array(seconds)
    np.savez(sys.argv[2], **results)  # type: ignore[arg-type]


if __name__ == "__main__":
    main()
