"""Cameras and a screen that are not there: the cameras see a plane on which lies what the screen shows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from flows.capture.devices import Dropped, Taken
from metrology.rig import Rig
from tests.support.rendered_fringes import PLANE_DISTANCE, PLANE_NORMAL, plane_depth, seen_coordinate

FULL_MS = 20.0
"""The exposure at which white light just reaches the end of the range."""


class FakeRig:
    """Cameras and screen in one; `faults` says what happens at the pictures of these numbers.

    Faults: "drop" (no picture in time), "lose" (the camera's count goes on without one), "stale" (the last picture
    again), "swap" (what was shown before), "cancel" (Ctrl-C).
    """

    def __init__(self, rig: Rig, faults: dict[int, str] | None = None) -> None:
        self.shown: list[NDArray[Any]] = []
        self.exposures: list[float] = []
        self.closed = 0
        self._faults, self._taken, self._number = faults or {}, 0, 100
        self._rng = np.random.default_rng(0)
        self._columns = {}
        for name, device in rig.cameras.items():
            seen = seen_coordinate(rig, plane_depth(device, PLANE_NORMAL, PLANE_DISTANCE), "x")
            self._columns[name] = np.clip(np.nan_to_num(seen, nan=-1.0), -1, None)
        self._last: dict[str, Taken] = {}

    def show(self, image: NDArray[Any]) -> None:
        self.shown.append(np.array(image[0], float))

    def set_exposure(self, milliseconds: float) -> None:
        self.exposures.append(milliseconds)

    def trigger(self) -> None:
        self._number += 1

    def fetch(self, timeout_s: float) -> dict[str, Taken]:
        fault = self._faults.get(self._taken)
        self._taken += 1
        if fault == "cancel":
            raise KeyboardInterrupt
        if fault == "drop":
            self._number -= 1
            raise Dropped(f"left camera: found no picture within {timeout_s:g} s, expected one")
        if fault == "stale":
            self._number -= 1
            return self._last
        if fault == "lose":
            self._number += 1
        line = self.shown[-2 if fault == "swap" else -1]
        self._last = {name: Taken(self._seen(columns, line), self._number) for name, columns in self._columns.items()}
        return self._last

    def _seen(self, columns: NDArray[Any], line: NDArray[Any]) -> NDArray[np.uint8]:
        light = np.interp(columns, np.arange(len(line)), line / 255.0) * (columns >= 0)
        levels = 4 + 251 * light * self.exposures[-1] / FULL_MS + self._rng.normal(0, 1.0, columns.shape)
        return np.clip(np.rint(levels), 0, 255).astype(np.uint8)

    def close(self) -> None:
        self.closed += 1
