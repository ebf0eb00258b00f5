"""The way from both cameras' fringe frames to the organised cloud."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import DecodedView, Reconstruction
from metrology.decode import decode_phase
from metrology.depth_scatter import raised_sigma
from metrology.edges import flag_neighbourhoods, without_border
from metrology.epipolar import check_axis
from metrology.errors import RigError
from metrology.fringe import FringeCode
from metrology.gray import runs_along_rows
from metrology.reconstruction_settings import ReconstructionSettings
from metrology.rig import Device, Rig
from metrology.stereo import match
from metrology.stripe_scatter import scatter_ratio

__all__ = ["ReconstructionSettings", "check_axis", "coordinate_size", "decode", "reconstruct", "triangulate"]

_USUAL_PERIOD_PX = 16


def reconstruct(
    left_frames: NDArray,
    right_frames: NDArray,
    rig: Rig,
    code: FringeCode,
    exposures: Sequence[float] = (1.0,),
    settings: ReconstructionSettings | None = None,
) -> Reconstruction:
    """Organised cloud from the fringe frames of both cameras.

    Parameters
    ----------
    left_frames, right_frames : (exposures, code.frames, h, w) ndarray of uint8 or uint16
        Count-major, then step; Gray-code frames after them.
    exposures : sequence of float
        Exposure times relative to exposure 1.

    Raises
    ------
    SceneError
        Where the frames are not what the code says.
    RigError
        Where frames or fringes do not fit the rig.
    """
    check_axis(rig, code.axis)
    size = coordinate_size(rig, code)
    left = decode(left_frames, code, size, exposures, settings)
    right = decode(right_frames, code, size, exposures, settings)
    return triangulate(left, right, rig, settings)


def coordinate_size(rig: Rig, code: FringeCode) -> int:
    """W, in projector pixels: what the counts are counted over; a usual size where nothing tells the projector's."""
    if rig.projector is None or code.size_px is not None:
        return usual_size(code)
    return code.size(rig.projector.width, rig.projector.height)


def usual_size(code: FringeCode) -> int:
    """W as the code says, or of a usual projector."""
    return code.size_px or _USUAL_PERIOD_PX * max(code.counts or (code.gray.stripes if code.gray else 1,))


def decode(
    frames: NDArray,
    code: FringeCode,
    projector_size: int,
    exposures: Sequence[float] = (1.0,),
    settings: ReconstructionSettings | None = None,
) -> DecodedView:
    """One camera's view with its edges flagged; for reading one camera's frames while the other's are decoded.

    Parameters
    ----------
    frames : (exposures, code.frames, h, w) ndarray of uint8 or uint16
    projector_size : int
        Projector pixels along the fringe axis, ``code.size(width, height)``.
    """
    settings = settings or ReconstructionSettings()
    view = decode_phase(frames, code, projector_size, exposures, settings)
    return without_border(flag_neighbourhoods(view, code.texture_frames, settings))


def triangulate(
    left: DecodedView, right: DecodedView, rig: Rig, settings: ReconstructionSettings | None = None
) -> Reconstruction:
    """Match two decoded views and triangulate.

    Raises
    ------
    RigError
        Where the views are not of the size of the rig's cameras.
    """
    settings = settings or ReconstructionSettings()
    for name, view, device in (("left", left, rig.left), ("right", right, rig.with_right())):
        _check_size(name, view, device)
    points, sigma_z, flags = match(left, right, rig, settings)
    if left.stripe_px is not None:
        sigma_z *= scatter_ratio(left, points, sigma_z, flags)
    elif np.isfinite(left.coordinate).any():
        sigma_z = raised_sigma(points, sigma_z, flags, runs_along_rows(left.coordinate))
    return Reconstruction(rig=rig, left=left, right=right, points=points, sigma_z=sigma_z, flags=flags)


def _check_size(name: str, view: DecodedView, device: Device) -> None:
    height, width = view.coordinate.shape
    if (width, height) != (device.width, device.height):
        raise RigError(
            f"{name} camera: found frames of {width}×{height}, expected {device.width}×{device.height} as in the rig"
        )
