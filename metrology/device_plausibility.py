"""Whether a device's K, size and distortion can be those of a real camera or projector.

The limits are those of what is built, many times wider than a rig for fringe projection needs; what lies beyond them
comes from a file written in another convention, and the message says in which.
"""

from __future__ import annotations

import numpy as np

from metrology.arrays import Array
from metrology.errors import RigError
from metrology.rig import Device

LEAST_FIELD_DEG, LARGEST_FIELD_DEG = 1.0, 120.0  # across the image's diagonal
_LARGEST_ASPECT = 2.5  # of the focal lengths: the pixels of diamond arrays and of binned cameras are 1 : 2
_LENS_SHIFT = 0.25  # of the side: how far outside its image a projector's principal point may lie
_MARGIN = -0.01  # of the side: a camera's lies inside its image, and not on its very edge
_RECTIFIED = 1.0  # of the side: so far outside lie those of converging cameras whose images were rectified
_ROUNDING = 1e-6  # of the focal length
_OFF_CENTRE = 0.06  # of the longer side: a principal point farther off may tell of exchanged sides
_EXCHANGED = 0.2  # of its distance from the middle: how near it then comes to the middle of the exchanged image
_LARGEST_TANGENTIAL = 0.03  # of the distance from the principal point
_FISHEYE_TERM = 0.01  # p1, p2 of a lens with four terms; the third and fourth term of a fisheye lens are larger
_OTHER_SIZE = 0.3  # by which both sides' scale of the image that K belongs to departs from 1
_SAME_SCALE = 0.04
_RADII = 400
_LARGEST_STRETCH = 2.0  # of the corner's distance from the principal point: pincushion lenses reach a tenth of it
_REACH = 4.0  # times the image's own radius: as far as a lens may pull the image in


def check_device(device: Device, projector: bool = False) -> None:
    """RigError that says what is wrong and what it most likely is.

    Parameters
    ----------
    projector : bool
        Whether the lens may be shifted so that the principal point lies beyond the image.
    """
    with np.errstate(all="ignore"):
        _check_matrix(device.K)
        _check_field(device)
        of_camera = _MARGIN if device.distortion.any() else _RECTIFIED
        _check_principal_point(device, _LENS_SHIFT if projector else of_camera)
        check_distortion(device)


def _check_matrix(K: Array) -> None:
    """K is [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]."""
    tolerance = _ROUNDING * max(K[0, 0], K[1, 1])
    if np.abs(K[2, :2]).max() > tolerance:
        transposed = ": K is transposed" if np.abs(K[:2, 2]).max() <= tolerance else ""
        raise RigError(f"K: found {_numbers(K[2])} in the last row, expected 0, 0, 1{transposed}")
    if abs(K[2, 2] - 1) > _ROUNDING:
        raise RigError(f"K: found {K[2, 2]:g} in the last place, expected 1: K is scaled, or is no intrinsic matrix")
    if max(abs(K[0, 1]), abs(K[1, 0])) > tolerance:
        skew = K[0, 1] if K[0, 1] else K[1, 0]
        raise RigError(f"K: found a skew of {skew:g} px, expected 0: the model has rectangular pixels")


def _check_field(device: Device) -> None:
    fx, fy = device.K[0, 0], device.K[1, 1]
    if max(fx / fy, fy / fx) > _LARGEST_ASPECT:
        raise RigError(f"K: found focal lengths {fx:g} and {fy:g} px, expected nearly equal ones")
    field = float(np.degrees(2 * np.arctan(np.hypot(device.width / fx, device.height / fy) / 2)))
    if not LEAST_FIELD_DEG <= field <= LARGEST_FIELD_DEG:
        millimetres = ": they are in millimetres, or K is that of smaller images" if field > LARGEST_FIELD_DEG else ""
        raise RigError(
            f"K: found focal lengths {fx:g} and {fy:g} px, a field of view of {field:.3g}° across "
            f"{device.width}×{device.height} px, expected {LEAST_FIELD_DEG:g}° to {LARGEST_FIELD_DEG:g}°{millimetres}"
        )


def _check_principal_point(device: Device, beyond: float) -> None:
    point, size = device.K[:2, 2], np.array([device.width, device.height], float)
    off, exchanged = (float(np.linalg.norm(point - middle)) for middle in (size / 2, size[::-1] / 2))
    if off > _OFF_CENTRE * size.max() and exchanged < _EXCHANGED * off:
        raise RigError(
            f"size: found {device.width}×{device.height} with the principal point at {_numbers(point)}, expected it "
            "near the middle: width and height are exchanged"
        )
    scales = 2 * point / size
    if abs(scales.mean() - 1) > _OTHER_SIZE and np.ptp(scales) < _SAME_SCALE * abs(scales.mean()):
        raise RigError(
            f"K: found the principal point at {_numbers(point)} in an image of {device.width}×{device.height}, "
            f"expected it near the middle: K is that of images {scales.mean():.2g} times the size"
        )
    if ((point < -beyond * size) | (point > (1 + beyond) * size)).any():
        inside = f"at most {beyond:g} of a side outside" if beyond > 0 else "inside"
        raise RigError(
            f"K: found the principal point at {_numbers(point)}, expected it {inside} the {device.width}×"
            f"{device.height} image: cx and cy are wrong, or K is that of images of another size"
        )


def check_distortion(device: Device) -> None:
    """Refuse distortion that no lens has, or that is not one-to-one over the image; RigError."""
    terms = device.lens
    p1, p2 = terms[2:4]
    if device.distortion.size == 4 and max(abs(p1), abs(p2)) > _FISHEYE_TERM:
        raise RigError(
            f"distortion: found the terms {_numbers(device.distortion)}, expected k1, k2, p1, p2 with small p1 and p2: "
            "most likely k1 to k4 of a fisheye lens, which this model is not"
        )
    size = np.array([[0, 0], [device.width, 0], [0, device.height], [device.width, device.height]], float)
    corner = float(np.linalg.norm((size - device.K[:2, 2]) / np.diag(device.K)[:2], axis=1).max())
    tangential = 3 * float(np.hypot(p1, p2)) * corner
    if tangential > _LARGEST_TANGENTIAL:
        raise RigError(
            f"distortion: found p1, p2 of {p1:g}, {p2:g}, which move the image's corner by {tangential:.0%}, expected "
            f"at most {_LARGEST_TANGENTIAL:.0%}: the terms are in another order (k1, k2, p1, p2, k3), or a fisheye's"
        )
    prism = float(np.abs(terms[8:] * corner ** np.array([1, 3, 1, 3])).max())
    if prism > _LARGEST_TANGENTIAL:
        raise RigError(
            f"distortion: found a thin prism's terms {_numbers(terms[8:])}, which move the image's corner by "
            f"{prism:.0%}, expected at most {_LARGEST_TANGENTIAL:.0%}"
        )
    stretched = float(_distorted(np.array(corner), terms)) / corner
    if stretched > _LARGEST_STRETCH:
        raise RigError(
            f"distortion: found {_numbers(device.distortion)}, which moves the image's corner to {stretched:.3g} times "
            f"its distance from the middle, expected at most {_LARGEST_STRETCH:g}: another order or unit of the terms"
        )
    reached = _turning_radius(terms, corner)
    if reached < corner:
        raise RigError(
            f"distortion: found {_numbers(device.distortion)}, which folds the image over at {reached / corner:.0%} of "
            "the way to its corner, expected one-to-one: another lens model (fisheye), another order of the terms, or "
            "terms that were fitted where the board never was"
        )


def _turning_radius(terms: Array, corner: float) -> float:
    """Distorted radius up to which the radial distortion grows with the radius; `corner` where it suffices."""
    distorted = _distorted(np.linspace(0, _REACH * corner, _RADII), terms)
    falls = ~(np.diff(distorted) > 0)
    end = int(np.argmax(falls)) if falls.any() else len(distorted) - 1
    return min(float(distorted[end]), corner)


def _distorted(radius: Array, terms: Array) -> Array:
    """r (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶), in focal lengths; NaN beyond a pole."""
    square = radius**2
    k1, k2, _, _, k3, k4, k5, k6 = terms[:8]
    below = 1 + square * (k4 + square * (k5 + square * k6))
    above = radius * (1 + square * (k1 + square * (k2 + square * k3)))
    return np.asarray(np.where(below > 0, above / below, np.nan))


def _numbers(values: Array) -> str:
    return ", ".join(f"{value:.6g}" for value in values)
