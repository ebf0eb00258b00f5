"""What the values of somebody's calibration are: matrices, distortions and poses by the words of their names.

`cameraMatrix1`, `K_left`, `left.camera_matrix`, `mtxL`, `cam_int`, `Rlr`: a name says a role and, mostly, a device. The
names of OpenCV's samples are what they become: M1, D1, M2, D2, R, T; M3, D3, R3, T3 of the projector.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from metrology.arrays import Array
from storage.calibration_documents import numbers
from storage.length_units import without_unit
from storage.pose_names import apart, between, is_row, relative_poses, square, turned, turned_back, world_pose

Found = dict[str, Array]

NAMES = ("M1", "D1", "M2", "D2", "R", "T", "M3", "D3", "R3", "T3", "size", "size2", "size3")
# Of a file of one camera, or of a rectification: `storage.other_rigs.pose_of_both`.
_OWN = (
    *(f"posed{role}{side}" for side in "123" for role in "RT"),
    "placed1", "placed2", "rectified1", "rectified2", "projection2",
)  # fmt: skip
_RECTIFIED = {"R1": ("rectified1", (3, 3)), "R2": ("rectified2", (3, 3)), "P2": ("projection2", (3, 4))}
# Names whose device or role their words do not tell.
_EXACT = {
    "projector_matrix": "M3", "projector_distortion": "D3", "projector_rotation": "R3", "projector_translation": "T3",
    "projector_size": "size3", "M4": "M3", "D4": "D3", "Rlp": "R3", "Tlp": "T3", "Rlr": "R", "Tlr": "T",
    "stereo_R": "R", "stereo_T": "T", "R_l2r": "R", "T_l2r": "T", "t_l2r": "T", "R_01": "R", "T_01": "T", "t_01": "T",
    "MLS": "M1", "dLS": "D1", "MRS": "M2", "dRS": "D2",
    "R_lr": "R", "T_lr": "T", "R_LR": "R", "T_LR": "T", "t_LR": "T", "t_lr": "T", "R12": "R", "T12": "T", "t12": "T",
    "R_0_1": "R", "T_0_1": "T", "t_0_1": "T", "R_rel": "R", "T_rel": "T", "t_rel": "T", "RL2R": "R", "TL2R": "T",
    "tlr": "T", "R_12": "R", "T_12": "T", "t_12": "T",
    "S": "size", "roration": "R", "R3": "R3", "T3": "T3",
}  # fmt: skip
_ROLES = {
    "M": ("k", "m", "a", "mtx", "matrix", "camk", "int", "intrinsic", "intrinsics", "intrinsicmatrix",
          "intrinsicsmatrix", "cameramatrix", "cammatrix", "cammtx", "cammats", "cm", "cameraintrinsics", "kmat",
          "intr", "kk"),
    "D": ("d", "kc", "dist", "distortion", "distcoeff", "distcoeffs", "distcoef", "distcoefs", "coeffs", "discoeff",
          "distortioncoefficients", "distortioncoefficient", "distortioncoeffs", "distortionparameters", "distvec",
          "distortioncoefs", "distvector", "cd", "distortionvector", "coef", "distortions", "distort", "distortcoeff",
          "distortcoeffs", "distortcoef", "distortioncoeff", "dc", "distparams", "lensdistortion", "distortparams"),
    "R": ("r", "rot", "rotation", "rotationmatrix", "rmat", "rotmatrix", "rotmat", "rotationmat", "om", "rvec",
          "rotationvector", "stereor", "rstereo", "rodrigues", "rotationofcamera", "quaternion", "quat", "q",
          "orientation", "qvec", "rotate"),
    "T": ("t", "trans", "trns", "translation", "translationvector", "translationmatrix", "tvec", "tmat", "stereot",
          "tstereo", "transvec", "translationvec", "extrinsics", "extrinsic", "extrinsicmatrix", "transform",
          "transformation", "transformationmatrix", "rt", "translationofcamera", "tvector", "translate"),
    "size": ("imagesize", "imgsize", "imgshape", "imageshape", "resolution", "size", "shape", "imageresolution",
             "framesize", "frameshape", "imsize"),
}  # fmt: skip
_SIDES = {"left": 1, "l": 1, "master": 1, "right": 2, "r": 2, "slave": 2, "projector": 3, "proj": 3, "prj": 3}
_SPELLED = {name: role for role, names in _ROLES.items() for name in names}
_PAIRS = {
    f"{role.lower()}{side}": (as_, _SIDES[side]) for role, as_ in (("K", "M"), ("M", "M"), ("D", "D")) for side in "lr"
}
_OTHER_THINGS = (
    "new",
    "optimal",
    "rect",
    "proj_mat",
    "essential",
    "fundamental",
    "err",
    "std",
    "inv",
    "homography",
    "initial",
)
_CAMERA = (
    "cam",
    "camera",
    "cams",
    "cameras",
    "stereo",
    "calib",
    "calibration",
    "params",
    "parameters",
    "the",
    "between",
    "of",
)
_FOCAL = ("focal", "focallength", "focallengths", "focallengthpx", "fc", "f")
_POINTS = ("principal_point", "principalPoint", "PrincipalPoint", "pp", "cc", "center", "centre", "c")
_HIGH = {
    "width": "height", "imagewidth": "imageheight", "imgwidth": "imgheight", "framewidth": "frameheight", "w": "h",
    "nx": "ny", "resx": "resy", "resolutionx": "resolutiony",
}  # fmt: skip
"""What a height is called beside a width."""
_OTHER_PAIRS = tuple(
    (re.compile(rf"{first}(?![a-zA-Z])"), re.compile(rf"{second}(?![a-zA-Z])"))
    for first, second in (
        ("(?:[Cc]am|[Cc]amera)_?A", "(?:[Cc]am|[Cc]amera)_?B"), ("(?<![a-zA-Z])main", "(?<![a-zA-Z])sub"),
        ("(?<![a-zA-Z])top", "(?<![a-zA-Z])bottom"), ("(?<![a-zA-Z])upper", "(?<![a-zA-Z])lower"),
        ("(?<![a-zA-Z])primary", "(?<![a-zA-Z])secondary"), ("(?<![a-zA-Z])ir_?1", "(?<![a-zA-Z])ir_?2"),
    )
)  # fmt: skip
"""Words that stand for left and right where both are there."""
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")


def from_names(values: Mapping[str, Any], file_side: int | None = None) -> Found:
    """The values by the names of OpenCV's samples.

    Parameters
    ----------
    values : mapping
        Flat names to values.
    file_side : 1, 2 or 3, optional
        The camera, or the projector, that the file as a whole is of, for names that tell none.
    """
    values = _plainly_named(values)
    arrays = {name: array for name, value in values.items() if (array := numbers(value)) is not None}
    arrays |= _by_axes(arrays) | _by_parts(arrays) | _by_elements(arrays)
    found: Found = {}
    backward: Found = {}
    told: list[tuple[str, int | None, str]] = []
    placed = {"R1", "T1", "R2", "T2"} <= set(arrays)
    for name, array in arrays.items():
        exact = _EXACT.get(name) or _EXACT.get(name.rsplit(".", 1)[-1])
        if (world := world_pose(name)) and not exact:
            told += [(world[0], _side_of(world[1]), name)] * (array.size in (12, 16))
            continue
        if (towards := between(name)) and not exact:
            role = (_role_and_side(towards[1]) or ("T" * (array.size in (12, 16)), None))[0]
            if role in ("R", "T") and _fits(role, array):
                (found if towards[0] else backward)[role] = turned(array) if role == "R" else array
            continue
        if exact is not None:
            found[exact] = array
        elif placed and name in ("R1", "T1", "R2", "T2"):
            told.append((name[0], int(name[1]), name))
        elif (read := _role_and_side(name)) is not None and (name in NAMES or _fits(read[0], array)):
            told.append((*read, name))
    first = 10 if any(side == 10 for _, side, _ in told) else 11
    one_camera = any(side == 3 for _, side, _ in told)
    poses: Found = {}
    for role, side, name in told:
        number = side - first + 1 if side is not None and side >= 10 else side
        if role == "size":
            found.setdefault(_size_of(number or file_side), _ordered(name, arrays))
        elif role == "W":
            found.setdefault(f"placed{number or file_side or 0}", square(arrays[name]))
        elif role in "MD":
            value = _four(arrays[name]) if role == "M" and arrays[name].size == 4 else arrays[name]
            found.setdefault(f"{role}{number or file_side or (1 if one_camera else 0)}", value)
        else:
            poses.setdefault(f"{role}{number or 0}", arrays[name])
    poses = apart(poses)
    if any(role == "M" and side is None for role, side, _ in told) and file_side and not one_camera:
        poses = {f"posed{key[0]}{file_side}" if key in ("R0", "T0") else key: pose for key, pose in poses.items()}
    found |= {key: value for key, value in poses.items() if key in _OWN} | turned_back(backward)
    if not placed:
        turns = {as_: arrays[name] for name, (as_, shape) in _RECTIFIED.items() if _shape(arrays, name) == shape}
        found |= turns if len(turns) == len(_RECTIFIED) else {}
    found |= {key: value for key, value in relative_poses(poses).items() if key not in found}
    found |= {key: value for key, value in _scalars(values, file_side).items() if key not in found}
    found |= {key: value for key, value in _size(arrays, first, file_side).items() if key not in found}
    return _shaped({key: value for key, value in found.items() if key in NAMES + _OWN})


def _plainly_named(values: Mapping[str, Any]) -> dict[str, Any]:
    """Cameras A and B, top and bottom and the like as left and right; lengths by their names without units."""
    values = {without_unit(name): value for name, value in values.items()}
    for first, second in _OTHER_PAIRS:
        if all(any(pattern.search(name) for name in values) for pattern in (first, second)):
            values = {second.sub("right", first.sub("left", name)): value for name, value in values.items()}
    return dict(values)


def _by_elements(arrays: Mapping[str, Array]) -> Found:
    """R and T of r11 to r33 and tx, ty, tz, each told by itself."""
    single = {name.lower().replace("_", ""): array.item() for name, array in arrays.items() if array.size == 1}
    found: Found = {}
    for role, names in (("R", [f"r{i}{j}" for i in "123" for j in "123"]), ("T", ["tx", "ty", "tz"])):
        if role not in arrays and set(names) <= set(single):
            found[role] = np.array([single[name] for name in names])
    return found


def _by_axes(arrays: Mapping[str, Array]) -> Found:
    """Vectors and quaternions whose parts are named x, y, z, w, as arrays of the table's name."""
    heads = {name.rpartition(".")[0] for name in arrays if name.endswith(".z")}
    found: Found = {}
    for head in heads:
        parts = [arrays.get(f"{head}.{axis}") for axis in "xyzw"]
        sound = [part.item() for part in parts if part is not None and part.size == 1]
        if len(sound) >= 3:
            found[head] = np.array(sound)
    return found


def _four(value: Array) -> Array:
    """(3, 3) camera matrix of fx, fy, cx, cy."""
    fx, fy, cx, cy = value.ravel()
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _by_parts(arrays: Mapping[str, Array]) -> Found:
    """fx, fy, cx, cy of cameras told by focal lengths and principal point."""
    found: Found = {}
    for name, focal in arrays.items():
        head, _, leaf = name.rpartition(".")
        words = "".join(_WORD.findall(leaf)).lower()
        if words not in _FOCAL or focal.size not in (1, 2) or not head:
            continue
        points = [arrays[f"{head}.{other}"] for other in _POINTS if f"{head}.{other}" in arrays]
        if points and points[0].size == 2:
            found[f"{head}.K"] = np.array([*np.resize(focal, 2), *points[0].ravel()])
    return found


def _shape(arrays: Mapping[str, Array], name: str) -> tuple[int, ...]:
    return arrays[name].shape if name in arrays else ()


def _size_of(side: int | None) -> str:
    """What the size of a device's images is called."""
    return {2: "size2", 3: "size3"}.get(side or 1, "size")


def by_given_names(values: Mapping[str, Any], given: Mapping[str, str]) -> Found:
    """The values that somebody has named: `given` says what M1, D1 and the like are called."""
    found: Found = {}
    for key, name in given.items():
        if name in values and (array := numbers(values[name])) is not None:
            found[key] = array.reshape(3, 3) if key[0] in "MR" and array.size == 9 else array
    return found


def told_shapes(values: Mapping[str, Any]) -> list[str]:
    """Names of the values that may be part of a calibration, each with its shape."""
    arrays = {name: array for name, value in values.items() if (array := numbers(value)) is not None}
    return [f"{name} ({'×'.join(map(str, array.shape))})" for name, array in arrays.items() if 2 <= array.size <= 16]


def _role_and_side(name: str) -> tuple[str, int | None] | None:
    """Role (M, D, R, T, size) and device (1, 2, 3; 10 + n where it is numbered n) that a name's words tell."""
    parent, _, leaf = name.rpartition(".")
    if leaf in ("R", "r") and parent and (_role_and_side(parent) or "T")[0] == "T":
        return "R", _side_of(parent)  # the rotation inside a table, which is no name of a right camera
    words = [word.lower() for word in _WORD.findall(name)]
    if any(word.startswith(_OTHER_THINGS) for word in words):
        return None
    if len(words) == 1 and words[0] in _PAIRS:
        return _PAIRS[words[0]]
    if len(words) == 2 and words[1].isdigit() and words[0] in ("r", "t"):
        return None  # OpenCV's R1 and R2 are rotations of a rectification
    side: int | None = None
    rest: list[str] = []
    for place, word in enumerate(words):
        letter_of_role = word == "r" and (len(words) == 1 or place == 0) and _role(words[1:]) is None
        if word.isdigit():
            side = 10 + int(word) if side is None else side
        elif word in _SIDES and not letter_of_role and len(words) > 1:
            side = _SIDES[word] if side is None or side >= 10 else side
        else:
            rest.append(word)
    role = _role(rest)
    return None if role is None else (role, side)


def _role(words: list[str]) -> str | None:
    """The role that words without any device's spell, by all of them, the last two, or the last."""
    while len(words) > 1 and words[0] in _CAMERA and "".join(words) not in _SPELLED:
        words = words[1:]
    while len(words) > 1 and words[-1] in _CAMERA and "".join(words) not in _SPELLED:
        words = words[:-1]
    whole = "".join(words)
    if whole in _SPELLED:
        return _SPELLED[whole]
    last = [_SPELLED.get("".join(words[-2:])), _SPELLED.get(words[-1])] if words else []
    return next((role for role in last if role is not None and role != "size"), None)


def _fits(role: str, array: Array) -> bool:
    """Whether a value can be what its name says: `T` may be a time, `d` a distance."""
    if role == "M":
        return array.shape in ((3, 3), (9,), (1, 9)) or is_row(array, 4)
    if role == "D":
        return array.size in (4, 5, 8, 12, 14) and max(array.shape) == array.size
    if role == "R":
        return array.size in (3, 9) or is_row(array, 4)
    return array.size in (3, 12, 16) if role == "T" else array.size == 2


def _ordered(name: str, arrays: Mapping[str, Array]) -> Array:
    """Width, height: what is called a shape may be height, width, as the middle of the image tells."""
    size = arrays[name].ravel()
    matrices = [array.reshape(3, 3) for other, array in arrays.items() if (_role_and_side(other) or "R")[0] == "M"
                and array.size == 9]  # fmt: skip
    if "shape" not in name.lower() or not matrices:
        return size
    centre = matrices[0][:2, 2]
    return size if np.abs(size / 2 - centre).sum() <= np.abs(size[::-1] / 2 - centre).sum() else size[::-1]


def _scalars(values: Mapping[str, Any], file_side: int | None) -> Found:
    """Cameras told by fx, fy, cx, cy and k1, k2, p1, p2, k3 each by itself."""
    groups: dict[int, dict[str, float]] = {}
    for name, value in values.items():
        words = re.match(r"(.*?)[._]?(fx|fy|cx|cy|k1|k2|k3|p1|p2)[._]?(.*)$", name, re.IGNORECASE)
        if words is None or isinstance(value, bool) or not isinstance(value, int | float):
            continue
        side = _side_of(f"{words[1]} {words[3]}") or file_side
        if side:
            groups.setdefault(side, {})[words[2].lower()] = float(value)
    first = 10 if 10 in groups else 11
    found: Found = {}
    for side, said in groups.items():
        if not {"fx", "fy", "cx", "cy"} <= set(said):
            continue
        number = side - first + 1 if side >= 10 else side
        found[f"M{number}"] = np.array([[said["fx"], 0, said["cx"]], [0, said["fy"], said["cy"]], [0, 0, 1]])
        found[f"D{number}"] = np.array([[said.get(term, 0.0) for term in ("k1", "k2", "p1", "p2", "k3")]])
    return found


def _side_of(text: str) -> int | None:
    for word in _WORD.findall(text):
        if word.isdigit():
            return 10 + int(word)
        if word.lower() in _SIDES:
            return _SIDES[word.lower()]
    return None


def side_of_file(parts: Iterable[str], first: int = 0) -> int | None:
    """The camera that a file or its folder is named after: left.yaml, cam1/sensor.yaml; `first` is the left one. 3: the
    projector, where the file's name has that word and none for a camera.
    """
    parts = list(parts)
    words = [re.findall(r"[a-z]+", part.lower()) for part in parts]
    for word in (word for part in words for word in part):
        if word in ("left", "l", "right", "r"):
            return _SIDES[word]
    if (number := _number_of(parts)) is not None:
        return {first: 1, first + 1: 2}.get(number)
    return 3 if "projector" in words[0] and not {"cam", "camera"} & set(words[0]) else None


def first_number(names: Iterable[Iterable[str]]) -> int:
    """What the left camera is numbered in several files' names: 1 where there is a 2 and no 0, else 0."""
    numbers_ = {_number_of(list(parts)) for parts in names}
    return int(2 in numbers_ and 0 not in numbers_)


def _number_of(parts: Iterable[str]) -> int | None:
    numbered = [re.search(r"(?:cam|camera)_?(\d)", part, re.IGNORECASE) for part in parts]
    return next((int(match[1]) for match in numbered if match), None)


def _size(arrays: Mapping[str, Array], first: int, file_side: int | None) -> Found:
    """Width and height told each by itself; `first` is the left camera in numbered names."""
    found: Found = {}
    spelled = {name: "".join(_WORD.findall(name.rpartition(".")[2])).lower() for name in arrays}
    for name, word in spelled.items():
        head, _, _ = name.rpartition(".")
        high = next(
            (one for one, said in spelled.items() if one.rpartition(".")[0] == head and said == _HIGH.get(word)), ""
        )
        if high and arrays[name].size == arrays[high].size == 1:
            side = _side_of(head) or file_side
            number = side - first + 1 if side is not None and side >= 10 else side
            found.setdefault(_size_of(number), np.array([arrays[name].item(), arrays[high].item()]))
    return found


def _shaped(found: Found) -> Found:
    """Matrices in their shapes, R and T apart; of one camera's file the pose is the projector's."""
    for suffix in ("", "3"):
        pose = found.get(f"T{suffix}")
        if pose is not None and pose.size in (12, 16):
            matrix = pose.reshape(-1, 4)
            found[f"R{suffix}"], found[f"T{suffix}"] = matrix[:3, :3], matrix[:3, 3]
    found = {key: value.reshape(3, 3) if key[0] in "MR" and value.size == 9 else value for key, value in found.items()}
    if "M3" in found and "M2" not in found:
        for name in ("R", "T"):
            if name in found and f"{name}3" not in found:
                found[f"{name}3"] = found.pop(name)
    return found
