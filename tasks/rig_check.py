"""Whether a rig still fits a scene, and what to say where it does not."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import PixelFlag, Reconstruction
from metrology.common_sight import LEAST_ALIKE, rims_alike
from metrology.errors import FlushlineError, RigError, SceneError
from metrology.gray import runs_along_rows
from metrology.mix_ups import find_mix_up
from metrology.reconstruct import coordinate_size, reconstruct
from metrology.results import RivetDetection
from metrology.rig import Rig
from metrology.rig_health import HealthSettings, RigHealth, epipolar_health
from storage.scene import Scene, load_scene

# Of the pixels that both cameras decode a sound rig matches most; a tenth is no small overlap but the wrong lines.
_LEAST_MATCHED = 0.1
# A rig drifts into a warning by hundredths of a pixel; undistorted frames bring half a pixel at once.
_HARDLY_PX = 0.1


def check_scene(rig: Rig, folder: Path, settings: HealthSettings | None = None) -> tuple[RigHealth, Reconstruction]:
    """Reconstruct a scene with a rig and judge the rig by it; nothing is stored. The cloud comes with the judgement.

    Raises
    ------
    SceneError
        Where mixed up frames explain that the rig does not fit.
    """
    scene = load_scene(folder)
    scene.check_fits(rig)
    reconstruction = reconstruct(scene.frames("left"), scene.frames("right"), rig, scene.code, scene.exposures)
    health = epipolar_health(reconstruction, axis=scene.code.axis, settings=settings)
    if doubtful(health) and (problem := mixed_up(scene, reconstruction, settings)):
        raise problem
    return health, reconstruction


def doubtful(health: RigHealth) -> bool:
    """Whether mixed up frames could be why: the rig does not fit or hardly, or points are too few to tell."""
    off = health.projector_rms_px
    if off is None:
        return health.verdict != "ok"
    return health.verdict == "refused" or (health.verdict == "warning" and off > _HARDLY_PX)


def mixed_up(scene: Scene, reconstruction: Reconstruction, settings: HealthSettings | None = None) -> SceneError | None:
    """What is to be said where a mix-up of the frames explains that they do not fit the rig."""
    rig = reconstruction.rig
    found = find_mix_up(reconstruction, scene.code.axis, coordinate_size(rig, scene.code), settings)
    if found is None:
        return None
    return SceneError(
        f"{scene.folder}: found that the frames fit rig {rig.id!r} when {found.when}, expected {found.expected}"
    )


def other_skin(scene: Scene, reconstruction: Reconstruction, detections: Sequence[RivetDetection]) -> SceneError | None:
    """What is to be said where the right camera does not see the rims that the left one sees."""
    alike = rims_alike(reconstruction, detections)
    if alike is None or alike >= LEAST_ALIKE:
        return None
    return SceneError(
        f"{scene.folder}: found rims in the left camera's pictures that are not in the right one's (correlation "
        f"{alike:.2f}, expected at least {LEAST_ALIKE:g}), expected frames of one scan: those of one camera are "
        "another scan's"
    )


def _along_the_baseline(scene: Scene, reconstruction: Reconstruction) -> SceneError | None:
    """What is to be said where the decoded coordinate does not change from camera to camera, but across that."""
    base = np.abs(reconstruction.rig.with_right().centre)
    _, views = zip(*reconstruction.cameras.values(), strict=True)
    beside = bool(base[0] > base[1])
    if any(runs_along_rows(view.coordinate) == beside for view in views):
        return None
    way, other = ("down", "y" if scene.code.axis == "x" else "x") if beside else ("across", "x")
    return SceneError(
        f"{scene.folder}: found a coordinate that changes {way} the images of cameras that stand "
        f"{'beside' if beside else 'above'} each other, as fringes along their line leave it, expected fringes across "
        f"that line: the frames of the projector's other axis (most likely these are of axis {other!r})"
    )


def _share(pixels: NDArray[Any]) -> float:
    """Of the pixels those that are not zero."""
    return np.count_nonzero(pixels) / pixels.size


def unmatched(
    scene: Scene, reconstruction: Reconstruction, settings: HealthSettings | None = None
) -> FlushlineError | None:
    """What is to be said where both cameras see fringes and still hardly any pixel has its counterpart."""
    left, right = (_share(np.isfinite(view.coordinate)) for _, view in reconstruction.cameras.values())
    matched = _share(reconstruction.valid)
    lost = reconstruction.flags & np.uint16(PixelFlag.UNMATCHED | PixelFlag.SLOPE)
    if matched >= _LEAST_MATCHED * min(left, right) or _share(lost) < matched:
        return None
    told = mixed_up(scene, reconstruction, settings) or _along_the_baseline(scene, reconstruction)
    return told or RigError(
        f"{scene.folder}: found counterparts for {matched:.1%} of the pixels though the left camera sees fringes on "
        f"{left:.0%} and the right one on {right:.0%}: rig {reconstruction.rig.id!r} does not fit the scan, expected "
        "the rig that took it: calibrate the rig again, or give the rig that took the scan"
    )
