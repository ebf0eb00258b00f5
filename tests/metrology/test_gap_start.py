"""Where a gap's fit begins: stations that look like the rest, and as much other light as there is."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from metrology.decode import decode_phase
from metrology.fringe import FringeCode
from metrology.gamma import fringe_gain
from metrology.seams.gap.fit import fit_gap
from metrology.seams.gap.floor import possible_floors
from metrology.seams.gap.shape import _usual
from metrology.seams.gap.views import both_views
from tests.support.gap_render import Gap, profiles
from tests.support.rendered_fringes import clean_frames, ramp, recorded

CODE = FringeCode("x", 4, (13, 12, 11))


def test_letters_on_most_of_a_few_stations_do_not_lead_the_fit_astray() -> None:
    rng = np.random.default_rng(2)
    gap = Gap(1.0, 0.2, 0.2)
    some = profiles(gap, 24, rng, lens_px=0.7)
    grey, painted = some.grey.copy(), [0, 1, 9, 14, 15, 23]
    for row in painted:  # four of six that are evenly spread
        begin = rng.uniform(-2, 1)
        grey[row][(some.x[row] > begin) & (some.x[row] < begin + 1.2)] *= 0.3
    some = replace(some, grey=grey)
    assert not set(_usual(some, 6)) & set(painted)
    fit = fit_gap(some, possible_floors(None))
    widths = fit.borders @ [-1.0, 1.0] - fit.chamfers_mm.sum()
    assert np.abs(widths - gap.width_mm)[fit.sound].max() < 0.1


def test_stations_that_one_camera_does_not_see(rng: np.random.Generator) -> None:
    some = profiles(Gap(1.0, 0.2), 5, rng)
    sizes = some.sizes.copy()
    sizes[:, 1] = 0
    sizes[2] = 0
    assert len(_usual(replace(some, sizes=sizes), 6)) == 3


@pytest.mark.parametrize("gamma", [1.0, 1.6, 2.2])
@pytest.mark.parametrize("share", [0.1, 0.25])
def test_other_light_is_told_whatever_the_projector_s_gamma(
    rng: np.random.Generator, gamma: float, share: float
) -> None:
    turn = np.linspace(0, 2 * np.pi, 3600, endpoint=False)
    light = (0.5 + 0.5 * np.cos(turn)) ** gamma
    assert 2 * (light * np.cos(turn)).mean() / light.mean() == pytest.approx(fringe_gain(gamma), rel=1e-6)
    lit = 70.0
    other = share / (1 - share) * lit * 2 * light.mean()
    frames = recorded(clean_frames(ramp(90, 320, 640), CODE, 640, other + lit, lit, gamma), rng, 1.0)
    view = decode_phase(frames, CODE, 640)
    left, right = both_views(SimpleNamespace(cameras={"left": (None, view), "right": (None, view)}))  # type: ignore[arg-type]
    assert left.ambient == right.ambient == pytest.approx(share, abs=0.015)
