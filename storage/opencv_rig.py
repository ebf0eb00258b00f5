"""Calibrations of other programs in, OpenCV's FileStorage (XML, YAML or JSON) out.

OpenCV's own samples write M1, D1, M2, D2 and R, T; the projector is M3, D3, R3, T3 (x₃ = R3 x₁ + T3), Flushline's own
addition. Such files know neither units nor, mostly, the images' size.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from metrology.arrays import Array
from metrology.errors import RigError
from metrology.rig import MAX_DISTORTION_TERMS, Device, Rig
from metrology.rig_plausibility import check_rig, doubtful_unit
from storage import other_rigs
from storage.archive.files import replacing
from storage.calibration_documents import flat, numbers, read_document
from storage.calibration_names import NAMES, by_given_names, first_number, from_names, side_of_file, told_shapes
from storage.length_units import MM_PER_UNIT, told_unit
from storage.lens_names import check_lens_names
from storage.one_camera_files import from_mrcal
from storage.pose_names import turned
from storage.projection_matrices import from_projections
from storage.rectified_pairs import from_rectification

Size = tuple[int, int]

READ_OTHERWISE = "read_otherwise"
"""Key of a rig's `extra`: what of the files was not taken as it stands."""
_UNDISTORTED = "the files tell no distortion: pictures are taken as undistorted"
_MAY_BE_A_LENS = re.compile(r"(?i)dist|coef|lens|radial|tangential|k[_]?1$|(?<![a-z])kc|(?<![a-z])d_?[0-2lr]?$")
_INSTEAD_OF_R = "R of the files is no rotation: R and T are those of their rectification, R1, R2 and P2"
_NEEDED = ("M1", "D1", "M2", "D2", "R", "T")
_WRITTEN = {"size": "image_size", "size3": "projector_size"}  # what we call what OpenCV's samples leave out
_MOST_LISTED = 12
_FISHEYE_TERM = 0.002  # of the third and fourth term of four in a column, which of pinhole lenses are p1 and p2
_ENDINGS = (".yml", ".yaml", ".xml", ".json", ".toml", ".ini", ".txt", ".csv", ".npy", ".npz", ".mat", ".h5")
_PROJECTOR = ("M3", "D3", "R3", "T3", "size3")


def load_opencv_rig(
    paths: Sequence[Path],
    rig_id: str,
    calibrated_at: str,
    size: Size | None = None,
    unit: str | None = None,
    projector: Device | None = None,
    projector_size: Size | None = None,
    right_size: Size | None = None,
    given: Mapping[str, str] | None = None,
) -> Rig:
    """Read a calibration of two cameras, or of one and a projector.

    Parameters
    ----------
    paths : sequence of Path
        One file or several that together hold intrinsics and extrinsics.
    size : (int, int), optional
        Width and height of the camera images where the files do not tell.
    unit : str, optional
        Of the translations: mm, cm, m, in, or a number of millimetres; by default what the program always uses, or mm.
    projector : Device, optional
        Where the files hold none; a rig may do without.
    projector_size : (int, int), optional
        Where the files hold a projector but not its size.
    right_size : (int, int), optional
        Of the right camera's images, where the files do not tell and it is not the left one's.
    given : mapping, optional
        What M1, D1, M2, D2, R, T are called in the files, of those whose names do not tell.

    Raises
    ------
    RigError
        Where something is missing, no such rig can be built, or the unit is told by nothing and may well be another.
    """
    if unit is not None and unit not in MM_PER_UNIT and not _is_length(unit):
        raise RigError(f"unit: found {unit!r}, expected one of {', '.join(MM_PER_UNIT)}, or the millimetres of one")
    found, there = _gathered(paths, given or {})
    said = _completed(found, there)
    named = ", ".join(str(path) for path in paths)
    alone = "M3" in found and "M2" not in found
    missing = [name for name in (_NEEDED[:2] if alone else _NEEDED) if name not in found]
    if missing:
        held = f"; found {_listed(there)}: --names {missing[0]}=NAME … says which is which" if there else ""
        raise RigError(
            f"{named}: found no {', '.join(missing)}, expected {', '.join(_NEEDED)} of a stereo calibration{held}"
        )
    stated = _size(found.get("size", found.get("size2")))
    if stated is None and size is None:
        raise RigError(
            f"{named}: found no image_size, expected the width and height of the camera images to be given (--size WxH)"
        )
    if projector_size is not None:
        found["size3"] = np.array(projector_size, float)
    try:
        scale = _mm_per_unit(unit, found)
        own = _size(found.get("size2")) if size in (None, stated) else None
        second = right_size or own or size or stated or (0, 0)
        size = size or stated or (0, 0)
        left = _device("left", size, found["M1"], found["D1"], np.eye(3), np.zeros(3))
        right = None if alone else _device("right", second, found["M2"], found["D2"], found["R"], found["T"] * scale)
        rig = Rig(
            rig_id,
            calibrated_at,
            left,
            right,
            _projector(found, scale) or projector,
            {READ_OTHERWISE: "; ".join(said)} if said else {},
        )
        check_rig(rig)
        if unit is None and "unit" not in found and (doubt := doubtful_unit(rig)):
            raise RigError(doubt)
        return rig
    except RigError as problem:
        text = str(problem)
        raise RigError(text if text.startswith(named) else f"{named}: {text}") from None


def _gathered(paths: Sequence[Path], given: Mapping[str, str]) -> tuple[dict[str, Array], dict[str, object]]:
    """What all files say by OpenCV's names; and, where these do not suffice, all that they hold by their own."""
    found: dict[str, Array] = {}
    there: dict[str, object] = {}
    files = [file for path in paths for file in _files(Path(path))]
    first = first_number((file.stem, file.parent.name) for file in files)
    for file in files:
        found |= _read(file, found, first)
        if given or not set(_NEEDED) <= set(found):
            there |= {} if file.is_dir() else flat(read_document(file))
    if not {"M1", "M2"} & set(found):  # beside matrices of the cameras, P1 and P2 are of their rectification
        for file in files:
            found |= from_projections(
                flat(read_document(file)), first, side_of_file([file.stem, file.parent.name], first)
            )
    if there:
        found |= from_rectification(there, found)
    if unknown := sorted(set(given) - set(NAMES)) or sorted(set(given.values()) - set(there)):
        raise RigError(f"--names: found {unknown[0]!r}, expected {', '.join(NAMES)} = one of {_listed(there)}")
    return found | by_given_names(there, given), there


def _completed(found: dict[str, Array], there: Mapping[str, object]) -> list[str]:
    """Add to `found` what follows from it; returns what of that is to be said. `there` is all that the files hold."""
    pose = other_rigs.pose_of_both(found)
    said = [_INSTEAD_OF_R] * ("R" in found and "R" in pose)
    found |= pose
    if {"M1", "M2"} <= set(found) and not {"D1", "D2"} & set(found) and not any(map(_may_be_a_lens, there.items())):
        found |= {"D1": np.zeros((1, 5)), "D2": np.zeros((1, 5))}
        said.append(_UNDISTORTED)
    return said


def save_opencv_rig(rig: Rig, path: Path) -> None:
    """Write intrinsics, extrinsics (mm) and the projector into one file; its ending (xml, yml, json) is the format."""
    path = Path(path)
    if path.suffix.lower() not in (".xml", ".yml", ".yaml", ".json"):
        raise RigError(f"{path}: found the ending {path.suffix!r}, expected .xml, .yml, .yaml or .json")
    path.parent.mkdir(parents=True, exist_ok=True)
    right = rig.with_right()
    values: dict[str, Array] = {
        "size": np.array([[rig.left.width, rig.left.height]], float),
        "R": right.R,
        "T": right.t[:, None],
    }
    if rig.projector:
        values |= {
            "size3": np.array([[rig.projector.width, rig.projector.height]], float),
            "R3": rig.projector.R,
            "T3": rig.projector.t[:, None],
        }
    if (right.width, right.height) != (rig.left.width, rig.left.height):
        raise RigError(f"{path}: found cameras of two image sizes, expected one: OpenCV's stereo files have but one")
    for number, device in enumerate(rig.devices.values(), start=1):
        values[f"M{number}"] = device.K
        values[f"D{number}"] = device.distortion[None] if device.distortion.size else np.zeros((1, 4))
    with replacing(path) as partial:
        storage = cv2.FileStorage(str(partial), cv2.FILE_STORAGE_WRITE)
        for name, value in values.items():
            storage.write(_WRITTEN.get(name, name), np.ascontiguousarray(value, float))
        storage.release()


def _read(path: Path, before: Mapping[str, Array], first: int) -> dict[str, Array]:
    """What a file says by OpenCV's names; `before` is what others said, for a camera's file that names no side.

    `first` is the number of the left camera in names.
    """
    try:
        if path.is_dir():
            return other_rigs.from_colmap(path)
        side = side_of_file([path.stem, path.parent.name], first) or (2 if "M1" in before and "M2" not in before else 1)
        if path.suffix == ".cameramodel" and (known := from_mrcal(path.read_text(encoding="utf-8"), side)) is not None:
            return known
        document = read_document(path)
        if (known := other_rigs.from_document(document, path)) is not None:
            return known
        check_lens_names(document)
        values = flat(document)
        unit = told_unit(values)
        return from_names(values, side) | ({} if unit is None else {"unit": np.array(unit)})
    except (KeyError, ValueError, TypeError, IndexError) as problem:
        what = f"no {problem}" if isinstance(problem, KeyError) else f"values that do not fit ({problem})"
        raise RigError(f"{path}: found {what}, expected a whole calibration") from None
    except RigError as problem:
        text = str(problem)
        raise RigError(text if text.startswith(str(path)) else f"{path}: {text}") from None


def _may_be_a_lens(said: tuple[str, object]) -> bool:
    """Whether a value that no name tells may be a lens's distortion."""
    value = numbers(said[1])
    return value is not None and (bool(_MAY_BE_A_LENS.search(said[0])) or value.size in (5, 8, 14))


def _listed(values: Mapping[str, object]) -> str:
    """The first of the values that may be meant."""
    told = told_shapes(values)
    return ", ".join(told[:_MOST_LISTED]) + ", …" * (len(told) > _MOST_LISTED) or "no matrices"


def _files(path: Path) -> list[Path]:
    """A file itself; a folder's files of matrices, but of COLMAP's the folder."""
    if not path.is_dir() or any((path / f"cameras{ending}").exists() for ending in (".txt", ".bin")):
        return [path]
    found = sorted(file for file in path.iterdir() if file.suffix.lower() in _ENDINGS and file.is_file())
    if not found:
        raise RigError(f"{path}: found no file of {', '.join(_ENDINGS)}, expected a calibration")
    return found


def _is_length(unit: str) -> bool:
    try:
        return 0 < float(unit) < np.inf
    except ValueError:
        return False


def _mm_per_unit(unit: str | None, found: Mapping[str, Array]) -> float:
    if unit is None:
        return float(found.get("unit", 1.0))
    return MM_PER_UNIT.get(unit) or float(unit)


def _size(value: Array | None) -> Size | None:
    if value is None or value.size != 2:
        return None
    return int(value.ravel()[0]), int(value.ravel()[1])


def _device(name: str, size: Size, K: Array, distortion: Array, R: Array, t: Array) -> Device:
    try:
        return Device(size[0], size[1], K, _terms(distortion), _rotation(R), t.ravel())
    except RigError as problem:
        raise RigError(f"{name}: {problem}") from None


def _terms(value: Array) -> Array:
    """OpenCV writes up to 14 terms; those of a tilted sensor must be zero."""
    terms = value.ravel()
    if terms[MAX_DISTORTION_TERMS:].any():
        raise RigError(f"distortion: found {terms.size} terms with tilt, expected at most {MAX_DISTORTION_TERMS}")
    if terms.size == 4 and value.shape[0] == 4 and np.abs(terms[2:]).max() > _FISHEYE_TERM:
        raise RigError(
            f"distortion: found a column of four terms, {', '.join(f'{term:g}' for term in terms)}, as OpenCV writes "
            "k1 to k4 of a fisheye lens; expected a pinhole lens's k1, k2, p1, p2 in a row"
        )
    return terms[:MAX_DISTORTION_TERMS]


def _rotation(value: Array) -> Array:
    """A matrix, of a rotation vector or a quaternion too."""
    return turned(value) if max(value.shape) == value.size in (3, 4) and np.isfinite(value).all() else value


def _projector(found: Mapping[str, Array], scale: float) -> Device | None:
    if not any(name in found for name in _PROJECTOR[:-1]):
        return None
    missing = [name for name in _PROJECTOR[:-1] if name not in found]
    size = _size(found.get("size3"))
    if missing or size is None:
        raise RigError(
            f"found a projector without {', '.join(missing) or 'its size'}, expected it whole (--projector-size WxH)"
        )
    return _device("projector", size, found["M3"], found["D3"], found["R3"], found["T3"] * scale)
