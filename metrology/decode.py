"""One camera's fringe frames to a DecodedView."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from metrology.cloud import DecodedView
from metrology.errors import SceneError
from metrology.fringe import FringeCode
from metrology.gamma import projector_gamma
from metrology.gray import continue_orders, stripe_positions
from metrology.gray_edges import decode_stripes
from metrology.jit import over_rows
from metrology.noise import NoiseModel, estimate_noise, stripe_noise
from metrology.phase.exposures import StepTables
from metrology.phase.rows import decode_rows
from metrology.phase.unwrapping import COARSE, HETERODYNE, LATTICE
from metrology.reconstruction_settings import ReconstructionSettings
from metrology.saturation import code_saturation
from metrology.unwrap import heterodyne_beats, largest_sigma, order_lattice

# A contradiction between the phases is one that noise explains in 1 of 1e6 pixels and that exceeds this share of the
# way to the next lattice point's cell; beyond the second share the order is a toss-up whatever the noise.
_NOISE_EXPLAINS = 1e-6
_SHARES_OF_CELL = (0.5, 0.9)
_SPARSE = 16  # every so many rows and columns tell the projector's gamma


def _noise(frames: NDArray, fringes: NDArray, code: FringeCode, saturation: float) -> NoiseModel:
    """By the fringes' residuals; by Gray code where three steps of one count leave none."""
    if code.gray is None or code.step_counts != (3,):
        return estimate_noise(fringes, code, saturation)
    levels = frames[0, code.fringe_frames :].astype(np.float32)
    return stripe_noise(levels, levels[:2] - fringes[0].mean(0, dtype=np.float32), code.gray, saturation)


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
    projector_size : int
        Projector pixels along the fringe axis.
    exposures : sequence of float
        Exposure times relative to exposure 1.
    noise : NoiseModel, optional
        The camera's noise; estimated from the frames by default.
    """
    settings = settings or ReconstructionSettings()
    _check(frames, code, exposures)
    fringes = np.ascontiguousarray(frames[:, : code.fringe_frames])
    saturation = settings.saturation or code_saturation(frames, code)
    noise = noise or _noise(frames, fringes, code, saturation)
    if not code.counts:
        return decode_stripes(frames, code, projector_size, exposures, settings, saturation)
    height, width = frames.shape[2:]
    view = DecodedView(
        coordinate=np.empty((height, width), np.float32),
        sigma=np.empty((height, width), np.float32),
        modulation=np.empty((height, width), np.float32),
        texture=np.empty((height, width), np.float32),
        flags=np.empty((height, width), np.uint16),
        noise=noise,
        gamma=_gamma(fringes[np.argmin(exposures)], code, saturation),
    )
    out = (view.coordinate, view.sigma, view.modulation, view.texture, view.flags)
    coarse = np.empty((0, 0), np.float32)
    if code.gray:
        stripes = np.ascontiguousarray(frames[:, code.fringe_frames :])
        coarse = stripe_positions(
            stripes, code.gray, _mean_level(fringes, exposures, saturation), exposures, saturation
        )
    steps = StepTables(
        first=np.concatenate([[0], np.cumsum(code.step_counts)]).astype(np.int64),
        cosines=np.cos(code.step_angles).astype(np.float32),
        sines=np.sin(code.step_angles).astype(np.float32),
        offsets=code.offset_turns.astype(np.float32),
    )
    sensor = (float(saturation), noise.read_variance, noise.gain)
    unwrap = _unwrap_arguments(code, settings)
    limits = _limits(code, settings, saturation)
    times = np.array(exposures, float)
    size = np.float32(projector_size)

    def decode(first: int, end: int) -> None:
        decode_rows(fringes, times, steps, sensor, unwrap, coarse, limits, size, first, end, out)

    over_rows(decode, height, settings.threads)
    if code.gray:
        continue_orders(view.coordinate, min(code.counts), code.gray, projector_size)
    return view


def _gamma(fringes: NDArray, code: FringeCode, saturation: float) -> float | None:
    """The projector's gamma from some of the pixels without a clipped sample; the bright ones count most."""
    some = fringes[:, ::_SPARSE, ::_SPARSE]
    return projector_gamma(some[:, some.max(0) < saturation], code)


def _mean_level(fringes: NDArray, exposures: Sequence[float], saturation: float) -> NDArray[np.float64]:
    """(h, w) mean of the fringe frames at exposure 1, from the longest exposure in which none of them saturates."""
    level = fringes[np.argmin(exposures)].mean(0) / min(exposures)
    for e in np.argsort(exposures)[1:]:
        good = fringes[e].max(0) < saturation
        level[good] = fringes[e][:, good].mean(0) / exposures[e]
    return np.asarray(level)


def _check(frames: NDArray, code: FringeCode, exposures: Sequence[float]) -> None:
    if frames.ndim != 4 or frames.shape[:2] != (len(exposures), code.frames):
        raise SceneError(
            f"frames: found shape {frames.shape}, expected ({len(exposures)} exposures, {code.frames} frames, h, w)"
        )
    if frames.dtype not in (np.uint8, np.uint16):
        raise SceneError(f"frames: found {frames.dtype} samples, expected uint8 or uint16")
    if not all(np.isfinite(time) and time > 0 for time in exposures):
        raise SceneError(f"exposures: found {list(exposures)}, expected positive times")


def _unwrap_arguments(code: FringeCode, settings: ReconstructionSettings) -> tuple:
    """Arguments `unwrap` of `decode_rows`."""
    counts = np.array(code.counts, np.float32)
    order = np.argsort(counts)
    beats, basis, to_lattice, gram = counts[:1], *(np.zeros((0, 0), np.float32),) * 3
    if code.gray:
        return COARSE, counts, beats, order, basis, to_lattice, gram
    lattice = order_lattice(code.counts)
    basis, to_lattice, gram = (
        np.ascontiguousarray(array, np.float32) for array in (lattice.basis, lattice.to_lattice, lattice.gram)
    )
    if settings.unwrapping == "ml":
        return LATTICE, counts, beats, order, basis, to_lattice, gram
    return HETERODYNE, counts, heterodyne_beats(code.counts).astype(np.float32), order, basis, to_lattice, gram


def _limits(code: FringeCode, settings: ReconstructionSettings, saturation: float) -> tuple:
    """Limits of `decode_rows`: signal-to-noise, modulation, chi-square, distances in turns²."""
    least2 = (settings.min_modulation * saturation / 254) ** 2
    dimensions = len(code.counts) - 1
    chi2_limit = float(chdtri(dimensions, _NOISE_EXPLAINS)) if dimensions else np.inf
    # Gray code leaves half a fringe of margin to every phase.
    shortest = 1.0 if code.gray else order_lattice(code.counts).shortest
    snr2 = largest_sigma(shortest, settings.max_slip_probability) ** -2
    distances = ((share * shortest / 2) ** 2 for share in _SHARES_OF_CELL)
    return tuple(np.float32(limit) for limit in (snr2, least2, chi2_limit, *distances))
