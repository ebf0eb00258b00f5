"""From an organised cloud and its picture to what the steps after reconstruction take."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Float32
from metrology.cloud import DecodedView, PixelFlag, Reconstruction
from metrology.cloud_noise import estimate_sigma
from metrology.edges import flag_neighbourhoods
from metrology.errors import SceneError
from metrology.noise import NoiseModel
from metrology.reconstruction_settings import ReconstructionSettings
from metrology.rig import Rig
from metrology.rig_health import RigHealth
from metrology.robust import MAD

_QUANTISATION = 1.0 / 12.0
# The Laplacian of neighbours' Laplacians sees noise and hardly a skin; it is 6 standard deviations wide.
_NOISE_MASK = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
_NOISE_GAIN = 6.0
_LEVELS = 8
# Pixels darker than this share of the skin's brightness have no point because no light came back.
_DARK = 0.25
_STRIDE = 16
_DOUBTFUL_PX, _REFUSED_PX = 0.5, 2.0


def scanned(
    points: Float32,
    texture: Float32,
    sigma: Float32 | None,
    saturation: float,
    rig: Rig,
    settings: ReconstructionSettings | None = None,
    digest: str | None = None,
) -> Reconstruction:
    """The reconstruction that a scanner's cloud stands for.

    Parameters
    ----------
    points : (h, w, 3) ndarray of float32
        In the rig's frame, mm; NaN where there is none.
    texture : (h, w) ndarray of float32
        The picture that the left camera took, grey levels.
    sigma : (h, w) ndarray of float32, optional
        Standard deviation of the depths, mm; estimated from the points where it is not known.
    saturation : float
        Grey level from which the picture is saturated.
    rig : Rig
        Its left camera took the picture.
    digest : str, optional
        Names the content of the cloud's files.
    """
    settings = settings or ReconstructionSettings()
    low, high = settings.depth_range_mm
    depth = points[..., 2]
    valid = np.isfinite(points).all(axis=-1) & (depth > low) & (depth < high)
    if not valid.any():
        raise SceneError(f"found no point {low:g} to {high:g} mm before the camera, expected a skin")
    points = np.where(valid[..., None], points, np.float32(np.nan))
    flags = _why_missing(valid, texture)
    flags[texture >= saturation] |= np.uint16(PixelFlag.SATURATED_SAMPLES)
    if sigma is None:
        plain = valid & (_with_edges(points, np.full(depth.shape, np.inf, np.float32), texture, flags, settings) == 0)
        sigma = estimate_sigma(points, plain)
    sigma = np.where(valid, sigma, np.float32(np.nan)).astype(np.float32)
    flags = _with_edges(points, sigma, texture, flags, settings)
    unknown = np.full(depth.shape, np.nan, np.float32)
    left = DecodedView(unknown, unknown, unknown, texture, flags)
    return Reconstruction(rig, left, None, points, sigma, flags, digest)


def ray_health(reconstruction: Reconstruction) -> RigHealth:
    """Whether the points lie on the rays of their pixels; whether the scanner measures right, they do not tell."""
    points = reconstruction.points[::_STRIDE, ::_STRIDE].reshape(-1, 3)
    v, u = np.indices(reconstruction.flags.shape)[:, ::_STRIDE, ::_STRIDE].reshape(2, -1)
    known = np.isfinite(points[:, 2])
    off = reconstruction.rig.left.project(points[known]) - np.stack([u, v], axis=1)[known]
    rms = float(np.sqrt(np.median(np.sum(off**2, axis=1))))
    if rms <= _DOUBTFUL_PX:
        return RigHealth(None, None, 0, None, 0, "ok", None)
    said = f"points lie {rms:.2g} px off the rays of their pixels, expected at most {_DOUBTFUL_PX:g} px"
    if rms <= _REFUSED_PX:
        return RigHealth(None, None, 0, None, 0, "warning", f"{said}: give the rig of the camera that took the picture")
    return RigHealth(None, None, 0, None, 0, "refused", said)


def _why_missing(valid: NDArray[np.bool_], texture: Float32) -> NDArray[np.uint16]:
    """Flags of pixels without a point: too dark, or for a reason that the scanner keeps to itself."""
    flags = np.zeros(valid.shape, np.uint16)
    dark = texture < _DARK * np.median(texture[valid])
    flags[~valid & dark] = PixelFlag.LOW_MODULATION
    flags[~valid & ~dark] = PixelFlag.UNMATCHED
    return flags


def _with_edges(
    points: Float32, sigma: Float32, texture: Float32, flags: NDArray[np.uint16], settings: ReconstructionSettings
) -> NDArray[np.uint16]:
    """Flags with EDGE along the edges of picture and depth, and beside missing points.

    The inverse of depth is linear in the pixels of a plane, as a projector's coordinate nearly is.
    """
    depth = points[..., 2]
    middle = np.float32(np.nanmedian(depth))
    view = DecodedView(
        coordinate=middle * middle / depth,
        sigma=sigma * (middle / depth) ** 2,
        modulation=texture,
        texture=texture,
        flags=flags,
        noise=_picture_noise(texture),
    )
    return flag_neighbourhoods(view, 1, settings).flags


def _picture_noise(texture: Float32) -> NoiseModel:
    """Noise of the picture's grey levels, from what neighbouring pixels do not share, dark and bright parts apart."""
    rough = np.abs(cv2.filter2D(texture, cv2.CV_32F, _NOISE_MASK, borderType=cv2.BORDER_REFLECT))[1:-1:2, 1:-1:2]
    level = texture[1:-1:2, 1:-1:2]
    edges = np.quantile(level, np.linspace(0, 1, _LEVELS + 1))
    found = []
    for low, high in pairwise(edges):
        inside = (level >= low) & (level <= high)
        if inside.any():
            found.append((float(level[inside].mean()), float((MAD * np.median(rough[inside]) / _NOISE_GAIN) ** 2)))
    mean, variance = np.array(found).T
    gain = 0.0
    if np.ptp(mean) > 0:
        gain = max(float(np.polyfit(mean, variance, 1)[0]), 0.0)
    return NoiseModel(max(float(np.median(variance - gain * mean)), _QUANTISATION), gain)
