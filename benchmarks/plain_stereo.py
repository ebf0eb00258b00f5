"""Points of Flushline against those of a plain script: what anybody writes in an afternoon with numpy and OpenCV.

    python benchmarks/plain_stereo.py SCENE… --rig RIG [--truth DEPTHS.npy]

The plain script decodes by arc tangents, unwraps count by count (or by Gray code's stripes), rectifies with OpenCV,
finds equal coordinates along rows by linear interpolation, and triangulates. Printed are the shares of the left image
that have points, how far points scatter about a plane through their neighbours, and, for Flushline, how many of them
are flagged as beside an edge and what σ says of the others.
With the true depths of the left camera's pixels the errors are printed as well.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.gray import stripe_numbers
from metrology.reconstruct import reconstruct
from metrology.rig import Rig
from metrology.robust import MAD
from storage.rig import load_rig
from storage.scene import Scene, load_scene

_LEAST_MODULATION = 5.0 / 255  # of the range
_HALF = 4  # px: half-size of the window whose quadric neighbours are compared with
_LARGEST_JUMP = 4.0  # of the usual step of coordinates between pixels: beyond, a right row is torn


def main() -> int:
    """Print a table; 1 where the plain script has more points."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--rig", type=Path, required=True)
    parser.add_argument("--truth", type=Path, help="npy of (h, w) true depths, mm")
    options = parser.parse_args()
    rig, fewer = load_rig(options.rig), False
    truth = np.load(options.truth) if options.truth else None
    for folder in options.scenes:
        scene = load_scene(folder)
        ours = reconstruct(scene.frames("left"), scene.frames("right"), rig, scene.code, scene.exposures)
        depth = np.where(ours.flags == 0, ours.points[..., 2], np.nan).astype(float)
        plain = plain_depths(scene, rig)
        print(folder.name)
        print(f"  plain     points {np.isfinite(plain).mean():6.2%}, {describe(plain, None, truth)}")
        edges = ours.valid.mean() - np.isfinite(depth).mean()
        print(f"  Flushline points {ours.valid.mean():6.2%}, {edges:.2%} flagged as beside edges; of the others")
        print(f"            {describe(depth, ours.sigma_z, truth)}")
        fewer |= bool(ours.valid.sum() < np.isfinite(plain).sum())
    return int(fewer)


def describe(depth: Array, sigma: NDArray | None, truth: Array | None) -> str:
    """Scatter about neighbours, and errors."""
    off = scatter(depth)
    seen = np.isfinite(off)
    if not seen.any():
        return "no scatter, for want of neighbours"
    text = f"scatter {MAD * np.median(np.abs(off[seen])):.4f} mm"
    if sigma is not None:
        text += f", which is {MAD * np.median(np.abs(off[seen] / sigma[seen])):.2f} σ"
    if truth is not None:
        error = depth - truth
        error = error[np.isfinite(error)]
        text += f", error {np.median(error):+.4f} ± {MAD * np.median(np.abs(error - np.median(error))):.4f} mm"
        text += f", beyond 1 mm {np.mean(np.abs(error) > 1):.3%}"
        if sigma is not None:
            normal = ((depth - truth) / sigma)[np.isfinite(depth - truth)]
            text += f", {MAD * np.median(np.abs(normal - np.median(normal))):.2f} σ"
    return text


def scatter(depth: Array) -> Array:
    """Depths less a plane through the pixels around them, scaled to what single points scatter."""
    good = np.isfinite(depth).astype(float)
    side = 2 * _HALF + 1
    fill = np.nan_to_num(depth, nan=0.0) - np.nanmedian(depth) * good
    count = cv2.boxFilter(good, -1, (side, side), normalize=False)
    mean = cv2.boxFilter(fill, -1, (side, side), normalize=False) / np.maximum(count, 1)
    whole = count == side**2  # all neighbours are there: their mean lies on the plane, but for curvature
    second = cv2.Laplacian(np.where(whole, mean, np.nan), cv2.CV_64F, ksize=1)
    bent = (side**2 - 1) / 24 * second  # what a mean over the window gains by curvature
    off = np.where(whole, fill - mean + bent, np.nan)
    return np.asarray(off / np.sqrt(1 - 1 / side**2))


def plain_depths(scene: Scene, rig: Rig) -> Array:
    """(h, w) depths at the left camera's raw pixels, NaN where there is none."""
    left, right = rig.left, rig.with_right()
    size = (left.width, left.height)
    wide = (2 * size[0], 2 * size[1])  # so that nothing is cut off
    R1, R2, P1, P2, *_ = cv2.stereoRectify(
        left.K,
        left.lens,
        right.K,
        right.lens,
        size,
        right.R,
        right.t[:, None],
        alpha=1,
        newImageSize=wide,
    )
    maps = [
        cv2.initUndistortRectifyMap(device.K, device.lens, R, P, wide, cv2.CV_32FC1)
        for device, R, P in ((left, R1, P1), (right, R2, P2))
    ]
    views = []
    for camera, (along, down) in zip(("left", "right"), maps, strict=True):
        coordinate = plain_coordinate(scene.frames(camera)[len(scene.exposures) // 2], scene)
        views.append(cv2.remap(coordinate.astype(np.float32), along, down, cv2.INTER_LINEAR, borderValue=np.nan))
    upright = abs(P2[1, 3]) > abs(P2[0, 3])
    one, other = (view.T if upright else view for view in views)
    disparity = _disparities(one, other)
    disparity = disparity.T if upright else disparity
    depth = abs(P2[int(upright), 3]) / np.abs(disparity + (P1 - P2)[int(upright), 2])
    v, u = np.mgrid[: wide[1], : wide[0]].astype(float)
    rectified = np.stack([(u - P1[0, 2]) / P1[0, 0], (v - P1[1, 2]) / P1[1, 1], np.ones_like(u)], -1) * depth[..., None]
    raw = rectified @ R1  # Rᵀ x: back into the camera's own frame
    # To raw pixels: where each of them lies in the rectified picture.
    v, u = np.mgrid[: left.height, : left.width].astype(float)
    pixels = np.stack([u, v], -1).reshape(-1, 1, 2)
    at = cv2.undistortPoints(pixels, left.K, left.lens, R=R1, P=P1).reshape(*u.shape, 2).astype(np.float32)
    return np.asarray(cv2.remap(raw[..., 2].astype(np.float32), at, None, cv2.INTER_LINEAR, borderValue=np.nan), float)


def plain_coordinate(frames: NDArray, scene: Scene) -> Array:
    """(h, w) shares of the projector by arc tangents, unwrapped from the coarsest count or Gray code on."""
    code = scene.code
    levels = frames.astype(float)
    full = 2 ** np.ceil(np.log2(float(frames.max()) + 1)) - 1
    good = (levels.max(0) < full) & (levels.max(0) - levels.min(0) > 2 * _LEAST_MODULATION * full)
    shares: Array | None = None
    if code.gray:
        stripes = levels[code.fringe_frames : code.fringe_frames + code.gray.stripe_frames]
        middle = levels[: code.fringe_frames].mean(0) if code.counts else 0.5 * (stripes.max(0) + stripes.min(0))
        bits = stripes[::2] > stripes[1::2] if code.gray.inverse else stripes > middle
        shares = (stripe_numbers(bits) + 0.5 + code.gray.shift) / code.gray.stripes
    wrapped = {}
    for k, steps in enumerate(code.step_counts):
        own = code.count_of == k
        phasor = np.tensordot(np.exp(-1j * code.step_angles[own]), levels[: code.fringe_frames][own], 1) * 2 / steps
        wrapped[code.counts[k]] = np.angle(phasor) / (2 * np.pi) - code.offset_turns[k]
        good &= np.abs(phasor) > _LEAST_MODULATION * full
    if code.counts and shares is None:
        counts = sorted(code.counts)
        if counts[0] == 1:
            shares, counts = wrapped[1] % 1, counts[1:]
        else:
            shares = _tried(wrapped)
    else:
        counts = sorted(code.counts)
    assert shares is not None
    for count in counts:
        shares = (wrapped[count] + np.rint(shares * count - wrapped[count])) / count
    return np.where(good, shares, np.nan)


def _tried(wrapped: dict[int, Array]) -> Array:
    """Shares by the order of the coarsest count that leaves the others nearest to whole orders."""
    coarsest, *others = sorted(wrapped)
    best, least = np.full(wrapped[coarsest].shape, np.nan), np.full(wrapped[coarsest].shape, np.inf)
    for order in range(coarsest + 1):
        share = (wrapped[coarsest] + order) / coarsest
        miss = sum(_fraction(share * count - wrapped[count]) ** 2 for count in others)
        better = (miss < least) & (share >= 0) & (share <= 1)
        best[better], least[better] = share[better], miss[better]
    return best


def _fraction(turns: Array) -> Array:
    return np.asarray(turns - np.rint(turns))


def _disparities(left: NDArray, right: NDArray) -> Array:
    """(h, w) columns of the left picture less those of equal coordinate in the right one."""
    found = np.full(left.shape, np.nan)
    columns = np.arange(left.shape[1], dtype=float)
    for row, (one, other) in enumerate(zip(left.astype(float), right.astype(float), strict=True)):
        seen = np.flatnonzero(np.isfinite(other))
        if len(seen) < 2:
            continue
        order = seen[np.argsort(other[seen], kind="stable")]
        values = other[order]
        at = np.interp(one, values, columns[order], left=np.nan, right=np.nan)
        place = np.clip(np.searchsorted(values, np.nan_to_num(one)), 1, len(values) - 1)
        torn = np.abs(columns[order][place] - columns[order][place - 1]) > 2
        torn |= values[place] - values[place - 1] > _LARGEST_JUMP * np.median(np.diff(values))
        found[row] = np.where(torn, np.nan, columns - at)
    return found


if __name__ == "__main__":
    sys.exit(main())
