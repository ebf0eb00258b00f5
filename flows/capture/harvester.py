"""GenICam cameras through Harvester and a maker's GenTL producer (`pip install flushline[capture]`).

Written to the interface of harvesters 1.4; no camera was at hand to try it with.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from flows.capture.devices import CaptureError, Dropped, Taken
from metrology.errors import UsageError

_US_PER_MS = 1000.0
_FORMATS = ("Mono8", "Mono10", "Mono12", "Mono16")


class HarvesterCameras:
    """Cameras by their serial numbers."""

    def __init__(self, producer: Path, serials: dict[str, str], hardware: bool) -> None:
        from harvesters.core import Harvester

        self._harvester = Harvester()
        self._cameras: dict[str, Any] = {}
        self._hardware = hardware
        self._harvester.add_file(str(producer))
        self._harvester.update()
        try:
            for name, serial in serials.items():
                self._cameras[name] = self._open(serial)
        except BaseException:
            self.close()
            raise

    def _open(self, serial: str) -> Any:
        found = [info.serial_number for info in self._harvester.device_info_list]
        if serial not in found:
            raise CaptureError(f"camera {serial}: found {', '.join(found) or 'none'}, expected it to be connected")
        camera = self._harvester.create({"serial_number": serial})
        nodes = camera.remote_device.node_map
        if nodes.PixelFormat.value not in _FORMATS:
            nodes.PixelFormat.value = "Mono8"
        nodes.TriggerSelector.value = "FrameStart"
        nodes.TriggerMode.value = "On"
        nodes.TriggerSource.value = "Line0" if self._hardware else "Software"
        for name in ("ExposureAuto", "GainAuto"):
            if hasattr(nodes, name):
                getattr(nodes, name).value = "Off"
        camera.start()
        return camera

    def set_exposure(self, milliseconds: float) -> None:
        """Expose so long."""
        for camera in self._cameras.values():
            camera.remote_device.node_map.ExposureTime.value = milliseconds * _US_PER_MS

    def trigger(self) -> None:
        """Trigger by software; the projector's signal does otherwise."""
        if not self._hardware:
            for camera in self._cameras.values():
                camera.remote_device.node_map.TriggerSoftware.execute()

    def fetch(self, timeout_s: float) -> dict[str, Taken]:
        """One buffer of each camera, copied before it is given back."""
        from genicam.gentl import TimeoutException

        taken = {}
        for name, camera in self._cameras.items():
            try:
                with camera.fetch(timeout=timeout_s) as buffer:
                    part = buffer.payload.components[0]
                    frame = np.array(part.data).reshape(part.height, part.width)
                    taken[name] = Taken(frame, int(buffer._buffer.frame_id))
            except TimeoutException:
                raise Dropped(f"{name} camera: found no picture within {timeout_s:g} s, expected one") from None
        return taken

    def close(self) -> None:
        """Stop all cameras and give them back."""
        for camera in self._cameras.values():
            camera.stop()
            camera.destroy()
        self._harvester.reset()


def open_cameras(producer: str, serials: dict[str, str], hardware: bool) -> HarvesterCameras:
    """Cameras of a producer file."""
    from importlib.util import find_spec

    if find_spec("harvesters") is None:
        raise UsageError("capture: found no harvesters, expected it installed: pip install flushline[capture]")
    if not Path(producer).is_file():
        raise UsageError(f"--cameras: found no file {producer!r}, expected a GenTL producer (.cti)")
    return HarvesterCameras(Path(producer), serials, hardware)
