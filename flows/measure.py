"""Lengths in scans, measured by a rig and held against what is published of the thing that was scanned."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from metrology.calibration.detect_board import detect_board
from metrology.calibration.frames import BoardFrames
from metrology.cloud import Reconstruction
from metrology.errors import CalibrationError, FlushlineError, SceneError, UsageError
from metrology.one_camera import triangulate_one
from metrology.reconstruct import coordinate_size, decode, reconstruct
from metrology.rig import Rig
from metrology.verification.lengths import Length, board_in_scan, face_lengths, point_lengths, sphere_lengths
from storage.board_pictures import parse_board
from storage.frames import read_as_grey
from storage.scene import load_scene


def measure_scan(folder: Path, rig: Rig, options: argparse.Namespace) -> tuple[list[str], bool]:
    """Lines that say each length, and whether all that is stated is met to within `options.within` per cent or U95."""
    cloud = _cloud(folder, rig)
    try:
        found = _lengths(cloud, folder, options)
    except (SceneError, CalibrationError) as problem:
        raise SceneError(f"{folder}: {problem}") from None
    stated = list(options.expected)
    told = [one for one in found if one.unit == "mm" and one.nominal is None and not one.name.startswith("points")]
    if len(stated) > len(told):
        raise UsageError(f"--expected: found {len(stated)} lengths, expected at most {len(told)}: {_names(told)}")
    for one, value in zip(told, stated, strict=False):
        if value <= 0 and not one.name.startswith("step"):
            raise UsageError(f"--expected: found {value:g} mm for {one.name}, expected more than 0")
    nominal = {one.name: value for one, value in zip(told, stated, strict=False)}
    lines, met = [], True
    for one in found:
        wanted = nominal.get(one.name, one.nominal)
        off = 100 * (one.value / wanted - 1) if wanted else None
        met &= wanted is None or abs(one.value - wanted) <= max(one.u95, options.within / 100 * abs(wanted))
        met &= one.unit != "%" or abs(one.value) <= max(options.within, one.u95)
        lines.append(_told(one, wanted, off))
    return lines, met


def _lengths(cloud: Reconstruction, folder: Path, options: argparse.Namespace) -> list[Length]:
    if options.points:
        return point_lengths(cloud, options.points)
    if options.spheres:
        return sphere_lengths(cloud, options.spheres)
    if options.faces:
        return face_lengths(cloud, options.faces)
    board = parse_board(options.board)
    return board_in_scan(cloud, board, detect_board(BoardFrames(_picture(cloud, folder, options.picture)), board))


def _picture(cloud: Reconstruction, folder: Path, name: str | None) -> NDArray[np.uint8]:
    """The left camera's picture that shows the board: one of the folder's, or the mean of the frames."""
    if name is None:
        texture = np.nan_to_num(cloud.left.texture)
        bright = max(float(np.quantile(texture, 0.999)), 1e-9)
        return np.asarray(np.clip(texture / bright * 250, 0, 250).astype(np.uint8))
    picture = read_as_grey(folder / name, SceneError)
    if picture is None or picture.shape != cloud.valid.shape:
        raise SceneError(f"--picture {name}: found no picture of the left camera's size in the scan's folder")
    return np.asarray(picture if picture.dtype == np.uint8 else (picture // 257).astype(np.uint8))


def _cloud(folder: Path, rig: Rig) -> Reconstruction:
    scene = load_scene(folder)
    scene.check_fits(rig)
    if len(scene.used(rig)) == 2:
        return reconstruct(scene.frames("left"), scene.frames("right"), rig, scene.code, scene.exposures)
    size = coordinate_size(rig, scene.code)
    return triangulate_one(decode(scene.frames("left"), scene.code, size, scene.exposures), rig, scene.code, size)


def _told(one: Length, wanted: float | None, off: float | None) -> str:
    u95 = f" ± {one.u95:.4f}" if one.u95 else ""
    against = (
        "" if wanted is None else f" (stated {wanted:g})" if off is None else f" (stated {wanted:g}: {off:+.3f} %)"
    )
    return f"  {one.name}: {one.value:.4f}{u95} {one.unit}{against}"


def _names(found: Sequence[Length]) -> str:
    return ", ".join(one.name for one in found) or "what was measured states its own"


def checked(folders: Sequence[Path], rig: Rig, options: argparse.Namespace) -> tuple[int, int]:
    """Print what every scan says; returns how many were measured, and in how many all that is stated is met."""
    from flows.cli import print_error

    measured = held = 0
    for folder in folders:
        try:
            lines, met = measure_scan(folder, rig, options)
        except UsageError:
            raise
        except FlushlineError as problem:
            if options.debug:
                raise
            print_error(str(problem))
            continue
        measured += 1
        held += met
        print("\n".join([f"{folder}:", *lines]))
    return measured, held
