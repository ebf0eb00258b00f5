"""One scan: exposures found, every pattern shown and taken, checked, and written as a scene folder.

Nothing is on the disk under the scene's name before all of it is: frames are written into a hidden folder beside it,
scene.json last, and the folder is renamed.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flows.capture.devices import Cameras, CaptureError, Dropped, Screen, Taken
from metrology.errors import SceneError
from metrology.exposure_choice import best_exposures
from metrology.fringe import FringeCode
from metrology.reconstruct import coordinate_size, decode
from metrology.results import SceneKey
from metrology.rig import Rig
from metrology.saturation import saturation_level
from storage.frames import Frame
from storage.scene import load_scene, write_scene
from tasks.scan_checks import check_frames, refuse_wrong_frames
from tasks.settings import SceneChecks

_ATTEMPTS = 3
_TIMEOUT_S = 5.0
_MOST_PICTURES = 12  # to find an exposure
_SATURATED = 0.98
_MOST_SATURATED = 0.002


@dataclass(frozen=True)
class Order:
    """What to take."""

    key: SceneKey
    rig: Rig
    code: FringeCode
    exposures_ms: tuple[float, ...] = ()
    """Empty: found by pictures of the skin."""
    start_ms: float = 10.0
    """Where the search begins."""
    operator: str | None = None


def capture(
    folder: Path, order: Order, cameras: Cameras, screen: Screen, say: Callable[[str], None] = print
) -> tuple[float, ...]:
    """Take a scan and write its folder; returns the exposure times, ms."""
    if folder.exists():
        raise SceneError(f"{folder}: found it there already, expected a new folder")
    projector = order.rig.with_projector()
    patterns = np.rint(255 * order.code.patterns(projector.width, projector.height)).astype(np.uint8)
    shot = _Shots(cameras, screen, say)
    exposures = order.exposures_ms or find_exposures(shot, (projector.height, projector.width), order.start_ms)
    say(f"exposures: {', '.join(f'{time:.3g}' for time in exposures)} ms")
    taken: dict[str, list[Frame]] = {}
    for exposure in exposures:
        shot.expose(exposure)
        for number, pattern in enumerate(patterns, start=1):
            for name, picture in shot.take(pattern, f"pattern {number} of {len(patterns)}").items():
                taken.setdefault(name, []).append(picture.frame)
    frames = {
        name: np.stack(of_camera).reshape(len(exposures), len(patterns), *of_camera[0].shape)
        for name, of_camera in taken.items()
    }
    _check_sizes(frames, order.rig)
    _write(folder, order, exposures, frames)
    return exposures


class _Shots:
    """Shows and takes; what was dropped is taken again, and said."""

    def __init__(self, cameras: Cameras, screen: Screen, say: Callable[[str], None]) -> None:
        self._cameras, self._screen, self._say = cameras, screen, say
        self._last: dict[str, int] = {}

    def take(self, pattern: NDArray[np.uint8], what: str) -> dict[str, Taken]:
        """One picture of a pattern by every camera."""
        problem: Dropped | None = None
        for _ in range(_ATTEMPTS):
            self._screen.show(pattern)
            self._cameras.trigger()
            try:
                return self._in_turn(self._cameras.fetch(_TIMEOUT_S))
            except Dropped as dropped:
                problem = dropped
                self._say(f"{what} is taken again: {dropped}")
        raise CaptureError(f"{what}: {problem}; tried {_ATTEMPTS} times")

    def expose(self, milliseconds: float) -> None:
        """Expose the pictures that follow so long."""
        self._cameras.set_exposure(milliseconds)

    def _in_turn(self, taken: dict[str, Taken]) -> dict[str, Taken]:
        """Pictures whose numbers follow the last ones; Dropped where some are missing between or come twice."""
        late = {name: one.number - self._last.get(name, one.number - 1) for name, one in taken.items()}
        self._last |= {name: one.number for name, one in taken.items()}
        for name, step in late.items():
            if step != 1:
                found = f"{step - 1} pictures lost" if step > 1 else "an older picture again"
                raise Dropped(f"{name} camera: found {found}, expected the next one")
        return taken


def find_exposures(shot: _Shots, size: tuple[int, int], start_ms: float) -> tuple[float, ...]:
    """Exposure times that cover the skin's brightness, from pictures under full light and none."""
    white, black = np.full(size, 255, np.uint8), np.zeros(size, np.uint8)
    exposure = start_ms
    for _ in range(_MOST_PICTURES):
        shot.expose(exposure)
        pixels = _shares(shot.take(white, "white"))
        saturated = float((pixels >= _SATURATED).mean())
        if saturated > _MOST_SATURATED:
            exposure /= 8.0 if saturated > 0.5 else 2.0
        elif np.quantile(pixels, 0.998) < 0.3:
            exposure *= 2.0
        else:
            found = best_exposures(pixels, _shares(shot.take(black, "black")), exposure)
            if found:
                return found
            break
    raise CaptureError(
        f"found no exposure that lights the skin, {exposure:.3g} ms at last, expected a lit skin before the cameras; "
        "--exposures gives them"
    )


def _shares(taken: dict[str, Taken]) -> NDArray[np.float64]:
    """Every fourth pixel of all cameras, as shares of their range."""
    parts = []
    for one in taken.values():
        full = saturation_level(one.frame[None, None])
        parts.append(one.frame[::4, ::4].ravel() / (full * 255 / 254))
    return np.concatenate(parts)


def _check_sizes(frames: dict[str, NDArray], rig: Rig) -> None:
    for name, stack in frames.items():
        device = rig.cameras[name]
        if stack.shape[2:] != (device.height, device.width):
            raise CaptureError(
                f"{name} camera: found pictures of {stack.shape[3]}×{stack.shape[2]}, expected "
                f"{device.width}×{device.height} as rig {rig.id!r} has"
            )


def _write(folder: Path, order: Order, exposures: Sequence[float], frames: dict[str, NDArray]) -> None:
    """The scene's folder, whole or not at all."""
    hidden = folder.with_name(f".{folder.name}.capturing")
    shutil.rmtree(hidden, ignore_errors=True)
    try:
        write_scene(
            hidden,
            order.key,
            order.rig.id,
            order.code,
            exposures,
            frames["left"],
            frames.get("right"),
            operator=order.operator,
        )
        _refuse_wrong(hidden, order.rig, frames)
        hidden.rename(folder)
    except OSError as problem:
        raise CaptureError(
            f'{folder}: found "{problem.strerror}", expected room and leave to write; nothing was kept'
        ) from None
    finally:
        shutil.rmtree(hidden, ignore_errors=True)


def _refuse_wrong(folder: Path, rig: Rig, frames: dict[str, NDArray]) -> None:
    """Refuse frames that are not what was shown: another order, a repeated or a dark one."""
    scene = load_scene(folder)
    size = coordinate_size(rig, scene.code)
    checked = []
    for camera in scene.used(rig):
        view = decode(frames[camera], scene.code, size, scene.exposures)
        checked.append(check_frames(camera, frames[camera], view, scene, rig))
    refuse_wrong_frames(scene, checked, SceneChecks())
