"""One camera's fringe frames to a DecodedView."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from metrology.cloud import DecodedView
from metrology.errors import SceneError
from metrology.fringe import FringeCode
from metrology.jit import over_rows
from metrology.noise import NoiseModel, estimate_noise
from metrology.phase import decode_rows
from metrology.reconstruction_settings import ReconstructionSettings
from metrology.unwrap import OrderLattice, heterodyne_beats, order_lattice

# A contradiction between the phases is one that noise explains in 1 of 1e6 pixels and that exceeds this share of the
# way to the next lattice point's cell; beyond the second share the order is a toss-up whatever the noise.
_NOISE_EXPLAINS = 1e-6
_SHARES_OF_CELL = (0.5, 0.9)


def decode_phase(
    frames: NDArray,
    code: FringeCode,
    projector_size: int,
    exposures: Sequence[float] = (1.0,),
    settings: ReconstructionSettings | None = None,
    noise: NoiseModel | None = None,
) -> DecodedView:
    """Projector coordinate, its standard deviation, modulation, texture and flags, pixel by pixel.

    Parameters
    ----------
    frames : (exposures, code.frames, h, w) ndarray of uint8 or uint16
        Count-major, then step.
    code : FringeCode
    projector_size : int
        Projector pixels along the fringe axis.
    exposures : sequence of float
        Exposure times relative to exposure 1.
    settings : ReconstructionSettings, optional
    noise : NoiseModel, optional
        The camera's noise; estimated from the frames by default.
    """
    settings = settings or ReconstructionSettings()
    _check(frames, code, exposures)
    saturation = saturation_level(frames, settings)
    noise = noise or estimate_noise(frames, code, saturation)
    height, width = frames.shape[2:]
    view = DecodedView(
        coordinate=np.empty((height, width), np.float32),
        sigma=np.empty((height, width), np.float32),
        modulation=np.empty((height, width), np.float32),
        texture=np.empty((height, width), np.float32),
        flags=np.empty((height, width), np.uint16),
        noise=noise,
    )
    out = (view.coordinate, view.sigma, view.modulation, view.texture, view.flags)
    lattice = order_lattice(code.counts)
    steps = 2 * np.pi * np.arange(code.steps) / code.steps
    trigonometry = (np.cos(steps).astype(np.float32), np.sin(steps).astype(np.float32))
    sensor = (float(saturation), noise.read_variance, noise.gain)
    unwrap = _unwrap_arguments(lattice, code, settings)
    limits = _limits(lattice, settings, saturation)
    times = np.array(exposures, float)

    def decode(first: int, end: int) -> None:
        size = np.float32(projector_size)
        decode_rows(frames, times, *trigonometry, sensor, unwrap, limits, size, first, end, out)

    over_rows(decode, height, settings.threads)
    return view


def saturation_level(frames: NDArray, settings: ReconstructionSettings) -> float:
    """Grey level from which a sample counts as saturated.

    By default the top 1/255 of the range; the range of 16-bit frames is told from their largest sample (10, 12, 14 or
    16 bits, as cameras have them).
    """
    if settings.saturation is not None:
        return settings.saturation
    if frames.dtype == np.uint8:
        return 254.0
    bits = max(8, int(frames[:, :, ::4, ::4].max()).bit_length())
    full = float(2 ** (bits + bits % 2) - 1)
    return full * 254 / 255


def _check(frames: NDArray, code: FringeCode, exposures: Sequence[float]) -> None:
    if frames.ndim != 4 or frames.shape[:2] != (len(exposures), code.frames):
        raise SceneError(
            f"frames: found shape {frames.shape}, expected ({len(exposures)} exposures, {code.frames} frames, h, w)"
        )
    if frames.dtype not in (np.uint8, np.uint16):
        raise SceneError(f"frames: found {frames.dtype} samples, expected uint8 or uint16")
    if not all(np.isfinite(time) and time > 0 for time in exposures):
        raise SceneError(f"exposures: found {list(exposures)}, expected positive times")


def _unwrap_arguments(lattice: OrderLattice, code: FringeCode, settings: ReconstructionSettings) -> tuple:
    heterodyne = settings.unwrapping == "heterodyne"
    beats = heterodyne_beats(code.counts) if heterodyne else lattice.counts
    arrays = (lattice.counts, beats, lattice.basis, lattice.to_lattice, lattice.gram)
    return (heterodyne, *(np.ascontiguousarray(array, np.float32) for array in arrays))


def _limits(lattice: OrderLattice, settings: ReconstructionSettings, saturation: float) -> tuple:
    """Limits of `decode_rows`: signal-to-noise, modulation, chi-square, distances in turns²."""
    snr2 = lattice.largest_sigma(settings.max_slip_probability) ** -2
    least2 = (settings.min_modulation * saturation / 254) ** 2
    dimensions = lattice.counts.size - 1
    chi2_limit = float(chi2.isf(_NOISE_EXPLAINS, dimensions)) if dimensions else np.inf
    half_step = lattice.shortest / 2
    far2 = np.array([(share * half_step) ** 2 for share in _SHARES_OF_CELL], np.float32)
    return (np.float32(snr2), np.float32(least2), np.float32(chi2_limit), far2)
