"""Cameras of rectified pictures, of which files mostly say no more than one camera matrix and the baseline, or Q."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from metrology.arrays import Array
from storage.calibration_documents import numbers

_FOCAL = ("f", "focal", "focallength", "focallengthpx", "focalpx", "fpx")
_BASELINE = ("baseline", "baselinemm", "baselinem", "baselength")
_NONE = np.zeros((1, 5))


def from_rectification(values: Mapping[str, Any], found: Mapping[str, Array]) -> dict[str, Array]:
    """M, D, R and T of both cameras; empty where the values tell no such pair.

    Parameters
    ----------
    values : mapping
        Flat names to values.
    found : mapping
        What was told of one camera, or of none.
    """
    if {"M2", "R", "T"} & set(found):
        return {}
    told = {re.sub(r"[^a-z]", "", name.rpartition(".")[2].lower()): numbers(value) for name, value in values.items()}
    single = {name: value.item() for name, value in told.items() if value is not None and value.size == 1}
    Q = told.get("q")
    if Q is not None and Q.shape == (4, 4) and Q[3, 2]:
        shift = -1 / Q[3, 2]
        first = np.array([[Q[2, 3], 0, -Q[0, 3]], [0, Q[2, 3], -Q[1, 3]], [0, 0, 1.0]])
        return _pair(first, first[0, 2] - Q[3, 3] * shift, abs(shift) * np.sign(-shift))
    baseline = next((single[name] for name in _BASELINE if single.get(name)), None)
    K = found.get("M1") if not np.any(found.get("D1", 0.0)) else None
    focal = next((single[name] for name in _FOCAL if single.get(name)), None)
    if K is None and focal and "cx" in single and "cy" in single:
        K = np.array([[focal, 0, single["cx"]], [0, focal, single["cy"]], [0, 0, 1.0]])
    if baseline is None or K is None or K.size != 9:
        return {}
    return _pair(K.reshape(3, 3), K.reshape(3, 3)[0, 2] + single.get("doffs", 0.0), abs(baseline))


def _pair(K: Array, second_cx: float, baseline: float) -> dict[str, Array]:
    """Cameras that differ in their principal column alone, the right one by the baseline to the right."""
    second = np.array(K, float)
    second[0, 2] = second_cx
    return {"M1": K, "M2": second, "D1": _NONE, "D2": _NONE, "R": np.eye(3), "T": np.array([-baseline, 0.0, 0.0])}
