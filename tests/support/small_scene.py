"""Small scenes, and the way through the steps without the science: metrology is replaced at its door."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from metrology.fastening import Fasteners
from metrology.fringe import FringeCode
from metrology.results import SceneKey
from metrology.rig_health import RigHealth
from storage.scene import write_scene
from tasks import steps
from tests.support.results import HEIGHT, WIDTH, small_result


def write_small_scene(folder: Path, key: SceneKey, seed: int = 1) -> Path:
    """A complete scene folder of fringes and noise."""
    code = FringeCode("x", 4, (7, 6, 5))
    rng = np.random.default_rng(seed)
    fringes = 30 + 150 * code.patterns(WIDTH, HEIGHT)
    left, right = np.rint(fringes + rng.normal(0, 2, (2, 1, *fringes.shape))).astype(np.uint8)
    write_scene(folder, key, "rig-a", code, [1.0], left, right)
    return folder


def fake_metrology_in(put: Callable[[Any, str, Any], None]) -> list[str]:
    """Put a part of a small result behind every entry point of metrology; the list says which were called, in order."""
    result = small_result()
    called: list[str] = []

    def gives(name: str, value: Any) -> Any:
        def fake(*_: Any) -> Any:
            called.append(name)
            return value

        return fake

    for room, name, value in (
        (steps.reconstruct, "decode", result.reconstruction.left),
        (steps.reconstruct, "triangulate", result.reconstruction),
        (steps, "detect_fasteners", Fasteners([], [])),
        (steps.rig_health, "epipolar_health", RigHealth(0.06, 0.004, 200, 0.001, 400, "ok", None)),
        (steps.seams, "detect_seams", []),
        (steps.rivets, "measure_rivets", list(result.features["rivet"])),
        (steps.seams, "measure_seams", list(result.features["seam station"])),
        (steps.overlay, "draw_overlay", result.overlay),
    ):
        put(room, name, gives(name, value))
    return called
