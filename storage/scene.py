"""Scene folders (`flushline-scene/1`): the manifest, its frames, and how a folder is written."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrology.binary_code import gray_from_binary
from metrology.errors import SceneError
from metrology.exposures import relative_exposures
from metrology.fringe import FringeCode
from metrology.results import SceneKey
from metrology.rig import Device, Rig
from storage import scan_identity
from storage.documents import check_format, read_json
from storage.frames import Frame, FrameHeader, FrameStack, read_header, read_stack, write_frame
from storage.models import validate
from storage.scene_models import (
    CAMERAS,
    FORMAT,
    MANIFEST,
    MAX_MANIFEST_BYTES,
    Camera,
    SceneModel,
    fringe_document,
    scan_document,
)


@dataclass(frozen=True)
class Scene:
    """A scene folder whose manifest is sound and whose frames are all there, whole and of one kind."""

    folder: Path
    key: SceneKey
    rig_id: str
    """The calibration that was valid at capture."""
    operator: str | None
    code: FringeCode
    exposures: tuple[float, ...]
    """Relative exposure times."""
    left: tuple[Path, ...]
    right: tuple[Path, ...]
    """left, right: frames, exposure-major."""
    left_header: FrameHeader
    """What all frames of a camera have in common."""
    right_header: FrameHeader | None
    """None where there is one camera, which then has no frames in `right`."""
    files_state: str | None = None
    """Names the folder's files as they lay on disk when they were looked at (see `storage.scan_identity`)."""
    binary: bool = False
    """Whether the stripes on disk count in plain binary; `read` gives those of Gray code."""

    @property
    def headers(self) -> dict[Camera, FrameHeader]:
        """Of the cameras that there are, left first."""
        left: dict[Camera, FrameHeader] = {"left": self.left_header}
        return left if self.right_header is None else left | {"right": self.right_header}

    def own_rig(self) -> Rig | None:
        """None: the store has the rigs of frames."""
        return None

    def used(self, rig: Rig) -> tuple[Camera, ...]:
        """The cameras whose frames a rig measures with; one measures with the projector."""
        return tuple(camera for camera in self.headers if camera in rig.cameras)

    def frames(self, camera: Camera, executor: Executor | None = None) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Decode one camera's frames.

        Returns
        -------
        (exposures, frames, h, w) ndarray of uint8 or uint16
            Frames count-major, then step; then Gray code.
        """
        return self.read(camera, executor).frames

    def read(self, camera: Camera, executor: Executor | None = None) -> FrameStack:
        """Decode one camera's frames, shaped as `frames` has them, with the checksums of their files."""
        if camera not in self.headers:
            raise SceneError(
                f"{self.folder / MANIFEST}: found no frames of the {camera} camera, expected both cameras'"
            )
        paths, header = getattr(self, camera), self.headers[camera]
        stack = read_stack(paths, header, SceneError, executor)
        shape = (len(self.exposures), self.code.frames, header.height, header.width)
        frames = stack.frames.reshape(shape)
        return FrameStack(gray_from_binary(frames, self.code) if self.binary else frames, stack.checksums)

    def check_fits(self, rig: Rig) -> None:
        """Refuse a rig whose cameras have other sizes than the frames, or whose projector cannot show the fringes."""
        if rig.projector:
            self._check_projector(rig.projector, rig.id)
        used = self.used(rig)
        if len(used) == 1 and rig.projector is None:
            raise SceneError(
                f"{self.folder / MANIFEST}: found one camera to measure with, expected the projector's calibration in "
                f"rig {rig.id!r}, or a second camera in rig and scene"
            )
        for camera in used:
            header, device = self.headers[camera], rig.cameras[camera]
            if (header.width, header.height) != (device.width, device.height):
                raise SceneError(
                    f"{getattr(self, camera)[0]}: found {header.width}×{header.height} pixels, "
                    f"expected {device.width}×{device.height} as the {camera} camera of rig {rig.id!r} has"
                    f"{self._likely_mix_up(rig)}"
                )

    def _check_projector(self, projector: Device, rig_id: str) -> None:
        size = self.code.size_px or self.code.size(projector.width, projector.height)
        finest = max(self.code.counts, default=0)
        if 2 * finest > size:  # fewer than two pixels per fringe: a coarser one would show (Nyquist)
            raise SceneError(
                f"{self.folder / MANIFEST}: found {finest} fringes, expected at most {size // 2} across the {size} "
                f"pixels of the projector of rig {rig_id!r}"
            )

    def _likely_mix_up(self, rig: Rig) -> str:
        """What the frames' sizes tell of how they came not to fit a rig."""
        found = [(header.width, header.height) for header in self.headers.values()]
        wanted = [(device.width, device.height) for device in rig.cameras.values()]
        if found == wanted[::-1]:
            return "; they fit when left and right are exchanged"
        shares = {
            side / other
            for size, device in zip(found, wanted, strict=False)
            for side, other in zip(size, device, strict=True)
        }
        if max(shares) - min(shares) < 0.005 and max(shares) != 1:
            return f"; they are {max(shares):.3g} times the size of the images that the rig was calibrated with"
        turned = any(size == device[::-1] != device for size, device in zip(found, wanted, strict=False))
        return "; they fit when turned by 90°" if turned else ""


def load_scene(folder: Path) -> Scene:
    """Read a scene's manifest and look at every frame's header; nothing is decoded yet."""
    folder = Path(folder)
    return look_at(folder, load_manifest(folder / MANIFEST))


def look_at(folder: Path, model: SceneModel) -> Scene:
    """The scene of a manifest; every frame's header is looked at."""
    paths = {
        camera: tuple(
            folder / path for frames in getattr(model.frames, camera) for path in model.fringe.ordered(frames)
        )
        for camera in CAMERAS
    }
    # Before anything is read: what changes from now on shows.
    state = scan_identity.files_state(folder, [MANIFEST, *model.files])
    left, right = (_common_header(paths[camera]) if paths[camera] else None for camera in CAMERAS)
    assert left is not None
    if right and left.bits != right.bits:
        raise SceneError(
            f"{paths['right'][0]}: found {right.bits} bit, expected {left.bits} as the left camera's frames have"
        )
    return Scene(
        folder=folder,
        key=model.key,
        rig_id=model.rig,
        operator=model.operator,
        code=model.fringe.code,
        exposures=relative_exposures(model.exposures),
        left=paths["left"],
        right=paths["right"],
        left_header=left,
        right_header=right,
        files_state=state,
        binary=bool(model.fringe.gray and model.fringe.gray.binary),
    )


def load_manifest(manifest: Path) -> SceneModel:
    """scene.json of fringe frames, validated; the frames are not looked at."""
    return model_of(read_manifest(manifest), manifest)


def model_of(document: dict[str, Any], manifest: Path) -> SceneModel:
    """What scene.json of fringe frames says, validated."""
    check_format(document, FORMAT, manifest, SceneError)
    return validate(SceneModel, document, manifest, SceneError)


def read_manifest(manifest: Path) -> dict[str, Any]:
    """scene.json of any kind."""
    folder = manifest.parent
    if not folder.is_dir():
        found = "a file" if folder.is_file() else "a link to nowhere" if folder.is_symlink() else "no such folder"
        raise SceneError(f"{folder}: found {found}, expected a scene folder")
    if not os.path.lexists(manifest):
        empty = not any(folder.iterdir())
        found = "an empty folder" if empty else f"no {MANIFEST} in it"
        how = "" if empty else "; of a folder of frames, flushline scene guess says how to make one"
        raise SceneError(f"{folder}: found {found}, expected a scene folder{how}")
    return read_json(manifest, SceneError, MAX_MANIFEST_BYTES)


def write_scene(
    folder: Path,
    key: SceneKey,
    rig_id: str,
    code: FringeCode,
    exposures: Sequence[float],
    left: Frame,
    right: Frame | None,
    truth: dict[str, Any] | None = None,
    operator: str | None = None,
) -> None:
    """Write a scene folder; scene.json comes last, so a folder with one is complete.

    Parameters
    ----------
    left, right : (exposures, frames, h, w) ndarray of uint8 or uint16
        No right ones where there is one camera.
    truth : dict, optional
        Written to truth.json beside it.
    """
    stacks = {camera: stack for camera, stack in (("left", left), ("right", right)) if stack is not None}
    shown = [f"c{count}_s{step}" for count, step in zip(code.count_of, code.step_of, strict=True)]
    shown += [f"gray{k}" for k in range(code.gray.frames if code.gray else 0)]
    names: dict[str, list[list[str]]] = {
        camera: [[f"{camera}/e{e}_{frame}.png" for frame in shown] for e in range(len(exposures))] for camera in stacks
    }
    fringe = fringe_document(code)
    document = {
        **scan_document(FORMAT, key, rig_id, operator),
        "fringe": fringe,
        "exposures": list(exposures),
        "frames": names,
    }
    manifest = folder / MANIFEST
    validate(SceneModel, document, manifest, SceneError)
    manifest.unlink(missing_ok=True)
    for camera, stack in stacks.items():
        (folder / camera).mkdir(parents=True, exist_ok=True)
        for exposure_names, frames in zip(names[camera], stack, strict=True):
            for name, frame in zip(exposure_names, frames, strict=True):
                write_frame(folder / name, frame)
    if truth is not None:
        (folder / "truth.json").write_text(json.dumps(truth), encoding="utf-8")
    manifest.write_text(json.dumps(document, indent=1, ensure_ascii=False), encoding="utf-8")


def _common_header(paths: Sequence[Path]) -> FrameHeader:
    """The header that all frames of a camera share."""
    first = read_header(paths[0], SceneError)
    for path in paths[1:]:
        header = read_header(path, SceneError)
        if header != first:
            raise SceneError(f"{path}: found {header}, expected {first} as {paths[0].name} has")
    return first
