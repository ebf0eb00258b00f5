"""Lens models that files name in words; Flushline's is OpenCV's pinhole with radial and tangential terms."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from metrology.errors import RigError

# Whole words: a sensor of OmniVision's is no omnidirectional camera.
_OTHERS = re.compile(
    r"(?<![a-z])(fish.?eye|equidistant|equi|kannala|omni|omnidirectional|mei|double.?sphere|f.?theta|scaramuzza)(?![a-z])",
    re.IGNORECASE,
)
_OURS = "a pinhole lens with OpenCV's terms k1, k2, p1, p2, k3"
_TELLING = ("model", "type", "distortion", "lens", "projection")


def check_lens_names(said: Mapping[str, Any]) -> None:
    """RigError where a key such as `distortion_model` names another lens model, at any depth.

    Parameters
    ----------
    said : mapping
        What a file says beside the numbers.
    """
    for key, value in said.items():
        name = key.lower()
        if isinstance(value, Mapping):
            check_lens_names(value)
        elif isinstance(value, str) and any(word in name for word in _TELLING):
            if _OTHERS.search(value):
                raise RigError(f"{key}: found {value!r}, expected {_OURS}")
        elif name in ("fisheye", "is_fisheye", "use_fisheye") and value is True:
            raise RigError(f"{key}: found true, expected {_OURS}")
