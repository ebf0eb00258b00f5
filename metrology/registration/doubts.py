"""Whether a scan may become its station's pattern: later scans are held against it, so somebody must vouch for it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from metrology.frame_consistency import contradictory_share

# Sound scans have less than one in two hundred, and those in mixed phase along edges.
_MOST_CONTRADICTORY = 0.02


def enrolment_doubts(flags: Mapping[str, NDArray[np.uint16]], rig_verdict: str | None) -> tuple[str, ...]:
    """Why nobody can vouch for what was found in a scan; empty for a sound one.

    Parameters
    ----------
    flags : mapping of str to (h, w) uint16
        PixelFlag bits of each camera.
    rig_verdict : str or None
        Whether the rig fits the scan; None where an older run did not say.
    """
    found = []
    for camera, bits in flags.items():
        share = contradictory_share(bits)
        if share > _MOST_CONTRADICTORY:
            found.append(f"{share:.0%} of the {camera} camera's fringes contradict each other")
    if rig_verdict == "unjudged":
        found.append("it cannot tell whether the rig fits")
    return tuple(found)
