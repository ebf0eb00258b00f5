"""What a capture needs of cameras and projector; drivers are chosen by name."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray

from metrology.errors import FlushlineError, UsageError
from storage.frames import Frame


class CaptureError(FlushlineError):
    """Cameras or projector that did not do what a capture asked of them."""


class Dropped(CaptureError):
    """A picture that a camera did not deliver; it is taken again."""


@dataclass(frozen=True)
class Taken:
    """A picture."""

    frame: Frame
    """(h, w) of uint8 or uint16."""
    number: int
    """The camera's own count of its pictures, by which a lost one shows."""


class Cameras(Protocol):
    """Cameras that are triggered together, by name: left, and right where there is one."""

    def set_exposure(self, milliseconds: float) -> None:
        """Expose the pictures that follow so long."""

    def trigger(self) -> None:
        """Take one picture with every camera; with hardware triggering the projector does."""

    def fetch(self, timeout_s: float) -> dict[str, Taken]:
        """The pictures of the last trigger; Dropped where a camera has none in time."""

    def close(self) -> None:
        """Give the cameras back."""


class Screen(Protocol):
    """What shows the patterns."""

    def show(self, image: NDArray[Any]) -> None:
        """Show a picture, (height, width) uint8, and return once it is seen."""

    def close(self) -> None:
        """Give the screen back."""


_DRIVERS = {"harvester": "flows.capture.harvester"}


def open_cameras(named: str, serials: dict[str, str], hardware: bool) -> Cameras:
    """Cameras by driver and what it takes: ``harvester:/opt/producer.cti``.

    Parameters
    ----------
    serials : dict of str
        Serial number of left and right.
    hardware : bool
        Whether the projector triggers the cameras.
    """
    driver, _, rest = named.partition(":")
    if driver not in _DRIVERS:
        raise UsageError(f"--cameras: found {driver!r}, expected {', '.join(_DRIVERS)}:…")
    cameras: Cameras = importlib.import_module(_DRIVERS[driver]).open_cameras(rest, serials, hardware)
    return cameras
