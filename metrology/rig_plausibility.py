"""Whether a rig can be a real one: its devices, and where they stand to each other.

A file in another unit or convention (metres, transposed rotations, right to left in place of left to right) is a
perfectly good rig to the equations; it just cannot be built, or could not see one place with all its devices.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.device_plausibility import check_device
from metrology.errors import RigError
from metrology.rig import Device, Rig

Moving = Literal["right", "projector"]

LEAST_APART_MM, LARGEST_APART_MM = 10.0, 10_000.0
LEAST_WORKING_MM, LARGEST_WORKING_MM = 80.0, 6_000.0
LEAST_MM_PER_PX, LARGEST_MM_PER_PX = 0.02, 2.5
# Two cameras with lenses of their own hardly stand nearer to each other, or to what they measure; numbers in cm do.
_NEAR_MM, _NEAR_WORKING_MM = 40.0, 120.0
_LEAST_SHARED = 0.3  # of the left camera's field: what the right one must see of it
_LEAST_LIT = 0.3  # of what both cameras see: what the projector must reach of it
_NEAR_BEST = 0.9  # of the largest shared field: where the fields cross, they do so at the working distance
_OPEN = 0.3  # of the largest shared field: cameras that look almost alike share it from here on
_DIVERGING_DEG = 5.0  # more than cameras that were meant to be parallel ever do
_PLACES = 7  # per axis of the left image
_DISTANCES_MM = np.geomspace(10.0, 30_000.0, 101)
_UNITS = {
    "metres": 1000.0,
    "centimetres": 10.0,
    "inches": 25.4,
    "micrometres, or in mm where its unit was given as metres": 1e-3,
}


@dataclass(frozen=True)
class _Misplaced:
    """A device that cannot stand where the rig says."""

    device: Moving
    found: str
    expected: str

    def told(self, likely: str) -> str:
        return f"{self.device}: found {self.found}, expected {self.expected}{likely}"


def check_rig(rig: Rig) -> None:
    """RigError that names the device, what was found and expected, and what it most likely is."""
    for name, device in rig.devices.items():
        try:
            check_device(device, projector=name == "projector")
        except RigError as problem:
            raise RigError(f"{name}: {problem}") from None
    with np.errstate(all="ignore"):
        misplaced = _misplaced(rig)
        likely = _likely(rig, misplaced) if misplaced else ""
    if misplaced is not None:
        raise RigError(misplaced.told(likely))


def _misplaced(rig: Rig) -> _Misplaced | None:
    return _distance(rig) or _shared_field(rig)


def _distance(rig: Rig) -> _Misplaced | None:
    """Devices that stand within each other, or farther apart than any frame is long."""
    pairs: list[tuple[Moving, Device, Device, str]] = []
    if rig.right:
        pairs += [("right", rig.right, rig.left, "left camera")]
    if rig.projector:
        pairs += [("projector", rig.projector, camera, f"{name} camera") for name, camera in rig.cameras.items()]
    for name, device, other, named in pairs:
        apart = float(np.linalg.norm(device.centre - other.centre))
        if not LEAST_APART_MM <= apart <= LARGEST_APART_MM:
            expected = f"{LEAST_APART_MM:g} to {LARGEST_APART_MM:g} mm"
            return _Misplaced(name, f"its centre {apart:.4g} mm from the {named}'s (t)", expected)
    return None


def doubtful_unit(rig: Rig) -> str | None:
    """Asks for the unit of a rig of two cameras that can be built in mm, but is far more usual in centimetres."""
    if rig.right is None or _usual(rig.left, rig.right):
        return None
    larger = replace(rig.right, t=10 * rig.right.t)
    if not _usual(rig.left, larger) or _misplaced(replace(rig, right=larger, projector=None)):
        return None
    in_mm, in_cm = (_told_distances(rig.left, device) for device in (rig.right, larger))
    return (
        f"right: found t without a unit, and in mm {in_mm}, in cm {in_cm}: expected --unit mm, --unit cm, or the "
        "millimetres of one (of a board's square, where lengths are counted in squares)"
    )


def _usual(left: Device, right: Device) -> bool:
    """Whether two cameras stand as far apart, and look as far, as cameras with lenses of their own do."""
    away = _meeting_mm(left, right)
    return bool(np.linalg.norm(right.centre) >= _NEAR_MM and (away is None or away >= _NEAR_WORKING_MM))


def _meeting_mm(left: Device, right: Device) -> float | None:
    """How far away two axes meet, along the left one; None where they lead apart or are almost parallel."""
    a, b = _axes(left, right)
    along = _along(a, b, right)
    return float(along[0] * a[2]) if along.min() > 0 and angle_deg(a, b) > 1.0 else None


def _told_distances(left: Device, right: Device) -> str:
    away = _meeting_mm(left, right)
    meet = "" if away is None else f", their axes meeting {away:.3g} mm away"
    return f"the cameras stand {np.linalg.norm(right.centre):.3g} mm apart{meet}"


def stands_left(right: Device) -> bool:
    """Whether a right camera stands to the left of the left one; cameras rolled against each other have no sides."""
    base = right.centre
    return bool(base[0] < -0.5 * np.linalg.norm(base) and right.R[0, 0] > 0)


def _shared_field(rig: Rig) -> _Misplaced | None:
    """Devices that look apart, or meet where no scan is taken; a projector that lights another place."""
    name: Moving = "right" if rig.right else "projector"
    second = rig.right or rig.projector
    if second is None:
        return None
    distances = np.sort(np.append(_DISTANCES_MM, _crossing(rig.left, second)))
    seen = _sees(second, rig.left, distances)
    shared = seen.mean(1)
    if shared.max() < _LEAST_SHARED:
        what = "cameras that look apart: it sees" if rig.right else "it lighting"
        found = f"{what} {shared.max():.0%} of the left camera's field at best"
        return _Misplaced(name, found, "both to see the same place (R and t)")
    if (apart := _diverging(rig.left, second)) > _DIVERGING_DEG:
        return _Misplaced(name, f"axes that lead {apart:.0f}° apart", "both to see the same place (R and t)")
    crossing = shared[-1] < _OPEN * shared.max()
    fitting = shared >= (_NEAR_BEST if crossing else _OPEN) * shared.max()
    per_px = distances / np.sqrt(rig.left.K[0, 0] * rig.left.K[1, 1])
    usual = (distances >= LEAST_WORKING_MM) & (distances <= LARGEST_WORKING_MM)
    usual &= (per_px >= LEAST_MM_PER_PX) & (per_px <= LARGEST_MM_PER_PX)
    if not (fitting & usual).any():
        best = int(np.argmax(shared))
        return _Misplaced(
            name,
            f"fields of view that meet {distances[best]:.0f} mm away at {per_px[best]:.2g} mm a pixel",
            f"{LEAST_WORKING_MM:g} to {LARGEST_WORKING_MM:g} mm and {LEAST_MM_PER_PX:g} to {LARGEST_MM_PER_PX:g} mm a "
            "pixel",
        )
    if rig.projector is None or rig.right is None:
        return None
    lit = (seen & _sees(rig.projector, rig.left, distances)).mean(1)[fitting & usual] / shared[fitting & usual]
    if lit.max() < _LEAST_LIT:
        found = f"it lighting {lit.max():.0%} of what both cameras see"
        return _Misplaced("projector", found, f"at least {_LEAST_LIT:.0%} (its R and t, or the right camera's)")
    return None


def _crossing(left: Device, second: Device) -> Array:
    """Distances at which the middles of two images come nearest to each other: narrow fields cross only here."""
    a, b = _axes(left, second)
    along = _along(a, b, second)[0] * a[2]
    return along * np.array([0.97, 1.0, 1.03]) if np.isfinite(along) and along > 0 else np.empty(0)


def _axes(left: Device, second: Device) -> tuple[Array, Array]:
    """Rays through the middles of two images."""
    return left.rays((left.width / 2, left.height / 2)), second.rays((second.width / 2, second.height / 2))


def _along(a: Array, b: Array, second: Device) -> Array:
    """How far along each of two rays, from its own device, they come nearest to each other, mm."""
    return np.asarray(np.linalg.lstsq(np.stack([a, -b], axis=1), second.centre, rcond=None)[0], float)


def _diverging(left: Device, second: Device) -> float:
    """Degrees by which axes lead apart; 0 where they meet before the cameras."""
    a, b = _axes(left, second)
    return 0.0 if _along(a, b, second).min() > 0 else angle_deg(a, b)


def angle_deg(a: Array, b: Array) -> float:
    """Angle between two directions."""
    return float(np.degrees(np.arccos(np.clip(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)), -1, 1))))


def rig_facts(rig: Rig) -> list[str]:
    """What a person can hold against the rig that stands there: sizes, fields, distances."""
    lines = []
    for name, device in rig.devices.items():
        field = 2 * np.degrees(np.arctan(device.width / (2 * device.K[0, 0])))
        bare = "" if device.distortion.any() else ", no lens distortion"
        place = ""
        if name != "left":
            x, y, z = device.centre
            place = f"; {np.linalg.norm(device.centre):.4g} mm from the left camera ({x:.4g}, {y:.4g}, {z:.4g})"
            if (away := _meeting_mm(rig.left, device)) is not None:
                angle = angle_deg(*_axes(rig.left, device))
                place += f", their axes meet {away:.4g} mm away at {angle:.0f}°, where a pixel is "
                place += f"{away / rig.left.K[0, 0]:.2g} mm"
        if name == "right" and stands_left(device):
            place += "; to its LEFT: where it stands elsewhere, R and t are the inverse, or the cameras are exchanged"
        lines.append(f"{name}: {device.width}×{device.height} px, {field:.0f}° wide{bare}{place}")
    return lines


def _sees(device: Device, left: Device, distances: Array) -> NDArray[np.bool_]:
    """(distances, places) which places of the left camera's field lie in a device's, its distortion left aside."""
    u, v = np.meshgrid(*(np.linspace(0, side - 1, _PLACES) for side in (left.width, left.height)))
    rays = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)]) @ np.linalg.inv(left.K).T
    points = distances[:, None, None] * rays @ device.R.T + device.t
    pixels = points @ device.K.T
    before = points[..., 2] > 0
    return np.asarray(before & device.inside(pixels[..., :2] / np.where(before, points[..., 2], 1.0)[..., None]))


def _likely(rig: Rig, misplaced: _Misplaced) -> str:
    """The convention in which the rig would be a sound one, as the end of a message."""
    device = rig.devices[misplaced.device]
    fitting = []
    for said, changed in conventions(device):
        right = misplaced.device == "right"
        meant = replace(rig, right=changed) if right else replace(rig, projector=changed)
        left_to_fix = _misplaced(meant)
        if right and stands_left(changed):  # a rig may be so, but then it is no slip of a convention
            continue
        if left_to_fix is None or (right and left_to_fix.device == "projector"):
            fitting.append(said)
    if not fitting:
        return ""
    return f": most likely {' or '.join(fitting[:2])}"


def conventions(device: Device) -> Iterator[tuple[str, Device]]:
    """What else R and t may have been meant as; units first."""
    for unit, scale in _UNITS.items():
        yield f"t is in {unit}", replace(device, t=scale * device.t)
    yield from poses(device)


def poses(device: Device) -> Iterator[tuple[str, Device]]:
    """What else R and t may have been meant as, in the same unit."""
    R, t = device.R, device.t
    yield "R and t are the inverse (from this device to the left camera)", replace(device, R=R.T, t=-R.T @ t)
    yield "t is the device's place in the left camera's frame, −Rᵀt", replace(device, t=-R @ t)
    yield "R is transposed", replace(device, R=R.T)
    yield "t has the other sign", replace(device, t=-t)
