"""How blurred the fringes are: fine fringes lose more of their contrast to blur than coarse ones."""

from __future__ import annotations

import numpy as np

from metrology.cloud import DecodedView
from metrology.flicker import levelled
from metrology.frame_consistency import unclipped
from metrology.frame_sample import FrameSample, fit_sinusoids

_LEAST_COUNT = 8  # of fewer fringes gamma and shading tell more than blur
_FEWEST = 200
_BRIGHT = 0.5  # of the median amplitude: noise would add to the amplitude of fainter fringes


def fringe_blur(sample: FrameSample, view: DecodedView, size: int) -> float | None:
    """Standard deviation of the blur of camera and projector together, pixels; None where nothing tells.

    A blur of σ leaves exp(−2π²σ²/p²) of a fringe of period p, so the ratio of two counts' amplitudes tells σ.

    Parameters
    ----------
    sample : FrameSample
        Of the camera's frames; the first exposure is looked at.
    view : DecodedView
        Of the same camera.
    size : int
        W, projector pixels along the fringe axis.
    """
    code = sample.code
    levels = sample.frames(0)[: code.fringe_frames]
    whole = unclipped(levels, sample.saturation)
    fit = fit_sinusoids(levels, range(len(levels)), code)
    if fit is not None and whole.any():  # flicker of a percent in one count alone would pass for half a pixel of blur
        fit = fit_sinusoids(levelled(levels, fit, whole, code), range(len(levels)), code)
    told = [] if fit is None else [k for k, used in enumerate(fit.used) if code.counts[used] >= _LEAST_COUNT]
    if fit is None or len(told) < 2:
        return None
    fine, coarse = (pick(told, key=lambda k: code.counts[fit.used[k]]) for pick in (max, min))
    slopes = np.abs(np.diff(view.coordinate[::8, ::1] if code.axis == "x" else view.coordinate[:, ::8].T, axis=1))
    least = fit.amplitude[[fine, coarse]].min(0)
    use = whole & (least > _BRIGHT * np.median(least))
    if use.sum() < _FEWEST or not np.isfinite(slopes).any():
        return None
    per_count = size / float(np.nanmedian(slopes))
    periods = [per_count / code.counts[fit.used[k]] for k in (fine, coarse)]
    lost = -np.log(float(np.median(fit.amplitude[fine][use] / fit.amplitude[coarse][use])))
    return float(np.sqrt(max(lost, 0.0) / (2 * np.pi**2 * (periods[0] ** -2 - periods[1] ** -2))))
