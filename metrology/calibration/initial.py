"""First values for the joint adjustment: Zhang's method per device, then their poses (paper §5.2, eqs 12 to 16)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from metrology.arrays import Array
from metrology.calibration.bundle import State
from metrology.calibration.observations import DeviceName, Sighting
from metrology.errors import CalibrationError
from metrology.rig import Device

LEAST_POSES = 3  # as many planes as a pinhole device needs; what fewer than six leave uncertain is said
_CAMERAS: tuple[DeviceName, ...] = ("left", "right")
_SAME_TURN_DEG = 1.0
_SAME_PLACE = 0.02  # of the distance to the board
_BAD_VIEW_PX = 2.0  # a view this far from the rest of its camera's is of another board or another camera
_BAD_VIEW_TIMES = 5.0

_DISAGREEING = (
    "frames of different poses or cameras mixed up",
    "it saw too few and too similar poses, or its frames are of other poses",
)


@dataclass(frozen=True)
class PlaneView:
    """Points of the board's plane (n, 2) mm and their pixels (n, 2) in one device, for one pose."""

    points: Array
    pixels: Array


@dataclass(frozen=True)
class SingleDevice:
    """A device by itself, and where the board stood to it: a point p of the board at R p + t in the device's frame."""

    device: Device
    rotations: dict[int, Array]
    translations: dict[int, Array]


def start_values(
    sightings: Sequence[Sighting], sizes: Mapping[DeviceName, tuple[int, int]]
) -> tuple[State, dict[int, str]]:
    """Devices and poses to start from, and the poses that contradict the others, with the reason.

    Parameters
    ----------
    sizes : mapping
        Width and height of every device in pixels.
    """
    refused: dict[int, str] = {}
    views = {name: _printed(sightings, name) for name in _CAMERAS if name in sizes}
    while True:
        cameras, bad = single_cameras(views, sizes)
        refused |= bad
        devices: dict[DeviceName, Device] = {"left": cameras["left"].device}
        if "right" not in cameras:
            break
        devices["right"], bad = _relative("right", cameras["right"], cameras["left"])
        if not bad:
            break
        refused |= bad
        views = _without(views, refused)
    poses = cameras["left"]
    if "projector" in sizes:
        kept = [s for s in sightings if s.pose not in refused]
        projected = _projector_views(kept, cameras)
        projector = _zhang("projector", projected, sizes["projector"])
        devices["projector"], bad = _relative("projector", projector, poses)
        refused |= bad
    keep = [p for p in poses.rotations if p not in refused]
    state = State(devices, {p: poses.rotations[p] for p in keep}, {p: poses.translations[p] for p in keep})
    return state, refused


def single_cameras(
    views: Mapping[DeviceName, Mapping[int, PlaneView]], sizes: Mapping[DeviceName, tuple[int, int]]
) -> tuple[dict[DeviceName, SingleDevice], dict[int, str]]:
    """Each camera by itself, and the poses in which one of them saw another board, with the reason."""
    refused: dict[int, str] = {}
    while True:
        cameras = {name: _zhang(name, views[name], sizes[name]) for name in views}
        bad = {p: reason for name, zhang in cameras.items() for p, reason in _strange_views(name, zhang, views[name])}
        if not bad:
            return cameras, refused
        refused |= bad
        views = _without(views, bad)


def _without(
    views: Mapping[DeviceName, Mapping[int, PlaneView]], bad: Mapping[int, str]
) -> dict[DeviceName, dict[int, PlaneView]]:
    return {name: {p: v for p, v in of.items() if p not in bad} for name, of in views.items()}


def _printed(sightings: Sequence[Sighting], name: DeviceName) -> dict[int, PlaneView]:
    return {s.pose: PlaneView(s.known, s.pixels) for s in sightings if s.kind == "board" and s.device == name}


def _projector_views(sightings: Sequence[Sighting], cameras: Mapping[DeviceName, SingleDevice]) -> dict[int, PlaneView]:
    """The projector's own view of each pose: decoded features, or dots carried to the plane by the cameras."""
    views = _printed(sightings, "projector")
    carried: dict[int, list[PlaneView]] = {}
    for sighting in sightings:
        if sighting.kind == "dots" and sighting.pose in cameras[sighting.device].rotations:
            camera = cameras[sighting.device]
            points = to_board(
                camera.device, sighting.pixels, camera.rotations[sighting.pose], camera.translations[sighting.pose]
            )
            carried.setdefault(sighting.pose, []).append(PlaneView(points, sighting.known))
    for pose, of in carried.items():
        views.setdefault(
            pose, PlaneView(np.concatenate([v.points for v in of]), np.concatenate([v.pixels for v in of]))
        )
    return views


def to_board(device: Device, pixels: Array, rotation: Array, translation: Array) -> Array:
    """(n, 2) points of the board's plane, mm, that a device sees at pixels (n, 2); the pose is in the rig frame."""
    rays = device.rays(pixels) @ rotation
    centre = (device.centre - translation) @ rotation
    return np.asarray(centre[:2] - rays[:, :2] * (centre[2] / rays[:, 2])[:, None])


def _zhang(name: DeviceName, views: Mapping[int, PlaneView], size: tuple[int, int]) -> SingleDevice:
    """Intrinsics and poses of one device alone, in its own frame (eqs 12, 13)."""
    if len(views) < LEAST_POSES:
        raise CalibrationError(
            f"{name}: found {len(views)} usable poses of the board, expected at least {LEAST_POSES} tilted differently"
        )
    poses = sorted(views)
    points = [np.column_stack([views[p].points, np.zeros(len(views[p].points))]).astype(np.float32) for p in poses]
    pixels = [views[p].pixels.astype(np.float32) for p in poses]
    # The third radial term only follows noise at this stage.
    found = cv2.calibrateCamera(points, pixels, size, np.eye(3), np.zeros(5), flags=cv2.CALIB_FIX_K3)
    K, distortion = np.asarray(found[1], float), np.asarray(found[2], float)
    if not (np.isfinite(K).all() and 0.2 < K[0, 0] / K[1, 1] < 5 and K[0, 0] < 100 * max(size)):
        raise CalibrationError(
            f"{name}: no camera explains the board's poses; expected boards tilted in different ways"
        )
    device = Device(size[0], size[1], K, distortion.ravel()[:5], np.eye(3), np.zeros(3))
    return SingleDevice(
        device,
        {p: np.asarray(cv2.Rodrigues(r)[0], float) for p, r in zip(poses, found[3], strict=True)},
        {p: np.asarray(t, float).ravel() for p, t in zip(poses, found[4], strict=True)},
    )


def _strange_views(name: DeviceName, zhang: SingleDevice, views: Mapping[int, PlaneView]) -> list[tuple[int, str]]:
    rms = {}
    for pose, view in views.items():
        points = view.points @ zhang.rotations[pose][:, :2].T + zhang.translations[pose]
        rms[pose] = float(np.sqrt(np.mean(np.sum(np.square(zhang.device.project(points) - view.pixels), axis=1))))
    typical = float(np.median(list(rms.values())))
    worst = max(rms, key=lambda p: rms[p])
    if rms[worst] <= max(_BAD_VIEW_PX, _BAD_VIEW_TIMES * typical):
        return []
    reason = (
        f"{name}: the board is {rms[worst]:.1f} px off what the other poses expect ({typical:.2f} px): another board"
    )
    return [(worst, reason)]


def _relative(name: DeviceName, of: SingleDevice, left: SingleDevice) -> tuple[Device, dict[int, str]]:
    """Pose of a device in the left camera's frame, with the poses of the board that contradict it.

    Each pose of the board that both devices saw gives R = R_p R_c⁻¹ (eq 15) and t = t_p − R_p R_c⁻¹ t_c (eq 16), so
    that p_p = R p_c + t (eq 14); the largest group of poses that agree counts.
    """
    common = sorted(set(of.rotations) & set(left.rotations))
    turns = {p: of.rotations[p] @ left.rotations[p].T for p in common}
    shifts = {p: of.translations[p] - turns[p] @ left.translations[p] for p in common}
    reach = {p: float(np.linalg.norm(left.translations[p])) for p in common}

    def agree(a: int, R: Array, t: Array) -> bool:
        return same_place(turns[a], shifts[a], R, t, reach[a])

    groups = [[a for a in common if agree(a, turns[b], shifts[b])] for b in common]
    group = max(groups, key=len, default=[])
    if len(group) < LEAST_POSES or 2 * len(group) <= len(common):
        raise CalibrationError(
            f"{name}: found {len(group)} of {len(common)} poses of the board that agree on where it stands to the left "
            f"camera, expected at least {LEAST_POSES} and most of them: {_DISAGREEING[name == 'projector']}"
        )
    u, _, vt = np.linalg.svd(np.sum([turns[p] for p in group], axis=0))
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    shift = np.mean([shifts[p] for p in group], axis=0)
    bad = {}
    for p in set(common) - set(group):
        swapped = turn_deg(turns[p], rotation.T) < _SAME_TURN_DEG and name == "right"
        bad[p] = (
            "left and right frames are swapped"
            if swapped
            else f"{name}: stands {turn_deg(turns[p], rotation):.1f}° and {np.linalg.norm(shifts[p] - shift):.0f} mm "
            "off the other poses: frames of another pose, or the board moved between the pictures"
        )
    return replace(of.device, R=rotation, t=shift), bad


def same_place(R: Array, t: Array, other_R: Array, other_t: Array, reach_mm: float) -> bool:
    """Whether two poses of a device agree as well as start values can; `reach_mm` is the board's distance."""
    return bool(np.linalg.norm(t - other_t) < _SAME_PLACE * reach_mm and turn_deg(R, other_R) < _SAME_TURN_DEG)


def turn_deg(a: Array, b: Array) -> float:
    """Angle between two rotations, degrees."""
    return float(np.degrees(np.arccos(np.clip((np.trace(a.T @ b) - 1) / 2, -1, 1))))
