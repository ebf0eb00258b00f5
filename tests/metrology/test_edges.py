"""What is flagged near edges, and what is left alone."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from metrology.cloud import PixelFlag
from metrology.edges import flag_neighbourhoods
from metrology.fringe import FringeCode, GrayCode
from metrology.reconstruct import decode
from metrology.reconstruction_settings import ReconstructionSettings
from tests.support.rendered_fringes import USUAL, clean_frames, ramp, recorded

SIZE = 1280
BLUR = 1.0


def seen(reflectance: np.ndarray, coordinate: np.ndarray, rng: np.random.Generator | None) -> np.ndarray:
    """Frames through a lens that blurs by BLUR pixels."""
    clean = clean_frames(coordinate, USUAL, SIZE, 110 * reflectance, 90 * reflectance)
    return recorded(np.stack([cv2.GaussianBlur(frame, (0, 0), BLUR) for frame in clean]), rng, 1.5)


def test_dark_ring_is_flagged_and_nothing_unflagged_is_biased(rng: np.random.Generator) -> None:
    v, u = np.mgrid[:160, :160].astype(float)
    radius = np.hypot(u - 80, v - 80)
    truth = 300 + 0.72 * u + 0.02 * v
    total, squares, number, kept = np.zeros(u.shape), 0.0, np.zeros(u.shape), 0
    for _ in range(12):
        view = decode(seen(np.where(np.abs(radius - 30) < 1.0, 0.3, 1.0), truth, rng), USUAL, SIZE)
        clear = ((view.flags & PixelFlag.EDGE) == 0) & np.isfinite(view.coordinate)
        kept += int((clear & (radius < 30)).sum())
        error = np.where(clear, view.coordinate - truth, 0.0)
        total += error
        squares += float((error**2).sum())
        number += clear
    sigma = np.sqrt(squares / number.sum())
    near = (np.abs(radius - 30) < 8) & (number > 0)
    bias = total[near] / number[near]
    assert np.percentile(np.abs(bias) * np.sqrt(number[near]), 99) < 3.5 * sigma
    # Light leaning to the bright side would push the phase to opposite sides inside and outside of the ring.
    side = np.sign((u - 80) * (radius - 30))[near]
    assert abs((bias * side).mean()) < 4 * sigma / np.sqrt(number[near].sum())
    # The head's inside stays usable.
    assert kept / 12 > 0.6 * (radius < 30).sum()


def test_depth_jump_and_shadow_border_are_flagged(rng: np.random.Generator) -> None:
    u = np.arange(200.0) * np.ones((60, 1))
    jump = np.where(u < 100, 0, 4.0)
    reflectance = np.where(u < 160, 1.0, 0.02)
    view = decode(seen(reflectance, 300 + 0.72 * u + jump, rng), USUAL, SIZE)
    edge = (view.flags & PixelFlag.EDGE) != 0
    assert edge[5:-5, 98:102].all()
    assert edge[5:-5, 156:160].all()
    assert not edge[5:-5, 10:90].any()


def test_brushed_skin_is_not_flagged(rng: np.random.Generator) -> None:
    brushed = cv2.GaussianBlur(rng.normal(0, 1, (200, 300)), (0, 0), sigmaX=12, sigmaY=1)
    reflectance = 1 + 0.05 * brushed / brushed.std()
    view = decode(seen(reflectance, ramp(200, 300, SIZE)[:, :300] * 0.2 + 300, rng), USUAL, SIZE)
    assert ((view.flags & PixelFlag.EDGE) != 0)[5:-5, 5:-5].mean() < 0.005


def test_a_pixel_that_noise_lost_is_no_edge(rng: np.random.Generator) -> None:
    view = decode(seen(np.ones((60, 80)), 300 + 0.72 * np.arange(80.0) * np.ones((60, 1)), rng), USUAL, SIZE)
    lost = view.coordinate.copy()
    lost[30, 40] = lost[20, 20] = lost[20, 21] = np.nan
    lost[40:44, 60:64] = np.nan
    flags = view.flags.copy()
    flags[20, 20:22] |= np.uint16(PixelFlag.SATURATED)
    marked = flag_neighbourhoods(replace(view, coordinate=lost, flags=flags), 12, ReconstructionSettings()).flags
    edge = (marked & PixelFlag.EDGE) != 0
    assert not edge[27:34, 37:44].any()
    assert edge[20, 17:25].any()
    assert edge[37:47, 57:67].any()


def test_noise_at_little_light_is_no_edge(rng: np.random.Generator) -> None:
    code = FringeCode("x", 4, (64,), GrayCode(64, True))
    clean = clean_frames(ramp(120, 400, SIZE)[:, :400] * 0.2 + 300, code, SIZE, 12, 10)
    view = decode(recorded(clean, rng, 1.0), code, SIZE)
    assert ((view.flags & PixelFlag.EDGE) != 0)[8:-8, 8:-8].mean() < 0.01


def test_small_heads_keep_their_middle(rng: np.random.Generator) -> None:
    v, u = np.mgrid[:60, :60].astype(float)
    radius = np.hypot(u - 30, v - 30)
    view = decode(seen(np.where(np.abs(radius - 8) < 1.0, 0.35, 1.0), 300 + 0.72 * u, rng), USUAL, SIZE)
    assert ((view.flags[radius < 3.0] & PixelFlag.EDGE) == 0).all()


def test_neighbours_of_saturated_pixels_are_flagged(rng: np.random.Generator) -> None:
    reflectance = np.ones((60, 80))
    reflectance[28:32, 38:42] = 2.5
    view = decode(seen(reflectance, ramp(60, 80, SIZE), rng), USUAL, SIZE)
    touched = (view.flags & PixelFlag.SATURATED_SAMPLES) != 0
    assert touched[26:34, 37:43].all()
    assert not touched[:, :30].any()


def test_a_blurred_picture_s_outermost_pixels_have_no_phase(rng: np.random.Generator) -> None:
    truth = 300 + 0.72 * np.arange(120.0) * np.ones((400, 1))
    blur = cv2.GaussianBlur(np.pad(truth, 4, mode="reflect"), (0, 0), 0.6)[4:-4, 4:-4]
    assert abs(blur - truth)[:, 0].min() > 0.1
    view = decode(recorded(clean_frames(blur, USUAL, SIZE, 110, 90), rng, 1.5), USUAL, SIZE)
    missing = ~np.isfinite(view.coordinate)
    assert missing[:, [0, -1]].all()
    assert missing[[0, -1]].all()
    assert not missing[1:-1, 1:-1].any()
    assert ((view.flags & PixelFlag.ORDER_RESIDUAL) != 0)[missing].all()
    assert abs((view.coordinate - truth)[1:-1, 1:-1].mean(axis=0)).max() < 0.02
