"""The projector of a rig from scans: reconstruct each with the cameras alone, fit, write the rig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from metrology.calibration.projector_fit import FittedProjector, SeenPoints, fit_projector, seen_points
from metrology.cloud import Reconstruction
from metrology.errors import CalibrationError, RigError, SceneError
from metrology.reconstruct import coordinate_size, decode, triangulate
from metrology.rig import PROJECTOR_FIT, PROJECTOR_OF, Device, Rig
from storage.scene import Scene, load_scene

_SQUARE = 0.02  # by which the sides of a projector's pixels may differ without being told


def fit_to_scenes(
    rig: Rig, folders: Sequence[Path], size: tuple[int, int] | None, rig_id: str | None
) -> tuple[Rig, FittedProjector]:
    """The rig with the projector that the scans tell, and how well they tell it.

    Parameters
    ----------
    rig : Rig
        With its cameras; its own projector gives its size alone.
    folders : sequence of Path
        Scene folders.
    size : (width, height), optional
        Of the projector.
    """
    if size is None and rig.projector is None:
        raise RigError(f"rig {rig.id!r}: found no projector, expected its width and height to be given (--size WxH)")
    size = size or (rig.projector.width, rig.projector.height)  # type: ignore[union-attr]
    scenes = [load_scene(folder) for folder in folders]
    try:
        fitted = fit_projector(_seen_in(rig, scenes, size), size)
    except CalibrationError as problem:
        raise CalibrationError(f"{', '.join(map(str, folders))}: {problem}") from None
    extra = {key: value for key, value in rig.extra.items() if key not in (PROJECTOR_OF, "calibration")}
    extra |= {"calibration": _of_cameras(rig)} if "calibration" in rig.extra else {}
    extra[PROJECTOR_FIT] = fitted.summary | {"scenes": [scene.key.scene_id for scene in scenes]}
    return replace(rig, id=rig_id or rig.id, projector=fitted.device, extra=extra), fitted


def _of_cameras(rig: Rig) -> dict[str, object]:
    """What was kept of the calibration, less what it said of another projector's columns."""
    kept = dict(rig.extra["calibration"])
    health = {key: value for key, value in dict(kept.get("health_sigma_px", {})).items() if key != "projector"}
    return kept | {"health_sigma_px": health}


def _seen_in(rig: Rig, scenes: Sequence[Scene], size: tuple[int, int]) -> list[SeenPoints]:
    """Points and the projector's coordinate there, in its own pixels, of every scan.

    Fringes along the axis in which the cameras stand apart give points. Others are read at the points of the scan of
    the same station that came before.
    """
    base = rig.with_right().centre
    measuring = "x" if abs(base[0]) >= abs(base[1]) else "y"
    cameras, alone = replace(rig, projector=_placeholder(rig.left, size)), replace(rig, projector=None)
    measured: dict[tuple[str, str, str], Reconstruction] = {}
    seen = []
    for scene in scenes:
        scene.check_fits(cameras)
        station = (scene.key.aircraft_serial, scene.key.panel, scene.key.station)
        across, code, times = coordinate_size(cameras, scene.code), scene.code, scene.exposures
        left = decode(scene.frames("left"), code, across, times)
        if code.axis == measuring:
            measured[station] = triangulate(left, decode(scene.frames("right"), code, across, times), alone)
        elif station not in measured:
            raise SceneError(
                f"{scene.folder}: found fringes along {code.axis}, by which the cameras do not measure, expected a "
                f"scan with fringes along {measuring} of the same station before it, with nothing moved in between"
            )
        found = measured[station]
        seen.append(seen_points(replace(found, left=left, flags=found.flags | left.flags), code.axis))
    return seen


def _placeholder(left: Device, size: tuple[int, int]) -> Device:
    """A projector of the right size, which is all that decoding asks of it."""
    return Device(*size, left.K, np.zeros(0), left.R, left.t)


def describe_fit(fitted: FittedProjector) -> list[str]:
    """The projector in a few lines."""
    device, sigma = fitted.device, {name: 2 * value for name, value in fitted.sigma.items()}
    seen = {"rows": "x", "columns": "y"}.get(fitted.assumed or "", "xy")
    focal = ", ".join(f"{device.K[i, i]:.1f} ± {sigma[f'f{axis}']:.1f}" for i, axis in enumerate("xy") if axis in seen)
    centre = ", ".join(f"{device.K[i, 2]:.1f} ± {sigma[f'c{axis}']:.1f}" for i, axis in enumerate("xy") if axis in seen)
    lines = [
        f"projector: focal length {focal} px, principal point {centre} px (95 %)",
        f"  place {', '.join(f'{c:.1f}' for c in device.centre)} mm ± {fitted.place_u95_mm:.1f} mm; distortion "
        f"{' '.join(fitted.terms) or 'none'}; {fitted.blocks} blocks, RMS {fitted.rms_px:.4f} px",
    ]
    if fitted.assumed:
        missing = "y" if fitted.assumed == "rows" else "x"
        lines.append(
            f"  warning: no scan has fringes along {missing}: the projector's {fitted.assumed} are assumed (square "
            f"pixels, light over all that was seen) to ±{fitted.assumed_u95_px:.1f} px (95 %); it watches "
            "over the rig, and overlays are not drawn for it"
        )
    ratio = device.K[0, 0] / device.K[1, 1]
    if not fitted.assumed and abs(ratio - 1) > _SQUARE:
        lines.append(
            f"  warning: its pixels are {ratio:.3f} times as high as wide: where a code runs over more pixels than the "
            "projector has, as Gray code of rows mostly does, its scene needs them (--over, --periods); or the "
            "projector's pixels are no squares"
        )
    return lines
