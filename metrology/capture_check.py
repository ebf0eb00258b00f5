"""Whether a camera's frames are fit to be measured: exposure, modulation, noise and the projector's linearity.

What is seen is told by the frames' own fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.decode import decode_phase
from metrology.fringe import FringeCode
from metrology.gamma import projector_gamma
from metrology.reconstruct import usual_size
from metrology.saturation import saturation_level

_LIT = 0.02  # of the range: amplitude from which a pixel counts as lit …
_STRAY = 0.25  # … if it has this share of the strongest ones' amplitude
_STRIDE = 3
_LEAST_LIT = 0.01
_MOST_CLIPPED = 0.02
_LEAST_AMPLITUDE = 0.06
_TOP = 0.85  # of the range: where the brightest lit samples are well placed
_LOW_TOP = 0.5
_LEAST_CONTRAST = 0.35  # amplitude over mean level, 1 with a dark room and a sharp projector
_MOST_HARMONIC = 0.02  # of the first: gamma 1.06
_LEAST_SIGNAL = 12.0  # amplitude over a sample's noise


@dataclass(frozen=True)
class CaptureState:
    """One camera's frames of one exposure."""

    lit: float
    clipped: float
    """lit, clipped: share of the pixels that carry the pattern; of these, share with a clipped fringe sample."""
    top: float
    """99th percentile of the lit samples over the range."""
    amplitude: float
    contrast: float
    """amplitude, contrast: median modulation over the range, and over the mean level."""
    noise: float
    """Standard deviation of a sample at the mean level, grey levels."""
    signal: float
    """Median modulation over that noise."""
    sigma_px: float
    """Median standard deviation of the decoded coordinate, projector pixels (of a projector of usual size where the
    code does not tell)."""
    gamma: float | None
    """That of the projector as the second harmonic shows it; None where the steps cannot."""
    problems: tuple[str, ...]
    """What is wrong, each with what to change; empty where the frames are good."""

    @property
    def good(self) -> bool:
        """Whether nothing is to be changed."""
        return not self.problems


def check_capture(frames: NDArray, code: FringeCode) -> CaptureState:
    """Judge one camera's frames of one exposure, (code.frames, h, w) of uint8 or uint16 in Flushline's order."""
    fringes = frames[: code.fringe_frames] if code.counts else frames
    range_end = saturation_level(frames[None], fringes[None])
    view = decode_phase(frames[None], code, usual_size(code))
    lit = view.modulation > _LIT * range_end
    if lit.any():  # what stray light reaches is not what is to be measured
        lit &= view.modulation > _STRAY * float(np.quantile(view.modulation[lit], 0.95))
    share = float(lit.mean())
    if not lit.any():
        return CaptureState(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, np.inf, None, (_NO_LIGHT.format(0.0),))
    peak = fringes.max(0)
    clipped = peak >= range_end
    top = float(np.quantile(peak[lit], 0.99)) / range_end
    amplitude, mean = float(np.median(view.modulation[lit])), float(np.median(view.texture[lit]))
    noise = float(view.noise.sigma(mean)) if view.noise else 0.0
    good = lit & np.isfinite(view.sigma) & (view.flags == 0)
    state = CaptureState(
        lit=share,
        clipped=float(clipped[lit].mean()),
        top=min(top, 1.0),
        amplitude=amplitude / range_end,
        contrast=amplitude / max(mean, 1e-9),
        noise=noise,
        signal=amplitude / max(noise, 1e-9),
        sigma_px=float(np.median(view.sigma[good])) if good.any() else np.inf,
        gamma=projector_gamma(fringes[:, ::_STRIDE, ::_STRIDE][:, (lit & ~clipped)[::_STRIDE, ::_STRIDE]], code),
        problems=(),
    )
    return _judged(state, bool(code.counts))


_NO_LIGHT = (
    "the projector's pattern reaches {:.0%} of the pixels: point camera and projector at one place, expose longer, or "
    "check that the patterns were shown"
)


def _judged(state: CaptureState, fringes: bool) -> CaptureState:
    problems: list[str] = []
    if state.lit < _LEAST_LIT:
        problems.append(_NO_LIGHT.format(state.lit))
    if state.clipped > _MOST_CLIPPED and fringes:
        problems.append(
            f"{state.clipped:.0%} of the lit pixels are clipped: expose half as long, or add a second, shorter exposure"
        )
    elif state.top < _LOW_TOP and state.signal < 3 * _LEAST_SIGNAL:
        problems.append(f"too dark: expose {_TOP / max(state.top, 1e-3):.1f} times as long")
    if state.contrast < _LEAST_CONTRAST and fringes:
        problems.append(
            f"fringes change the light by {state.contrast:.0%} of its mean: keep other light away, focus the "
            "projector, or show wider fringes"
        )
    if state.signal < _LEAST_SIGNAL:
        more = "" if state.clipped > _MOST_CLIPPED else "more light or longer exposure, "
        problems.append(f"fringes are {state.signal:.1f} times the noise: {more}less gain, more steps")
    if state.gamma is not None and abs((state.gamma - 1) / (state.gamma + 2)) > _MOST_HARMONIC:
        problems.append(
            f"the projector is not linear (gamma {state.gamma:.2f}): switch off its picture modes; two cameras measure "
            "with it all the same, one camera or a fitted projector would not"
        )
    return CaptureState(**{**state.__dict__, "problems": tuple(problems)})


def verdict(states: Sequence[CaptureState]) -> str:
    """One word for a set of frames."""
    if all(state.good for state in states):
        return "good"
    hopeless = any(state.lit < _LEAST_LIT or state.amplitude < _LEAST_AMPLITUDE / 2 for state in states)
    return "not usable" if hopeless else "to be improved"
