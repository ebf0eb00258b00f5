"""What the cameras see of an image that the projector shows on a simulated panel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Float32
from simulator.projection import project_image, receive_image
from simulator.scene import Stage
from simulator.spec import SimulationSpec
from simulator.trace import Hits


def look_at_image(stage: Stage, spec: SimulationSpec, image: NDArray[np.generic]) -> dict[str, Float32]:
    """What both cameras see of an image shown on the panel, without noise.

    Parameters
    ----------
    image : (h, w) or (h, w, channels) at the projector's resolution, uint8 or float in [0, 1]

    Returns
    -------
    {"left": …, "right": …} of (h, w) or (h, w, channels) float32, grey levels at exposure 1.
    """
    values = np.asarray(image, float) / (255.0 if image.dtype == np.uint8 else 1.0)
    layers = values[..., None] if values.ndim == 2 else values
    tables = [project_image(layers[..., k], spec.projector) for k in range(layers.shape[-1])]
    seen = {}
    for side in ("left", "right"):
        hits: Hits = getattr(stage, side)
        stack = np.stack([receive_image(hits, table) for table in tables], axis=-1) + np.float32(
            spec.camera.sensor.offset
        )
        seen[side] = stack[..., 0] if values.ndim == 2 else stack
    return seen
