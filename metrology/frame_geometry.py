"""Which way the projector coordinate must run over a camera's image, and steps that are listed in reverse order.

Steps in reverse order leave no contradiction: every phase changes its sign, and the coordinate is mirrored.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrology.cloud import DecodedView, Reconstruction
from metrology.frame_diagnosis import direction_cosine
from metrology.frame_sample import Array
from metrology.fringe import Axis, FringeCode
from metrology.reconstruct import triangulate
from metrology.reconstruction_settings import ReconstructionSettings
from metrology.rig import Device, Rig
from metrology.rig_health import HealthSettings, epipolar_health

_STRIDE = 16
_LEAST_PIXELS = 30
# The coordinate runs backwards from this cosine on, between its gradient and the expected one.
_BACKWARDS = -0.5


def expected_gradient(camera: Device, projector: Device, axis: Axis) -> Array:
    """(2,) direction in the image (u, v) along which the projector coordinate rises, for a skin that faces the camera.

    The skin is where both optical axes pass each other closest; only the direction counts.
    """
    centre = np.array([camera.width, camera.height]) / 2
    ray, beam = camera.rays(centre), projector.rays(np.array([projector.width, projector.height]) / 2)
    between = projector.centre - camera.centre
    across = float(ray @ beam)
    reach = float(between @ ray - (between @ beam) * across) / (1 - across**2 + 1e-9)
    distance = reach if reach > 0 else 1e3 * float(np.linalg.norm(between))
    step = camera.width / 100
    pixels = centre + step * np.array([[-1, 0], [1, 0], [0, -1], [0, 1]])
    rays = camera.rays(pixels)
    points = camera.centre + distance * rays / (rays @ ray)[:, None]
    seen = projector.project(points)[:, 0 if axis == "x" else 1]
    return np.array([seen[1] - seen[0], seen[3] - seen[2]]) / (2 * step)


def runs_backwards(reconstruction: Reconstruction, axis: Axis) -> bool:
    """Whether the projector coordinate runs over both images against the way the rig expects."""
    rig = reconstruction.rig
    views = ((reconstruction.left, rig.left), (reconstruction.right, rig.right))
    return all(_cosine(view, expected_gradient(device, rig.projector, axis)) < _BACKWARDS for view, device in views)


def _cosine(view: DecodedView, expected: Array) -> float:
    coordinate = view.coordinate[::_STRIDE, ::_STRIDE]
    rows, columns = np.nonzero(np.isfinite(coordinate))
    if len(rows) < _LEAST_PIXELS:
        return 0.0
    return direction_cosine(columns, rows, coordinate[rows, columns].astype(float), expected)


def mirrored(view: DecodedView, size: int) -> DecodedView:
    """The view as its frames decode with the steps of each count in reverse order.

    Parameters
    ----------
    view : DecodedView
    size : int
        Projector pixels along the fringe axis.
    """
    return replace(view, coordinate=np.float32(size - 1) - view.coordinate)


def steps_are_reversed(
    reconstruction: Reconstruction,
    code: FringeCode,
    settings: ReconstructionSettings | None = None,
    health: HealthSettings | None = None,
) -> bool:
    """Whether the rig fits the scan once the steps of each count are read in reverse order."""
    rig: Rig = reconstruction.rig
    size = code.size(rig.projector.width, rig.projector.height)
    turned = triangulate(mirrored(reconstruction.left, size), mirrored(reconstruction.right, size), rig, settings)
    health = health or HealthSettings()
    judged = epipolar_health(turned, (), code.axis, health)
    return judged.projector_rms_px is not None and judged.projector_rms_px < health.refuse_px
