"""Rivet detection on painted textures, by contrast of the rim, beside OpenCV's ellipse detectors; and times.

python benchmarks/bench_rivets.py [--images 40] [--contrib PYTHON] [--scene FOLDER]

--contrib names the Python of an environment that has opencv-contrib (for EdgeDrawing); --scene a scan with truth.json,
beside its rig.json, on which detection and measurement are timed. Times are of one core (process time), beside ten
Gaussian blurs of the same image.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from metrology.rivets import detect_ellipses, detect_rivets, measure_rivets
from tests.support.painted_texture import paint_texture
from tests.support.reference_scans import reference_scan
from tests.support.texture_spec import RimTruth, Texture, TextureSpec

RADII = (8.0, 46.0)  # px, looked for by all
CLASSES = ((2.5, 4), (4, 6), (6, 8), (8, 15), (15, 31))


def blur_seconds(image: np.ndarray) -> float:
    """The yardstick: ten Gaussian blurs of σ = 8."""
    start = time.process_time()
    for _ in range(10):
        cv2.GaussianBlur(image, (0, 0), 8)
    return time.process_time() - start


def match(found: np.ndarray, rims: Sequence[RimTruth]) -> tuple[np.ndarray, int]:
    """Per rim the index of the ellipse found for it (−1: none), and how many ellipses are none's."""
    taken: set[int] = set()
    pairs = np.full(len(rims), -1)
    for i, rim in enumerate(rims):
        distance = np.hypot(found[:, 0] - rim.u, found[:, 1] - rim.v) if len(found) else np.empty(0)
        size = np.abs(np.sqrt(found[:, 2] * found[:, 3]) - np.sqrt(rim.a * rim.b)) if len(found) else np.empty(0)
        good = [k for k in np.argsort(distance) if k not in taken]
        good = [k for k in good if distance[k] < 0.25 * rim.a and size[k] < 0.15 * rim.a + 2.5]
        if good:
            pairs[i] = good[0]
            taken.add(int(good[0]))
    # EdgeDrawing often returns both sides of a ring: the second one is no false rivet.
    near = [
        any(np.hypot(f[0] - r.u, f[1] - r.v) < 0.3 * r.a for r in rims) for k, f in enumerate(found) if k not in taken
    ]
    return pairs, len(near) - sum(near)


def plausible(found: np.ndarray) -> np.ndarray:
    """Those of the sizes looked for and not flatter than 1 : 2."""
    a, b = np.maximum(found[:, 2], found[:, 3]), np.minimum(found[:, 2], found[:, 3])
    radius = np.sqrt(a * b)
    return found[(radius >= RADII[0]) & (radius <= RADII[1]) & (b > 0.5 * a)]


def report(name: str, found: list[np.ndarray], textures: Sequence[Texture], seconds: float, blur: float) -> float:
    """One line of the table; returns the F measure."""
    rims = [r for t in textures for r in t.rims]
    contrast = np.abs([r.contrast for r in rims])
    errors, biases, false = [], [], 0
    for all_ellipses, texture in zip(found, textures, strict=True):
        ellipses = plausible(all_ellipses)
        pairs, extra = match(ellipses, texture.rims)
        false += extra
        for rim, k in zip(texture.rims, pairs, strict=True):
            errors.append(np.hypot(ellipses[k, 0] - rim.u, ellipses[k, 1] - rim.v) if k >= 0 else np.nan)
            biases.append(ellipses[k, 2] + ellipses[k, 3] - rim.a - rim.b if k >= 0 else np.nan)
    error, hit = np.array(errors), np.isfinite(errors)
    recall, precision = hit.mean(), hit.sum() / max(hit.sum() + false, 1)
    cells = []
    for low, high in CLASSES:
        k = (contrast >= low) & (contrast < high)
        median = np.nanmedian(error[k]) if hit[k].any() else np.nan
        cells.append(f"{hit[k].mean():.3f} {median:.3f}")
    print(
        f"{name:22s} {recall:.3f} {precision:.4f} | " + " | ".join(cells) + f" | {np.nanmedian(biases):+.3f} | "
        f"{seconds * 1e3:5.0f} ms = {seconds / blur:.2f} blurs",
        flush=True,
    )
    return float(2 * recall * precision / max(recall + precision, 1e-9))


def timed(detect: Callable[[np.ndarray], np.ndarray], textures: Sequence[Texture]) -> tuple[list[np.ndarray], float]:
    found, seconds = [], []
    for texture in textures:
        start = time.process_time()
        found.append(detect(texture.image))
        seconds.append(time.process_time() - start)
    return found, float(np.median(seconds))


def ours(image: np.ndarray) -> np.ndarray:
    rings = detect_ellipses(image.astype(np.float32), radii=RADII)
    return np.array([r.ellipse.parameters for r in rings]).reshape(-1, 5)


def hough(image: np.ndarray) -> np.ndarray:
    """HoughCircles in its gradient-pair variant, on a band-passed image."""
    grey = image.astype(np.float32)
    band = cv2.GaussianBlur(grey, (0, 0), 1.2) - cv2.GaussianBlur(grey, (0, 0), 4.0)
    levels = np.clip(128 + 8 * band, 0, 255).astype(np.uint8)
    found = cv2.HoughCircles(levels, cv2.HOUGH_GRADIENT_ALT, 1.5, 15, param1=200, param2=0.6, minRadius=8, maxRadius=45)
    if found is None:
        return np.empty((0, 5))
    u, v, r = found.reshape(-1, found.shape[-1])[:, :3].T
    return np.column_stack([u, v, r, r, np.zeros_like(r)])


def edge_drawing(python: str, textures: Sequence[Texture]) -> dict[str, tuple[list[np.ndarray], float]]:
    """Ellipses of each variant and the median seconds per image, from the other environment."""
    script = Path(__file__).with_name("edge_drawing.py")
    with tempfile.TemporaryDirectory() as folder:
        images, results = Path(folder) / "images.npy", Path(folder) / "ellipses.npz"
        np.save(images, np.stack([t.image for t in textures]))
        subprocess.run([python, str(script), str(images), str(results)], check=True)
        with np.load(results) as data:
            variants = sorted({key.split("/")[0] for key in data.files})
            return {
                v: (
                    [data[f"{v}/{k}"] for k in range(len(textures))],
                    float(np.median(data[f"{v}/seconds"])),
                )
                for v in variants
            }


def time_scene(folder: Path) -> None:
    """Detection and measurement of a scan's rivets against the yardstick, medians of five."""
    reconstruction, truth = reference_scan(folder)
    detections = detect_rivets(reconstruction)
    measure_rivets(detections, reconstruction)
    ratios = []
    for _ in range(5):
        blur = blur_seconds(reconstruction.left.texture)
        start = time.process_time()
        detections = detect_rivets(reconstruction)
        middle = time.process_time()
        measure_rivets(detections, reconstruction)
        ratios.append(((middle - start) / blur, (time.process_time() - middle) / blur))
    detect, measure = np.median(ratios, axis=0)
    print(
        f"{folder.name}: {len(detections)} of {len(truth['rivets'])} rivets; "
        f"detection {detect:.2f}, measurement {measure:.2f} times ten blurs"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--images", type=int, default=40)
    parser.add_argument("--contrib", metavar="PYTHON")
    parser.add_argument("--scene", type=Path)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    spec = TextureSpec(contrast=(2.5, 30))
    textures = [paint_texture(spec, np.random.default_rng(1000 + k)) for k in range(arguments.images)]
    blur = float(np.median([blur_seconds(textures[0].image.astype(np.float32)) for _ in range(5)]))
    ours(textures[0].image)  # compiles
    print(f"{sum(len(t.rims) for t in textures)} rims in {len(textures)} images; ten blurs {blur * 1e3:.0f} ms")
    print("detector               recall precision | recall and median error (px) at " + " | ".join(map(str, CLASSES)))
    report("Flushline", *_with(timed(ours, textures), textures, blur))
    report("HoughCircles ALT, DoG", *_with(timed(hough, textures), textures, blur))
    if arguments.contrib:
        for name, result in edge_drawing(arguments.contrib, textures).items():
            report(f"EdgeDrawing {name}", *_with(result, textures, blur))
    if arguments.scene:
        time_scene(arguments.scene)


def _with(
    result: tuple[list[np.ndarray], float], textures: Sequence[Texture], blur: float
) -> tuple[list[np.ndarray], Sequence[Texture], float, float]:
    return result[0], textures, result[1], blur


if __name__ == "__main__":
    main()
