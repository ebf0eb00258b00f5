"""Scene folders (`flushline-scene/1`): the manifest, its frames, and how a folder is written."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PlainSerializer, PlainValidator, model_validator

from metrology.errors import SceneError
from metrology.exposures import MAX_RATIO, relative_exposures
from metrology.fringe import FringeCode, GrayCode
from metrology.results import SceneKey
from metrology.rig import Device, Rig
from storage import scan_identity
from storage.documents import check_format, read_json, utc_text
from storage.frames import Frame, FrameHeader, FrameStack, file_checksum, read_header, read_stack, write_frame
from storage.models import Identifier, InnerPath, Line, PositiveNumber, StrictModel, UtcTime, WholeNumber, validate

FORMAT = "flushline-scene/1"
MANIFEST = "scene.json"
MAX_MANIFEST_BYTES = 2**20
MAX_EXPOSURES, MAX_FRAMES = 64, 4096
Camera = Literal["left", "right"]
Item = TypeVar("Item")
CAMERAS: tuple[Camera, ...] = ("left", "right")


def _steps(value: object) -> int | tuple[int, ...]:
    """One number for all counts, or one per count."""
    several = isinstance(value, list | tuple)
    numbers = tuple(one for one in (value if isinstance(value, list | tuple) else [value]) if type(one) is int)
    if len(numbers) != (len(value) if isinstance(value, list | tuple) else 1):
        raise ValueError("valid integers" if several else "a valid integer")
    return numbers if several else numbers[0]


Steps = Annotated[int | tuple[int, ...], PlainValidator(_steps), PlainSerializer(lambda steps: steps)]


class GrayModel(StrictModel):
    """`fringe.gray` of scene.json: Gray-code frames after the fringes."""

    stripes: WholeNumber
    inverse: bool = False
    references: bool = False
    first: Literal["msb", "lsb"] = "msb"
    inverse_first: bool = False
    shift: float = 0.0


class FringeModel(StrictModel):
    """`fringe` of scene.json."""

    axis: Literal["x", "y"]
    steps: Steps = 0
    counts: tuple[WholeNumber, ...] = ()
    periods_px: tuple[WholeNumber, ...] = ()
    size_px: WholeNumber | None = None
    direction: Literal[1, -1] = 1
    phase_offset_rad: tuple[float, ...] | float = 0.0
    gray: GrayModel | None = None

    @property
    def code(self) -> FringeCode:
        """What the projector showed, its frames in Flushline's order."""
        gray = (
            GrayCode(self.gray.stripes, self.gray.inverse, self.gray.references, self.gray.shift) if self.gray else None
        )
        counts, size, offset = self.counts, self.size_px, self.phase_offset_rad
        if self.periods_px:
            if counts or size is not None or min(self.periods_px) < 1:
                raise SceneError(
                    "fringe: found periods_px with counts, size_px or periods below 1, expected them alone"
                )
            size = math.lcm(*self.periods_px)
            counts = tuple(size // period for period in self.periods_px)
        offsets = offset if isinstance(offset, tuple) else (offset,) * len(counts)
        return FringeCode(self.axis, self.steps, counts, gray, offsets, size)

    def ordered(self, frames: Sequence[Item]) -> tuple[Item, ...]:
        """One exposure's frames, listed as they were shown, in Flushline's order: steps forward, bits from the top."""
        code = self.code
        order: list[int] = []
        for k, steps in enumerate(code.step_counts):
            first = sum(code.step_counts[:k])
            order += [first + (self.direction * step) % steps for step in range(steps)]
        if code.gray:
            per_bit = 2 if code.gray.inverse else 1
            bits = list(range(code.gray.bits))
            for bit in bits if self.gray and self.gray.first == "msb" else bits[::-1]:
                pair = [code.fringe_frames + per_bit * bit + i for i in range(per_bit)]
                order += pair[::-1] if self.gray and self.gray.inverse_first else pair
            order += range(code.fringe_frames + code.gray.stripe_frames, code.frames)
        return tuple(frames[place] for place in order)


Exposures = Annotated[
    tuple[Annotated[tuple[InnerPath, ...], Field(max_length=MAX_FRAMES)], ...], Field(max_length=MAX_EXPOSURES)
]


class FramesModel(StrictModel):
    """`frames` of scene.json: paths per exposure, count-major, then step; no right ones where there is one camera."""

    left: Exposures
    right: Exposures = ()

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The cameras that there are, left first."""
        return CAMERAS if self.right else CAMERAS[:1]


class ScanModel(StrictModel):
    """What scene.json says of every kind of scan."""

    aircraft_serial: Identifier
    panel: Identifier
    station: Identifier
    captured_at: UtcTime
    rig: Identifier
    operator: Line | None = None

    @property
    def key(self) -> SceneKey:
        """Which scene it is."""
        return SceneKey(self.aircraft_serial, self.panel, self.station, self.captured_at)


class SceneModel(ScanModel):
    """scene.json of fringe frames."""

    format: Literal["flushline-scene/1"]
    fringe: FringeModel
    exposures: Annotated[tuple[PositiveNumber, ...], Field(min_length=1, max_length=MAX_EXPOSURES)]
    frames: FramesModel

    @property
    def files(self) -> list[str]:
        """The frames of both cameras."""
        return [path for camera in CAMERAS for frames in getattr(self.frames, camera) for path in frames]

    def digest(self, folder: Path) -> str:
        """The digest that an inspection would give, see `storage.scan_identity`; nothing is decoded."""
        left, right = (
            [
                file_checksum(folder / path, SceneError)
                for paths in getattr(self.frames, camera)
                for path in self.fringe.ordered(paths)
            ]
            for camera in CAMERAS
        )
        return scan_identity.frames_digest(self.fringe.code, self.exposures, left, right)

    def own_rig(self, folder: Path) -> Rig | None:
        """None: the store has the rigs of frames."""
        return None

    @model_validator(mode="after")
    def _frames_are_complete(self) -> SceneModel:
        code = self.fringe.code
        if len(set(self.exposures)) != len(self.exposures):
            raise ValueError(f"found exposures {list(self.exposures)}, expected each only once")
        shortest, longest = min(self.exposures), max(self.exposures)
        if longest > MAX_RATIO * shortest:
            raise ValueError(
                f"found exposures from {shortest:g} to {longest:g}, expected the longest at most {MAX_RATIO:,.0f} "
                "times the shortest"
            )
        for camera in self.frames.cameras:
            exposures = getattr(self.frames, camera)
            if len(exposures) != len(self.exposures):
                raise ValueError(
                    f"found frames.{camera} for {len(exposures)} exposures, expected {len(self.exposures)}"
                )
            for index, frames in enumerate(exposures):
                if len(frames) != code.frames:
                    raise ValueError(
                        f"found {len(frames)} frames in frames.{camera}.{index}, expected {code.frames} "
                        f"({_told(code)}" + (f" + {code.gray.frames} of Gray code)" if code.gray else ")")
                    )
        seen: set[str] = set()
        for path in self.files:
            if path in seen:
                raise ValueError(f"found frame {path!r} listed more than once, expected each frame once")
            seen.add(path)
        return self


@dataclass(frozen=True)
class Scene:
    """A scene folder whose manifest is sound and whose frames are all there, whole and of one kind.

    Attributes
    ----------
    folder : Path
    key : SceneKey
    rig_id : str
        The calibration that was valid at capture.
    operator : str or None
    code : FringeCode
    exposures : tuple of float
        Relative exposure times.
    left, right : tuple of Path
        Frames, exposure-major.
    left_header : FrameHeader
        What all frames of a camera have in common.
    right_header : FrameHeader or None
        None where there is one camera, which then has no frames in `right`.
    files_state : str or None
        Names the folder's files as they lay on disk when they were looked at (see `storage.scan_identity`).
    """

    folder: Path
    key: SceneKey
    rig_id: str
    operator: str | None
    code: FringeCode
    exposures: tuple[float, ...]
    left: tuple[Path, ...]
    right: tuple[Path, ...]
    left_header: FrameHeader
    right_header: FrameHeader | None
    files_state: str | None = None

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
        paths, header = getattr(self, camera), self.headers[camera]
        stack = read_stack(paths, header, SceneError, executor)
        shape = (len(self.exposures), self.code.frames, header.height, header.width)
        return FrameStack(stack.frames.reshape(shape), stack.checksums)

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
        found = "an empty folder" if not any(folder.iterdir()) else f"no {MANIFEST} in it"
        raise SceneError(f"{folder}: found {found}, expected a scene folder")
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


def scan_document(format_name: str, key: SceneKey, rig_id: str, operator: str | None) -> dict[str, Any]:
    """What scene.json says of every kind of scan, see `ScanModel`."""
    return {
        "format": format_name,
        "aircraft_serial": key.aircraft_serial,
        "panel": key.panel,
        "station": key.station,
        "captured_at": utc_text(key.captured_at),
        "rig": rig_id,
        **({"operator": operator} if operator else {}),
    }


def fringe_document(code: FringeCode) -> dict[str, Any]:
    """`fringe` of scene.json for frames in Flushline's order; what is usual is left out."""
    steps = list(code.steps) if isinstance(code.steps, tuple) else code.steps
    document: dict[str, Any] = {"axis": code.axis, "steps": steps, "counts": list(code.counts)}
    if code.phase_offsets_rad:
        document["phase_offset_rad"] = list(code.phase_offsets_rad)
    if code.size_px is not None:
        document["size_px"] = code.size_px
    if gray := code.gray:
        document["gray"] = {"stripes": gray.stripes, "inverse": gray.inverse}
        document["gray"] |= {"references": True} if gray.references else {}
        document["gray"] |= {"shift": gray.shift} if gray.shift else {}
    return document


def _told(code: FringeCode) -> str:
    """How many frames the fringes take, in words."""
    if isinstance(code.steps, int):
        return f"{len(code.counts)} counts × {code.steps} steps"
    return " + ".join(map(str, code.step_counts)) + " steps"


def _common_header(paths: Sequence[Path]) -> FrameHeader:
    """The header that all frames of a camera share."""
    first = read_header(paths[0], SceneError)
    for path in paths[1:]:
        header = read_header(path, SceneError)
        if header != first:
            raise SceneError(f"{path}: found {header}, expected {first} as {paths[0].name} has")
    return first
