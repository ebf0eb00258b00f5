"""Stereo calibrations in OpenCV's FileStorage (XML, YAML or JSON): intrinsics and extrinsics in one file or two.

OpenCV's own samples write M1, D1, M2, D2 and R, T; other names in use are understood, too. The projector is M3, D3, R3,
T3 (x₃ = R3 x₁ + T3), Flushline's own addition. Such files know neither units nor, mostly, the images' size.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.errors import RigError
from metrology.rig import MAX_DISTORTION_TERMS, Device, Rig
from metrology.rig_plausibility import check_rig
from storage import other_rigs
from storage.documents import check_regular_file
from storage.lens_names import check_lens_names

Array = NDArray[np.float64]
Size = tuple[int, int]

MM_PER_UNIT = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}
_ALIASES: dict[str, tuple[str, ...]] = {
    "M1": ("M1", "K1", "cameraMatrix1", "camera_matrix_1", "cameraMatrixL", "left_camera_matrix", "Kl", "KL", "K_l"),
    "D1": ("D1", "distCoeffs1", "distortion_coefficients_1", "distCoeffsL", "left_distortion_coefficients", "Dl"),
    "M2": ("M2", "K2", "cameraMatrix2", "camera_matrix_2", "cameraMatrixR", "right_camera_matrix", "Kr", "KR", "K_r"),
    "D2": (
        "D2",
        "distCoeffs2",
        "distortion_coefficients_2",
        "distCoeffsR",
        "right_distortion_coefficients",
        "Dr",
        "DR",
    ),
    "R": ("R", "rotation", "Rotation", "Rlr", "R_lr", "R12", "rotation_matrix", "stereo_R", "R_stereo", "rot"),
    "T": ("T", "translation", "Translation", "Tlr", "T_lr", "t", "T12", "translation_vector", "stereo_T", "T_stereo"),
    "M3": ("M3", "K3", "projector_matrix"),
    "D3": ("D3", "projector_distortion"),
    "R3": ("R3", "projector_rotation"),
    "T3": ("T3", "projector_translation"),
    "size": ("image_size", "imageSize", "img_size", "img_shape", "resolution", "imgSize", "size"),
    "size3": ("projector_size",),
}
_MORE = {
    "M": ("K", "M", "mtx", "camera_matrix", "cameraMatrix", "intrinsics", "intrinsic_matrix", "mtx_", "cam_int"),
    "D": ("D", "dist", "distCoeffs", "dist_coeffs", "distortion", "distortion_coefficients", "cam_dist", "kc"),
}
_SIDES = {1: ("left", "l", "1", "cam1", "cam0", "camera1"), 2: ("right", "r", "2", "cam2", "cam1", "camera2")}
_NEEDED = ("M1", "D1", "M2", "D2", "R", "T")
_FISHEYE_TERM = 0.002  # of the third and fourth term of four in a column, which of pinhole lenses are p1 and p2
_PROJECTOR = ("M3", "D3", "R3", "T3", "size3")


def load_opencv_rig(
    paths: Sequence[Path],
    rig_id: str,
    calibrated_at: str,
    size: Size | None = None,
    unit: str | None = None,
    projector: Device | None = None,
) -> Rig:
    """Read a stereo calibration.

    Parameters
    ----------
    paths : sequence of Path
        One file or several that together hold intrinsics and extrinsics.
    rig_id, calibrated_at : str
    size : (int, int), optional
        Width and height of the camera images where the files do not tell.
    unit : str, optional
        Of the translations: mm, cm, m, in, or a number of millimetres; by default what the program always uses, or mm.
    projector : Device, optional
        Where the files hold none; a rig may do without.
    """
    if unit is not None and unit not in MM_PER_UNIT and not _is_length(unit):
        raise RigError(f"unit: found {unit!r}, expected one of {', '.join(MM_PER_UNIT)}, or the millimetres of one")
    found: dict[str, Array] = {}
    for path in paths:
        found |= _read(Path(path))
    found |= other_rigs.ros_pose(found)
    named = ", ".join(str(path) for path in paths)
    missing = [name for name in _NEEDED if name not in found]
    if missing:
        raise RigError(
            f"{named}: found no {', '.join(missing)}, expected an OpenCV stereo calibration's {', '.join(_NEEDED)}"
        )
    stated = _size(found.get("size"))
    if stated is None and size is None:
        raise RigError(f"{named}: found no image_size, expected the width and height of the camera images to be given")
    try:
        scale, size = _mm_per_unit(unit, found), size or stated or (0, 0)
        left = _device("left", size, found["M1"], found["D1"], np.eye(3), np.zeros(3))
        right = _device("right", size, found["M2"], found["D2"], found["R"], found["T"] * scale)
        rig = Rig(rig_id, calibrated_at, left, right, _projector(found, scale) or projector)
        check_rig(rig)
        return rig
    except RigError as problem:
        text = str(problem)
        raise RigError(text if text.startswith(named) else f"{named}: {text}") from None


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
    partial = path.with_name(f".partial-{path.name}")
    storage = cv2.FileStorage(str(partial), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        storage.write(_ALIASES[name][0], np.ascontiguousarray(value, float))
    storage.release()
    partial.replace(path)


def _read(path: Path) -> dict[str, Array]:
    if not path.is_dir():
        check_regular_file(path, RigError)
    if path.is_dir() or not _is_opencvs(path):
        try:
            return other_rigs.from_colmap(path) if path.is_dir() else _of_other_program(path)
        except (KeyError, ValueError, TypeError, IndexError) as problem:
            raise RigError(f"{path}: found no {problem}, expected a whole calibration") from None
        except RigError as problem:
            text = str(problem)
            raise RigError(text if text.startswith(str(path)) else f"{path}: {text}") from None
    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        if not storage.isOpened():
            raise RigError(f"{path}: found no OpenCV FileStorage, expected one in XML, YAML or JSON")
        root = storage.root()
        present = set(root.keys())
        found = {}
        for name in _ALIASES:
            alias = _alias(name, present)
            if alias is not None and (value := _matrix(root.getNode(alias))) is not None:
                found[name] = value
        said = {name: root.getNode(name) for name in present}
        check_lens_names({name: node.string() for name, node in said.items() if node.isString()})
        storage.release()
    except RigError as problem:
        text = str(problem)
        raise RigError(text if text.startswith(str(path)) else f"{path}: {text}") from None
    except (cv2.error, SystemError):
        raise RigError(f"{path}: found a damaged file, expected OpenCV's FileStorage in XML, YAML or JSON") from None
    return found


def _alias(wanted: str, present: Collection[str]) -> str | None:
    """The key under which a file has a value, whatever its capitals and whether its camera stands first or last."""
    names = list(_ALIASES[wanted])
    if wanted[0] in _MORE and wanted[1:] in ("1", "2"):
        sides = _SIDES[int(wanted[1:])]
        for side in sides:
            for name in _MORE[wanted[0]]:
                names += [f"{side}{sep}{name}" for sep in (".", "_", "")] + [f"{name}{sep}{side}" for sep in ("_", "")]
    exact = next((name for name in names if name in present), None)
    if exact is not None:
        return exact
    plain = {key.lower(): key for key in present}
    return next((plain[name.lower()] for name in names if len(name) > 2 and name.lower() in plain), None)


def _of_other_program(path: Path) -> dict[str, Array]:
    """A file that is none of OpenCV's."""
    document = other_rigs.read_document(path)
    if (known := other_rigs.from_document(document, path.name)) is not None:
        return known
    said = other_rigs.flat(document)
    check_lens_names({key: value for key, value in said.items() if isinstance(value, str)})
    values = {key: array for key, value in said.items() if (array := other_rigs.numbers(value)) is not None}
    found = {name: values[alias] for name in _ALIASES if (alias := _alias(name, values)) is not None}
    if "width" in values and "height" in values:
        found.setdefault("size", np.array([float(values["width"]), float(values["height"])]))
    return found


def _is_opencvs(path: Path) -> bool:
    if path.suffix.lower() in (".mat", ".npz"):
        return False
    head = path.read_bytes()[:65536]
    return b"opencv" in head or head.lstrip().startswith((b"%YAML", b"<"))


def _matrix(node: cv2.FileNode) -> Array | None:
    """A matrix, or a plain list of numbers as some write sizes."""
    if node.isSeq():
        values = [node.at(k).real() for k in range(node.size())]
        return np.array(values, float) if values else None
    value = node.mat() if node.isMap() else None
    return None if value is None else np.asarray(value, float)


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
    """OpenCV writes up to 14 terms; those beyond the rational model must be zero."""
    terms = value.ravel()
    if terms[MAX_DISTORTION_TERMS:].any():
        raise RigError(
            f"distortion: found {terms.size} terms with prism or tilt, expected at most {MAX_DISTORTION_TERMS}"
        )
    if terms.size == 4 and value.shape[0] == 4 and np.abs(terms[2:]).max() > _FISHEYE_TERM:
        raise RigError(
            f"distortion: found a column of four terms, {', '.join(f'{term:g}' for term in terms)}, as OpenCV writes "
            "k1 to k4 of a fisheye lens; expected a pinhole lens's k1, k2, p1, p2 in a row"
        )
    return terms[:MAX_DISTORTION_TERMS]


def _rotation(value: Array) -> Array:
    """A matrix, or a rotation vector."""
    if value.size == 3 and np.isfinite(value).all():
        return np.asarray(cv2.Rodrigues(value.ravel())[0], float)
    return value


def _projector(found: Mapping[str, Array], scale: float) -> Device | None:
    present = [name for name in _PROJECTOR if name in found]
    if not present:
        return None
    missing = [_ALIASES[name][0] for name in _PROJECTOR if name not in found]
    size = _size(found.get("size3"))
    if missing or size is None:
        raise RigError(f"found a projector without {', '.join(missing) or 'its size'}, expected it whole")
    return _device("projector", size, found["M3"], found["D3"], found["R3"], found["T3"] * scale)
