"""What is stored of an inspected scene: the scan's own files, its warnings, and everything in one record."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import PixelFlag, Reconstruction
from metrology.inspection import InspectionResult
from metrology.overlay import Overlay
from metrology.registration import Registration
from metrology.results import Features
from metrology.rig import Rig
from metrology.rig_health import RigHealth
from storage.archive.bundle import document_hash
from storage.archive.bundle import encode as encode_files
from storage.panel_spec import PanelSpecification
from storage.rig import rig_document
from tasks.loaded import LoadedScene
from tasks.scan_checks import contradiction_warnings, unseen_warnings
from tasks.settings import InspectionSettings, SceneChecks

_NAMED = 3  # of other names of a scan
_WITHOUT_PROJECTOR = (
    ", gaps' edges and heads' rims come from points and rings alone, and neither a small yaw between the cameras nor a "
    "wrong scale of all lengths would be noticed (flushline measure)"
)


@dataclass(frozen=True)
class Encoded:
    """What is stored of a scan itself."""

    preview: NDArray[np.uint8]
    """(h, w) uint8: the texture as a picture."""
    files: Mapping[str, bytes]
    """Content of the bundle's largest files."""


def encode(reconstruction: Reconstruction) -> Encoded:
    """Encode what is stored of a scan itself, while other steps look for what is in it."""
    picture = preview(reconstruction.left.texture)
    return Encoded(picture, encode_files(reconstruction, picture))


def assemble(
    loaded: LoadedScene,
    reconstruction: Reconstruction,
    health: RigHealth,
    registered: Registration,
    judged: Features,
    drawn: Overlay,
    encoded: Encoded,
    settings: InspectionSettings,
    spec: PanelSpecification,
    seconds: Mapping[str, float],
) -> InspectionResult:
    """Everything that is to be stored."""
    key = loaded.scene.key
    warnings = [
        *loaded.warnings,
        *_same_frames_warnings(loaded.same_frames),
        *overexposure_warnings(reconstruction, settings.checks),
        *(doubt.warning for doubt in reconstruction.doubts),
        *reconstruction.remarks,
        *contradiction_warnings(reconstruction, settings.checks),
        *unseen_warnings(reconstruction),
        *registered.warnings,
    ]
    if health.verdict in ("warning", "unjudged"):
        warnings.append(f"rig {loaded.rig.id}: {health.reason}")
    warnings += _what_is_missing(reconstruction.rig)
    if spec.example:
        warnings.append("judged by the example limits, which are nobody's requirement; give --panel-spec")
    elif spec.limits.panel != key.panel:
        warnings.append(f"judged by the specification of panel {spec.limits.panel}, though the scene is of {key.panel}")
    if drawn.outside:
        warnings.append(f"outside the projector's field, at least in part: {', '.join(drawn.outside)}")
    return InspectionResult(
        key=key,
        reconstruction=reconstruction,
        features=judged,
        overlay=drawn,
        preview=encoded.preview,
        encoded=encoded.files,
        rig_document=rig_document(loaded.rig),
        settings=settings.document,
        config_hash=config_hash(settings, spec),
        panel_spec=spec.document,
        seconds=dict(seconds),
        warnings=tuple(warnings),
        versions=versions(),
        operator=loaded.scene.operator,
        registration=_registration_document(registered),
        epipolar_rms_px=health.epipolar_rms_px,
        projector_rms_px=health.projector_rms_px,
        rig_verdict=health.verdict,
        pattern=registered.enrolled if registered.enrolled and not registered.enrolled.empty else None,
        files_state=loaded.scene.files_state,
    )


def _what_is_missing(rig: Rig) -> list[str]:
    """What a rig of fewer than three devices does without."""
    missing = []
    if rig.right is None:
        missing.append(
            f"rig {rig.id} has one camera: gaps' edges and heads' rims come from points and rings alone, and a glint "
            "or a shadow may be taken for a head's rim"
        )
    if rig.projector is None:
        missing.append(
            f"rig {rig.id} has no calibrated projector: the overlay is drawn over the left camera's picture"
            + ("" if rig.right is None else _WITHOUT_PROJECTOR)
        )
    elif rig.screen is None:
        missing.append(
            f"rig {rig.id} has a projector of which scans told the columns or the rows alone: the overlay is drawn "
            "over the left camera's picture, gaps' edges and heads' rims come from points and rings alone"
        )
    return missing


def _registration_document(registered: Registration) -> dict[str, object]:
    placement = registered.placement
    return {
        "status": registered.status,
        "matched": list(registered.matched),
        "missing": list(registered.missing),
        "unlisted": list(registered.unlisted),
        "rms_mm": registered.rms_mm,
        "shift_mm": registered.shift_mm,
        "turn_deg": registered.turn_deg,
        "placement": None if placement is None else {"R": placement.R.tolist(), "t_mm": placement.t.tolist()},
    }


def config_hash(settings: InspectionSettings, spec: PanelSpecification) -> str:
    """Names settings and panel specification together."""
    return document_hash({"settings": settings.document, "panel_spec": spec.document})


def preview(texture: NDArray[np.float32]) -> NDArray[np.uint8]:
    """The texture as an 8-bit picture; brightened or dimmed only where it would not fit."""
    lit = np.fmax(texture, np.float32(0))  # dark where it is NaN
    high = float(np.quantile(lit[::4, ::4], 0.999))
    scale = 250.0 / high if high > 255 else 1.0
    return np.minimum(np.rint(lit * np.float32(scale)), 255).astype(np.uint8)


def versions() -> dict[str, str]:
    """What computed a result."""
    return dict(_versions())


@cache
def _versions() -> dict[str, str]:
    packages = ("flushline", "numpy", "scipy", "numba", "opencv-python-headless", "pyarrow", "duckdb")
    return {"python": platform.python_version(), **{name: version(name) for name in packages}}


def _same_frames_warnings(scenes: Sequence[str]) -> list[str]:
    """That a scan is stored under other names, too."""
    if not scenes:
        return []
    names = ", ".join(scenes[:_NAMED])
    if more := len(scenes[_NAMED:]):
        return [f"the same frames are stored as {names} and {more} more: one of these names at most is right"]
    return [f"the same frames are stored as {names}: one of these names at most is right"]


def overexposure_warnings(reconstruction: Reconstruction, checks: SceneChecks) -> list[str]:
    """A warning where much of the skin is saturated: neither points nor a picture, so nothing is found there."""
    # One pixel in sixteen gives the share to a thousandth.
    sampled = (slice(None, None, 4), slice(None, None, 4))
    left, right = reconstruction.flags[sampled], reconstruction.right
    shares = {"": _saturated_share(left, np.isfinite(reconstruction.points[*sampled, 2]))}
    if right:
        seen = np.isfinite(right.coordinate[sampled])
        shares[" of the right camera"] = _saturated_share(right.flags[sampled], seen)
    where, share = max(shares.items(), key=lambda item: item[1])
    if share <= checks.max_saturated_fraction:
        return []
    return [
        f"overexposed: {share:.0%} of the skin is saturated in every exposure{where}; rivets and seams there are not "
        "found or not measured; take a shorter exposure as well"
    ]


def _saturated_share(flags: NDArray[np.uint16], measured: NDArray[np.bool_]) -> float:
    """Share of the skin, measured or saturated, that is saturated."""
    saturated = (flags & np.uint16(PixelFlag.SATURATED)) != 0
    skin = saturated | measured
    return float(saturated[skin].mean()) if skin.any() else 0.0
