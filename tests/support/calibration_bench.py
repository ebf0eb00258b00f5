"""A bench for calibration tests: a rig, board poses, and what its devices would see, without any picture."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.calibration.board import Board
from metrology.calibration.bundle import State, predict
from metrology.calibration.eccentricity import eccentricity
from metrology.calibration.observations import DeviceName, Sighting, SightingKind
from metrology.calibration.projected_dots import ProjectedDots
from metrology.rig import Device, Rig

BOARD = Board("asymmetric_circles", 7, 11, 15.0, 8.0)
PATTERN = ProjectedDots(13, 16, 48.0, (40.0, 40.0), 24.0, 36.0, ((7, 6), (7, 7), (9, 6)))
SIZES: dict[DeviceName, tuple[int, int]] = {"left": (1600, 1200), "right": (1600, 1200), "projector": (1280, 800)}


def turn(x_deg: float, y_deg: float, z_deg: float) -> NDArray[np.float64]:
    """Rotation about x, then y, then z."""
    rotation = np.eye(3)
    for axis, angle in enumerate((x_deg, y_deg, z_deg)):
        vector = np.zeros(3)
        vector[axis] = np.radians(angle)
        rotation = np.asarray(cv2.Rodrigues(vector)[0]) @ rotation
    return rotation


def device(
    name: DeviceName, focal: float, distortion: tuple[float, ...], centre: tuple[float, ...], y_deg: float
) -> Device:
    """A device at `centre`, turned about y to look inwards."""
    width, height = SIZES[name]
    K = np.array([[focal, 0, width / 2 + 7.3], [0, 1.001 * focal, height / 2 - 4.1], [0, 0, 1]])
    R = turn(0.3, y_deg, 0.7) if name != "left" else np.eye(3)
    return Device(width, height, K, np.array(distortion), R, -R @ np.array(centre))


def bench_rig() -> Rig:
    return Rig(
        "bench",
        "2026-11-01T08:00:00Z",
        device("left", 3500.0, (-0.09, 0.12, 2e-4, -1e-4, 0.0), (0.0, 0.0, 0.0), 0.0),
        device("right", 3520.0, (-0.11, 0.08, -1e-4, 1e-4, 0.0), (280.0, 4.0, 40.0), 22.0),
        device("projector", 2500.0, (-0.03, 0.05, 3e-4, -2e-4, 0.0), (140.0, 8.0, -20.0), 11.0),
    )


_TILTS = ((0, 12, 3), (22, 0, -9), (-20, 18, 14), (15, 30, -4), (-18, 2, 172), (8, -9, -16), (-6, 24, 5), (20, 25, 178))


def bench_state(rig: Rig, poses: int = 8) -> State:
    """The true rig with boards before it."""
    rotations, translations = {}, {}
    for pose, tilt in enumerate(_TILTS[:poses]):
        rotations[pose] = turn(*tilt)
        middle = np.array([8 * (pose % 3 - 1), 5.0 * (pose % 2), 690.0 + 14 * (pose % 5 - 2)])
        translations[pose] = middle - rotations[pose] @ BOARD.points.mean(0)
    return State({"left": rig.left, "right": rig.right, "projector": rig.projector}, rotations, translations)


def see(
    state: State,
    rng: np.random.Generator,
    sigma_px: float = 0.01,
    devices: tuple[DeviceName, ...] = ("left", "right"),
    dots: bool = True,
) -> list[Sighting]:
    """Sightings of all poses as pictures would give them: noisy ellipse centres of what lies on image and board."""
    sightings = []
    for pose in state.rotations:
        for name in devices:
            kinds: tuple[SightingKind, ...] = ("board", "dots") if dots and name != "projector" else ("board",)
            for kind in kinds:
                sightings.append(_sighting(state, rng, sigma_px, name, pose, kind))
    return sightings


def _sighting(
    state: State, rng: np.random.Generator, sigma_px: float, name: DeviceName, pose: int, kind: SightingKind
) -> Sighting:
    known = BOARD.points[:, :2] if kind == "board" else PATTERN.centres
    radius = np.full(len(known), BOARD.radius_mm) if kind == "board" else PATTERN.radii
    if name == "projector":
        radius = np.zeros(len(known))
    draft = Sighting(kind, name, pose, np.arange(len(known)), known, radius, np.zeros((len(known), 2)), 1.0)
    pixels = predict(state, draft)
    if radius.any():
        pixels = pixels + eccentricity(lambda points: predict(state, draft, points), known, radius)
    pixels = pixels + rng.normal(0, sigma_px, pixels.shape)
    seen = state.devices[name].inside(pixels)
    if kind == "dots":
        seen &= _on_board(state, pose)
    return Sighting(kind, name, pose, np.arange(len(known)), known, radius, pixels, sigma_px).only(seen)


def _on_board(state: State, pose: int) -> NDArray[np.bool_]:
    """Which projected dots fall on the board."""
    rotation, translation = state.rotations[pose], state.translations[pose]
    projector = state.devices["projector"]
    rays = projector.rays(PATTERN.centres) @ rotation
    centre = (projector.centre - translation) @ rotation
    places = centre[:2] - rays[:, :2] * (centre[2] / rays[:, 2])[:, None]
    low, high = BOARD.points[:, :2].min(0) - 10, BOARD.points[:, :2].max(0) + 10
    return np.asarray(((places > low) & (places < high)).all(1))
