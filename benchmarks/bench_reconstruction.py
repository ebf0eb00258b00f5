"""Speed, memory and order slips of reconstruction, as ratios measured in one run on one machine.

    python benchmarks/bench_reconstruction.py [--slip-pixels 100000000]

Compares decoding one camera (12 frames of 1234×1624, 8 bits) with the same in plain numpy (float64) and, where it is
installed, with the PyPI package `fringes`; and the way from both cameras' arrays to the organised cloud with copying
the 24 frames ten times. CPU times unless said otherwise, the best of several runs.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from metrology.decode import decode_phase
from metrology.reconstruct import reconstruct
from metrology.reconstruction_settings import ReconstructionSettings
from metrology.rig import Device, Rig
from tests.support.rendered_fringes import USUAL, clean_frames, plane_scan, ramp, small_rig

HEIGHT, WIDTH, SIZE = 1234, 1624, 1280
ONE_THREAD = ReconstructionSettings(threads=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--slip-pixels", type=float, default=1e7, help="pixels to look for order slips in")
    parser.add_argument("--cloud-of", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.cloud_of:
        reconstruct_saved(arguments.cloud_of)
        return
    rng = np.random.default_rng(1)
    compare_decoding(rng)
    compare_cloud(rng)
    for modulation in (30.0, 20.0):
        count_slips(modulation, int(arguments.slip_pixels), rng)


def cpu_ms(function: Callable[[], object], repeats: int) -> float:
    """Least CPU time of several calls, after one that warms up."""
    function()
    best = np.inf
    for _ in range(repeats):
        start = time.process_time()
        function()
        best = min(best, time.process_time() - start)
    return 1e3 * best


def compare_decoding(rng: np.random.Generator) -> None:
    truth = ramp(HEIGHT, WIDTH, SIZE)
    frames = noisy(clean(truth, 80.0), rng)
    ours = cpu_ms(lambda: decode_phase(frames, USUAL, SIZE, settings=ONE_THREAD), 15)
    plain = cpu_ms(lambda: plain_numpy(frames[0]), 5)
    print(f"decode, one camera: {ours:.1f} ms CPU, noise estimate included")
    print(f"  plain numpy float64: {plain:.0f} ms, ratio {plain / ours:.1f} (bar 25)")
    faint = noisy(clean(truth, 20.0), rng)
    view = decode_phase(faint, USUAL, SIZE)
    print(f"  order slips at B = 20, σ = 2: {slip_share(view.coordinate, truth):.2e}")
    compare_with_fringes(faint, truth, ours)


def compare_with_fringes(frames: NDArray[np.uint8], truth: NDArray, ours: float) -> None:
    try:
        from fringes import Fringes
    except ImportError:
        print("  PyPI fringes: not installed (pip install fringes)")
        return
    other = Fringes()
    other.X, other.Y, other.D, other.K, other.N, other.v = SIZE, 800, 1, 3, [[4, 4, 4]], [list(USUAL.counts)]
    other.p0 = 0.0
    # It shifts the other way.
    order = [4 * k + i for k in range(3) for i in (0, 3, 2, 1)]
    stack = np.ascontiguousarray(frames[0][order])[..., None]
    decoded = np.squeeze(other.decode(stack)[2])
    took = cpu_ms(lambda: other.decode(stack), 1)
    print(f"  PyPI fringes: {took:.0f} ms, ratio {took / ours:.0f} (bar 100), slips {slip_share(decoded, truth):.2e}")


def compare_cloud(rng: np.random.Generator) -> None:
    rig = full_rig()
    left, right = plane_scan(rig, USUAL, rng)
    both = np.stack([left, right])

    def copy_ten_times() -> None:
        for _ in range(10):
            both.copy()

    cloud = cpu_ms(lambda: reconstruct(left, right, rig, USUAL, settings=ONE_THREAD), 9)
    copying = cpu_ms(copy_ten_times, 9)
    print(f"arrays → cloud, CPU: {cloud:.0f} ms, copying {copying:.0f} ms, ratio {cloud / copying:.1f}")
    cloud, copying = wall_ms(lambda: reconstruct(left, right, rig, USUAL), 9), wall_ms(copy_ten_times, 9)
    print(f"  by the clock, all threads: {cloud:.0f} ms, copying {copying:.0f} ms, ratio {cloud / copying:.1f} (bar 3)")
    with tempfile.TemporaryDirectory() as folder:
        np.save(Path(folder) / "both.npy", both)
        command = [sys.executable, __file__, "--cloud-of", folder]
        print(subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip())


def reconstruct_saved(folder: Path) -> None:
    """In a process of its own: reconstruct saved frames and say the peak memory."""
    left, right = np.load(folder / "both.npy")
    reconstruct(left, right, full_rig(), USUAL)
    status = Path("/proc/self/status").read_text().splitlines()
    peak = next(int(line.split()[1]) for line in status if line.startswith("VmHWM")) / 1024
    print(f"peak memory of a process that reconstructs, frames and libraries included: {peak:.0f} MB (bar 600)")


def wall_ms(function: Callable[[], object], repeats: int) -> float:
    """Least time by the clock of several calls."""
    best = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        best = min(best, time.perf_counter() - start)
    return 1e3 * best


def count_slips(modulation: float, pixels: int, rng: np.random.Generator) -> None:
    slips = seen = missing = 0
    truth = ramp(1000, 2000, SIZE)
    levels = clean(truth, modulation)
    while seen < pixels:
        view = decode_phase(noisy(levels, rng), USUAL, SIZE)
        slips += int((np.abs(view.coordinate - truth) > SIZE / 140).sum())
        missing += int(np.isnan(view.coordinate).sum())
        seen += truth.size
    print(f"order slips at B = {modulation:.0f}, σ = 2: {slips} of {seen:.0e} pixels, {missing / seen:.2%} flagged")


def clean(truth: NDArray, modulation: float) -> NDArray[np.float32]:
    return clean_frames(truth, USUAL, SIZE, 110.0, modulation).astype(np.float32)


def noisy(levels: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.uint8]:
    """(1, frames, h, w) with a noise of two grey levels."""
    frames = levels + 2.0 * rng.standard_normal(levels.shape, np.float32)
    return np.clip(np.rint(frames, out=frames), 0, 255, out=frames).astype(np.uint8)[None]


def slip_share(coordinate: NDArray, truth: NDArray) -> float:
    """Share of pixels more than half a fringe off, among those with a value."""
    error = np.abs(coordinate - truth)
    return float((error[np.isfinite(error)] > SIZE / 140).mean())


def plain_numpy(frames: NDArray[np.uint8]) -> tuple[NDArray, ...]:
    """Three-frequency heterodyne as one would write it: coordinate, σ, modulation, texture, flags."""
    counts, phases, amplitudes, texture = USUAL.counts, [], [], 0.0
    for k in range(3):
        i1, i2, i3, i4 = (frames[4 * k + i].astype(np.float64) for i in range(4))
        s, c = i4 - i2, i1 - i3
        phases.append(np.arctan2(s, c) / (2 * np.pi) % 1.0)
        amplitudes.append(0.5 * np.sqrt(s * s + c * c))
        texture = texture + i1 + i2 + i3 + i4
    texture = texture / 12
    d12, d23 = (phases[0] - phases[1]) % 1.0, (phases[1] - phases[2]) % 1.0
    beat = counts[0] - counts[1]
    coarse = (d12 + np.rint(beat * ((d12 - d23) % 1.0) - d12)) / beat
    coarse = (phases[0] + np.rint(counts[0] * coarse - phases[0])) / counts[0]
    unwrapped = [q + np.rint(n * coarse - q) for q, n in zip(phases, counts, strict=True)]
    weights = [n * n * b * b for n, b in zip(counts, amplitudes, strict=True)]
    total = sum(weights)
    position = sum(w * q / n for w, q, n in zip(weights, unwrapped, counts, strict=True)) / total
    misfit = np.maximum.reduce([np.abs(q - n * position) for q, n in zip(unwrapped, counts, strict=True)])
    modulation = np.sqrt(sum(b * b for b in amplitudes) / 3)
    flags = np.where(frames.max(0) >= 254, 1, 0) | np.where(modulation < 8, 2, 0) | np.where(misfit > 0.04, 4, 0)
    sigma = SIZE / (2 * np.pi) * np.sqrt(0.5 * (1.0 + 0.02 * texture) / total)
    coordinate = np.where(flags == 0, position * SIZE - 0.5, np.nan)
    return coordinate, sigma, modulation, texture, flags.astype(np.uint16)


def full_rig() -> Rig:
    """The tests' small rig with cameras of 1624×1234 pixels and a projector of 1280×800."""
    small = small_rig()

    def enlarge(device: Device, width: int, height: int, focal: float) -> Device:
        K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        return Device(width, height, K, device.distortion, device.R, device.t)

    return Rig(
        "full",
        small.calibrated_at,
        enlarge(small.left, WIDTH, HEIGHT, 3640.0),
        enlarge(small.right, WIDTH, HEIGHT, 3640.0),
        enlarge(small.projector, SIZE, 800, 2560.0),
    )


if __name__ == "__main__":
    main()
