"""Calibration captures (`flushline-calibration/1`): the board, what the projector showed, the pictures of each pose."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, field_validator, model_validator

from metrology.calibration.board import Board, BoardKind
from metrology.calibration.projected_dots import ProjectedDots
from metrology.errors import CalibrationError
from metrology.fringe import Axis, FringeCode
from storage.certificate import CertificateModel
from storage.documents import check_format, read_json, utc_text
from storage.frames import FrameHeader, read_frame, read_header, read_stack, write_frame
from storage.models import Identifier, InnerPath, StrictModel, UtcTime, WholeNumber, validate
from storage.scene_models import CAMERAS, Camera, FringeModel

FORMAT = "flushline-calibration/1"
MANIFEST = "calibration.json"
GreyFrame = NDArray[np.uint8] | NDArray[np.uint16]


class BoardModel(StrictModel):
    """`board`: what is printed on the plate, in mm, and the certificate of its sizes."""

    type: BoardKind
    cols: WholeNumber
    rows: WholeNumber
    spacing_mm: float
    dot_diameter_mm: float | None = None
    marker_mm: float | None = None
    dictionary: str | None = None
    certificate: CertificateModel | None = None


class DotsModel(StrictModel):
    """`projector.dots`: the projected dot grid, in projector pixels."""

    type: Literal["asymmetric_circles"]
    cols: WholeNumber
    rows: WholeNumber
    spacing_px: float
    origin_px: tuple[float, float]
    diameter_px: float
    marker_diameter_px: float
    markers: tuple[tuple[WholeNumber, WholeNumber], ...]


class FringesModel(StrictModel):
    """`projector.fringe`: the codes shown in both axes in place of dots, each written as a scene's `fringe`."""

    x: FringeModel
    y: FringeModel

    @field_validator("x", "y", mode="before")
    @classmethod
    def _axis_follows_from_the_place(cls, value: Any, info: ValidationInfo) -> Any:
        return {"axis": info.field_name, **value} if isinstance(value, dict) else value


class ProjectorModel(StrictModel):
    """`projector`: its size, and the dots or the fringes it showed."""

    width: Annotated[WholeNumber, Field(gt=0)]
    height: Annotated[WholeNumber, Field(gt=0)]
    dots: DotsModel | None = None
    fringe: FringesModel | None = None


class FringePathsModel(StrictModel):
    """Fringe frames of one pose and camera, count-major, then step."""

    x: tuple[InnerPath, ...]
    y: tuple[InnerPath, ...]


class CameraPoseModel(StrictModel):
    """One camera's pictures of one pose."""

    white: InnerPath | None = None
    dark: InnerPath | None = None
    dots: InnerPath | None = None
    fringes: FringePathsModel | None = None

    @model_validator(mode="after")
    def _shows_the_board(self) -> CameraPoseModel:
        if self.white is None and self.fringes is None:
            raise ValueError("found no white frame, expected one, or fringes whose mean shows the board")
        return self


class PoseModel(StrictModel):
    """One pose of the board; a capture of one camera has no right one."""

    left: CameraPoseModel
    right: CameraPoseModel | None = None


class CaptureModel(StrictModel):
    """calibration.json."""

    format: Literal["flushline-calibration/1"]
    units: Literal["mm"] = "mm"
    captured_at: UtcTime | None = None
    due_at: UtcTime | None = None
    rig: Identifier | None = None
    board: BoardModel
    projector: ProjectorModel
    poses: Annotated[tuple[PoseModel, ...], Field(min_length=1)]

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The cameras that took it."""
        return CAMERAS if self.poses[0].right else CAMERAS[:1]

    @model_validator(mode="after")
    def _frames_match_the_patterns(self) -> CaptureModel:
        for index, pose in enumerate(self.poses):
            if (pose.right is None) != (self.poses[0].right is None):
                raise ValueError(
                    f"found poses.{index} with other cameras than poses.0, expected the same in every pose"
                )
            for camera in self.cameras:
                frames: CameraPoseModel = getattr(pose, camera)
                place = f"poses.{index}.{camera}"
                if frames.dots and not self.projector.dots:
                    raise ValueError(
                        f"found a dots frame in {place} but no projector.dots, expected the dots' description"
                    )
                if not frames.fringes:
                    continue
                if not self.projector.fringe:
                    raise ValueError(f"found fringes in {place} but no projector.fringe, expected steps and counts")
                for axis in ("x", "y"):
                    code = getattr(self.projector.fringe, axis)
                    found, expected = len(getattr(frames.fringes, axis)), code.code.frames
                    if found != expected:
                        raise ValueError(f"found {found} frames in {place}.fringes.{axis}, expected {expected}")
        return self


@dataclass(frozen=True)
class PoseImages:
    """One camera's pictures of one pose, decoded from their files."""

    white: GreyFrame
    """(h, w) uint8 or uint16: projector white all over; the fringe frames' mean where it was not captured."""
    dark: GreyFrame | None
    dots: GreyFrame | None
    """dark, dots: (h, w) or None: projector black; projected dots."""
    fringes: dict[Axis, GreyFrame]
    """mapping of axis to (frames, h, w) array: count-major, then step; empty where none were shown."""


@dataclass(frozen=True)
class CalibrationCapture:
    """A calibration capture whose manifest is sound and whose frames are all there, whole and of one kind."""

    folder: Path
    board: Board
    projector_size: tuple[int, int]
    """(width, height)."""
    dots: ProjectedDots | None
    codes: dict[Axis, FringeCode]
    """Empty where no fringes were shown."""
    model: CaptureModel
    """The manifest itself."""
    headers: dict[Camera, FrameHeader]
    """What all frames of a camera have in common."""

    def __len__(self) -> int:
        return len(self.model.poses)

    def images(self, pose: int, camera: Camera, executor: Executor | None = None) -> PoseImages:
        """Decode one camera's pictures of one pose."""
        frames: CameraPoseModel = getattr(self.model.poses[pose], camera)
        header = self.headers[camera]

        def read(path: str | None) -> GreyFrame | None:
            return read_frame(self.folder / path, header, CalibrationError) if path else None

        fringes: dict[Axis, GreyFrame] = {}
        if frames.fringes:
            for axis in self.codes:
                shown: FringeModel = getattr(self.model.projector.fringe, axis)
                paths = [self.folder / path for path in shown.ordered(getattr(frames.fringes, axis))]
                stack = read_stack(paths, header, CalibrationError, executor).frames
                fringes[axis] = shown.as_gray_code(stack[None])[0]
        white = read(frames.white)
        if white is None:
            white = np.rint(np.mean([stack.mean(0) for stack in fringes.values()], axis=0)).astype(header.dtype)
        return PoseImages(white, read(frames.dark), read(frames.dots), fringes)


def load_capture(folder: Path) -> CalibrationCapture:
    """Read a capture's manifest (its folder, or the file itself) and look at every frame's header."""
    folder = Path(folder)
    manifest = folder / MANIFEST if folder.is_dir() else folder
    folder = manifest.parent
    document = read_json(manifest, CalibrationError)
    check_format(document, FORMAT, manifest, CalibrationError)
    return capture_of(folder, validate(CaptureModel, document, manifest, CalibrationError), manifest)


def capture_of(folder: Path, model: CaptureModel, source: Path) -> CalibrationCapture:
    """The capture that a manifest describes; every frame's header is looked at. `source` names it in errors."""
    board, dots, fringe = model.board, model.projector.dots, model.projector.fringe
    try:
        return CalibrationCapture(
            folder=folder,
            board=Board(kind=board.type, **board.model_dump(exclude={"type", "certificate"})),
            projector_size=(model.projector.width, model.projector.height),
            dots=ProjectedDots(**dots.model_dump(exclude={"type"})) if dots else None,
            codes={"x": fringe.x.code, "y": fringe.y.code} if fringe else {},
            model=model,
            headers={camera: _camera_header(folder, model, camera) for camera in model.cameras},
        )
    except CalibrationError as problem:
        text = str(problem)
        raise CalibrationError(text if text.startswith(str(folder)) else f"{source}: {text}") from None


def write_capture(
    folder: Path,
    rig_id: str,
    captured_at: datetime,
    board: Mapping[str, Any],
    projector: Mapping[str, Any],
    poses: Sequence[Mapping[str, Mapping[str, GreyFrame]]],
) -> None:
    """Write a capture folder; calibration.json comes last, so a folder with one is complete.

    Parameters
    ----------
    board, projector : mapping
        As calibration.json has them.
    poses : sequence of mapping
        Frames by camera and name: white, dark, dots (h, w); or fringes_x, fringes_y (frames, h, w) in place of dots.
    """
    manifest = folder / MANIFEST
    document = {
        "format": FORMAT,
        "units": "mm",
        "captured_at": utc_text(captured_at),
        "rig": rig_id,
        "board": dict(board),
        "projector": dict(projector),
        "poses": [
            {camera: _frame_names(f"pose{k:02d}_{camera}", pose[camera]) for camera in CAMERAS}
            for k, pose in enumerate(poses)
        ],
    }
    validate(CaptureModel, document, manifest, CalibrationError)
    folder.mkdir(parents=True, exist_ok=True)
    manifest.unlink(missing_ok=True)
    for k, pose in enumerate(poses):
        for camera in CAMERAS:
            for name, frames in pose[camera].items():
                stem = f"pose{k:02d}_{camera}_{name}"
                if frames.ndim == 2:
                    write_frame(folder / f"{stem}.png", frames)
                else:
                    for i, frame in enumerate(frames):
                        write_frame(folder / f"{stem}_{i:02d}.png", frame)
    manifest.write_text(json.dumps(document, indent=1, ensure_ascii=False), encoding="utf-8")


def _frame_names(stem: str, frames: Mapping[str, GreyFrame]) -> dict[str, Any]:
    """One camera's part of a pose in calibration.json."""
    single = {name: f"{stem}_{name}.png" for name, frame in frames.items() if frame.ndim == 2}
    fringes = {
        name.removeprefix("fringes_"): [f"{stem}_{name}_{i:02d}.png" for i in range(len(stack))]
        for name, stack in frames.items()
        if stack.ndim == 3
    }
    return single | ({"fringes": fringes} if fringes else {})


def _camera_header(folder: Path, model: CaptureModel, camera: Camera) -> FrameHeader:
    """The header that all frames of a camera share."""
    first: FrameHeader | None = None
    for pose in model.poses:
        frames: CameraPoseModel = getattr(pose, camera)
        fringes = (*frames.fringes.x, *frames.fringes.y) if frames.fringes else ()
        for name in (frames.white, frames.dark, frames.dots, *fringes):
            if name is None:
                continue
            header = read_header(folder / name, CalibrationError)
            first = first or header
            if header != first:
                raise CalibrationError(
                    f"{folder / name}: found {header}, expected {first} as the frames before it have"
                )
    if first is None:
        raise CalibrationError(f"{folder}: found no frames of the {camera} camera, expected some")
    return first
