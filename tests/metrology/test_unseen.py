"""Skin that something hides is named; seams, holes and the panel's own outline are not."""

import numpy as np
import pytest

from metrology.cloud import PixelFlag
from metrology.unseen import unseen_skin
from tests.support.seam_scan import SHAPE, Relief, seam_scan
from tests.support.seam_textures import Band

V, U = np.indices(SHAPE)


def test_what_a_hand_covers_is_told_with_place_and_cause(rng):
    hidden = ((U - 400) / 90) ** 2 + ((V - 300) / 120) ** 2 < 1
    unseen = unseen_skin(seam_scan([], [], rng, lit=~hidden))
    assert unseen is not None
    assert unseen.share == pytest.approx(hidden.mean(), rel=0.05)
    assert (unseen.u_px, unseen.v_px) == pytest.approx((400, 300), abs=8)
    assert unseen.cause == PixelFlag.LOW_MODULATION


def test_a_highlight_is_told_by_the_camera_that_it_dazzles(rng):
    unseen = unseen_skin(seam_scan([], [], rng, unmatched=np.hypot(U - 600, V - 350) < 60))
    assert unseen is not None
    assert unseen.cause == PixelFlag.UNMATCHED


def test_seams_heads_and_the_border_of_the_field_are_nothing_unseen(rng):
    field = (U > 80) & (V > 40 + 0.05 * U) & (U < 860)
    head = np.hypot(U - 300, V - 300) < 25
    seam = Band((450.0, 350.0), 85.0, 12.0, 60.0)
    assert unseen_skin(seam_scan([seam], [Relief(2.0, 0.1)], rng, lit=field & ~head)) is None
