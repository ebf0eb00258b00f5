"""Where devices stand to each other, as somebody's names and values tell it: directions, places in the world, turns.

`R_left_to_right`, `T_cam1_cam0`, `R_AB`: from one camera's coordinates to the other's. `c2w`, `T_world_cam`: from a
camera's to the world's. `w2c`, `T_cam_world`: from the world's to a camera's.
"""

from __future__ import annotations

import re

import cv2
import numpy as np

from metrology.arrays import Array
from metrology.errors import RigError

Found = dict[str, Array]

_TO_WORLD = re.compile(
    r"(?:c|cam|camera)_?(?:2|to)_?(?:w|world)|(?:c|cam|camera)(?:ToWorld|Pose|_pose)|T_?(?:w|world)_?(?:c|cam|camera)(?![a-z])"
)
_FROM_WORLD = re.compile(
    r"(?:w|world|World)_?(?:2|to|To)_?(?:c|cam|camera|Cam|Camera)(?![a-z])|T_?(?:c|cam|camera)_?(?:w|world)(?![a-z])"
)
_NAME = r"left|right|l|r|master|slave|(?:cam|camera|c)_?[012ab]"
_BETWEEN = re.compile(rf"(?i)(?<![a-z])({_NAME})_?(?:to|2)_?({_NAME})(?![a-z\d])")
_NUMBERED = re.compile(r"(?<![A-Za-z\d])([012])_?to_?([012])(?!\d)|(?<=[RTt]_)([A])_?([B])(?![A-Za-z])")
_INTO = re.compile(
    r"(?i)(?<=[rt]_)(?:right|cam_?1|c_?1)_(?:left|cam_?0|c_?0)(?![a-z\d])|"
    r"(?<=right_)from_left(?![a-z])|(?<![a-z])cam_?1_(?=[rt]_cam_?0(?!\d))"
)
_FIRST = ("left", "l", "master")
_SURE_W = 0.7  # of a unit quaternion: cameras turned by less than 90° to each other have more


def between(name: str) -> tuple[bool, str] | None:
    """Whether a pose leads from the left camera to the right one (or back), and the rest of its name."""
    name = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name)
    if match := _INTO.search(name):  # T_target_source, T_target_from_source, target_T_source
        return True, _INTO.sub("", name)
    match = _BETWEEN.search(name) or _NUMBERED.search(name)
    if match is None:
        return None
    source, target = (group.lower() for group in match.groups() if group)
    forward = source in _FIRST or (source not in ("right", "r", "slave") and source[-1] < target[-1])
    return forward, name.replace(match[0], "")


def world_pose(name: str) -> tuple[str, str] | None:
    """What a pose by a world is: W, the camera's place in it, or T, from it to the camera; and the rest of its name."""
    for role, pattern in (("W", _TO_WORLD), ("T", _FROM_WORLD)):
        if pattern.search(name):
            return role, pattern.sub("", name)
    return None


def square(value: Array) -> Array:
    """(4, 4) of a matrix that may lack its last row."""
    return np.vstack([value.reshape(-1, 4)[:3], [[0.0, 0.0, 0.0, 1.0]]])


def apart(said: Found) -> Found:
    """R and T of every T that is the matrix of both."""
    found = dict(said)
    for name, value in said.items():
        if name[0] == "T" and value.size in (12, 16):
            placed = square(value)
            found[name] = placed[:3, 3]
            found.setdefault(f"R{name[1:]}", placed[:3, :3])
    return found


def turned_back(pose: Found) -> Found:
    """R and T from left to right of those from right to left."""
    pose = apart(pose)
    if set(pose) != {"R", "T"}:
        return {}
    return {"R": pose["R"].T, "T": -pose["R"].T @ pose["T"].ravel()}


def relative_poses(said: Found) -> Found:
    """R and T of the second camera from the first, and those of the projector."""
    found: Found = {}
    for role in "RT":
        pose = next((said[f"{role}{side}"] for side in ("0", "2") if f"{role}{side}" in said), None)
        found |= {role: pose} if pose is not None else {}
        found |= {f"{role}3": said[f"{role}3"]} if f"{role}3" in said else {}
    if {"R1", "R2", "T1", "T2"} <= set(said) and "R0" not in said:
        first, second = turned(said["R1"]), turned(said["R2"])  # both stand to the same object
        turn = second @ first.T
        found |= {"R": turn, "T": said["T2"].ravel() - turn @ said["T1"].ravel()}
    return found


def is_row(value: Array, size: int) -> bool:
    """Whether a value is so many numbers in a row or a column."""
    return value.size == max(value.shape, default=0) == size


def turned(value: Array) -> Array:
    """(3, 3) rotation of a matrix, a rotation vector, or a quaternion, whose w comes first or last."""
    if is_row(value, 4):
        from scipy.spatial.transform import Rotation

        if not np.linalg.norm(value) > 0:
            raise RigError("found a quaternion of 0 0 0 0, expected a turn")
        q = value.ravel() / np.linalg.norm(value)
        if max(abs(q[0]), abs(q[3])) < _SURE_W:
            raise RigError(
                f"found a quaternion {', '.join(f'{part:.3f}' for part in q)} of a turn by more than 90°, expected R "
                "as a matrix: whether w comes first or last cannot be told"
            )
        return np.asarray(Rotation.from_quat(np.roll(q, -1) if abs(q[0]) > abs(q[3]) else q).as_matrix(), float)
    return np.asarray(cv2.Rodrigues(value.ravel())[0], float) if value.size == 3 else value.reshape(3, 3)
