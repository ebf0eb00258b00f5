"""Holes that are filled with sealant: discs below the skin that step down at their border, and have no gap round them.

A head has a gap, or its ring was found; a dent only begins to bend at its border; paint and stickers lie on the skin.
Under paint a filled hole and a sunk head look alike: what does not show in the picture is taken for a head.
"""

from __future__ import annotations

from collections.abc import Sequence

from metrology.cloud import Reconstruction
from metrology.holes.find import Opening
from metrology.rivets.ellipse import Ellipse
from metrology.rivets.relief import Disc, on_skin, shows_in_texture
from metrology.rivets.rim_step import rim_step, steps_up

_STEPS = 6.0  # standard deviations of the step: edges of paint pass for five


def filled_openings(reconstruction: Reconstruction, discs: Sequence[Disc], taken: Sequence[Ellipse]) -> list[Opening]:
    """The holes that sealant fills.

    Parameters
    ----------
    taken : sequence of Ellipse
        Heads and open holes.
    """
    return [
        Opening(disc.ellipse, disc.height_mm, filled=True)
        for disc in discs
        if disc.height_mm < 0 and not any(disc.ellipse.meets(other) for other in taken) and _steps(disc, reconstruction)
    ]


def _steps(disc: Disc, reconstruction: Reconstruction) -> bool:
    """Whether the surface steps down at a disc's border, where the picture shows one, with skin all round."""
    if not on_skin(reconstruction, disc.ellipse) or not shows_in_texture(reconstruction.left.texture, disc.ellipse):
        return False
    step = rim_step(reconstruction, disc.ellipse)
    return step is not None and step.mean_significance >= _STEPS and steps_up(disc.height_mm, step)
