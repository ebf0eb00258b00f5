"""From light to grey levels: exposure, photon and read-out noise, quantisation, saturation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.errors import SpecError


@dataclass(frozen=True)
class Sensor:
    """A camera's sensor."""

    gain: float = 0.016
    """Grey levels per photo-electron: the shot noise's variance is gain × signal. 0: no shot noise."""
    read_noise: float = 0.6
    """Standard deviation of the read-out, grey levels."""
    offset: float = 3.0
    """Grey level of no light."""
    bits: int = 8
    """8 or 16."""

    def __post_init__(self) -> None:
        for name in ("gain", "read_noise", "offset"):
            if getattr(self, name) < 0:
                raise SpecError(f"camera {name}: found {getattr(self, name)}, expected 0 or more")
        if self.bits not in (8, 16):
            raise SpecError(f"camera bits: found {self.bits}, expected 8 or 16")

    def capture(
        self, light: NDArray[np.float32], exposure: float, rng: np.random.Generator
    ) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """One frame.

        Parameters
        ----------
        light : (h, w) float32
            Grey levels at exposure 1 on the 8-bit scale, unlimited.
        """
        signal = exposure * light
        if self.gain > 0:
            signal = rng.poisson(signal / self.gain) * np.float32(self.gain)
        if self.read_noise > 0:
            signal = signal + np.float32(self.read_noise) * rng.standard_normal(light.shape, np.float32)
        signal = signal + np.float32(self.offset)
        if self.bits == 8:
            return np.clip(np.rint(signal), 0, 255).astype(np.uint8)
        return np.clip(np.rint(signal * 257), 0, 65535).astype(np.uint16)
