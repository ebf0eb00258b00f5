"""Calibration captures of other programs: which picture of which pose each file is, by names and running order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from metrology.calibration.board import Board
from metrology.errors import CalibrationError, SceneError
from metrology.fringe import Axis
from storage.calibration import FORMAT, CalibrationCapture, CaptureModel, capture_of
from storage.models import validate
from storage.scene_models import Camera, FringeModel
from storage.scene_names import Values, as_grey, cameras_of, matching, natural

AXES: tuple[Axis, ...] = ("x", "y")
_OTHERS = ("white", "black", "skip")


def named_capture(
    folder: Path,
    pattern: str,
    board: Board,
    projector_size: tuple[int, int],
    shown: Mapping[Axis, FringeModel],
    sequence: Sequence[str] = (),
    left: str | None = None,
) -> tuple[CalibrationCapture, list[str]]:
    """A capture of one camera or two whose frames run through in each pose, and notes about the files.

    Parameters
    ----------
    pattern : str
        Such as ``{camera}/pose{pose}/{frame}.png``; without {camera} there is one camera.
    projector_size : (width, height)
    shown : mapping of axis to FringeModel
        The code along either axis of the projector.
    sequence : sequence of str
        What a pose's frames run through: x, y, white, black, skip or skip:N; by default x, y and, where there are two
        more frames, white and black.
    left : str, optional
        What {camera} is of the left camera.
    """
    if "{frame}" not in pattern or "{pose}" not in pattern:
        raise CalibrationError(f"--pictures: found {pattern!r}, expected {{pose}} and {{frame}} in it")
    try:
        found = matching(folder, pattern)
        named: Mapping[Camera, str] = cameras_of(found, left) if "{camera}" in pattern else {"left": ""}
        notes: list[str] = []
        poses = [
            {camera: _pictures(folder, files, shown, sequence, notes) for camera, files in of.items()}
            for of in _by_pose(found, named).values()
        ]
    except SceneError as problem:
        raise CalibrationError(str(problem)) from None
    width, height = projector_size
    document = {
        "format": FORMAT,
        "board": _board_document(board),
        "projector": {"width": width, "height": height, "fringe": {axis: shown[axis] for axis in AXES}},
        "poses": poses,
    }
    model = validate(CaptureModel, document, folder, CalibrationError)
    return capture_of(folder, model, folder), list(dict.fromkeys(notes))


def _by_pose(found: Mapping[Path, Values], named: Mapping[Camera, str]) -> dict[str, dict[Camera, list[Path]]]:
    """Each pose's files by camera, in the order of their frames; poses in the order of their names."""
    poses: dict[str, dict[Camera, list[Path]]] = {}
    for path in sorted(found, key=lambda path: natural(found[path]["frame"])):
        values = found[path]
        camera = next((camera for camera, name in named.items() if values.get("camera", "") == name), None)
        if camera is not None:
            poses.setdefault(values["pose"], {}).setdefault(camera, []).append(path)
    for pose, of in poses.items():
        if missing := set(named) - set(of):
            raise CalibrationError(f"pose {pose!r}: found no frames of the {min(missing)} camera, expected both")
    return {pose: poses[pose] for pose in sorted(poses, key=natural)}


def _pictures(
    folder: Path, files: Sequence[Path], shown: Mapping[Axis, FringeModel], sequence: Sequence[str], notes: list[str]
) -> dict[str, Any]:
    """One camera's part of a pose as calibration.json has it."""
    counts = {axis: shown[axis].code.frames for axis in AXES}
    usual = [*AXES, *_OTHERS[:2]] if len(files) != sum(counts.values()) else list(AXES)
    blocks: dict[str, list[str]] = {}
    at = 0
    for token in sequence or usual:
        name, _, number = token.partition(":")
        if name not in (*AXES, *_OTHERS) or (number and not number.isdigit()):
            raise CalibrationError(f"--sequence: found {token!r}, expected x, y, white, black, skip or skip:N")
        size = int(number) if number else counts[name] if name in AXES else 1
        chosen = [as_grey(path, folder) for path in files[at : at + size] if name != "skip"]
        notes += [f"note: {note}" for _, note in chosen if note]
        blocks.setdefault(name, []).extend(path.relative_to(folder).as_posix() for path, _ in chosen)
        at += size
    if at != len(files):
        raise CalibrationError(
            f"{files[0].parent}: found {len(files)} frames, expected {at}: {' '.join(sequence or usual)} with "
            f"{counts['x']} along x and {counts['y']} along y"
        )
    missing = [axis for axis in AXES if axis not in blocks]
    if missing:
        raise CalibrationError(f"--sequence: found no {' and no '.join(missing)}, expected the code along both axes")
    single = {key: blocks[name][0] for key, name in (("white", "white"), ("dark", "black")) if name in blocks}
    return {"fringes": {axis: blocks[axis] for axis in AXES}, **single}


def _board_document(board: Board) -> dict[str, Any]:
    named = ("cols", "rows", "spacing_mm", "dot_diameter_mm", "marker_mm", "dictionary")
    return {"type": board.kind} | {name: getattr(board, name) for name in named if getattr(board, name) is not None}
