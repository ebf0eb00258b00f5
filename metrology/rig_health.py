"""Whether the rig still is what its calibration says, told from any scan.

Two observables, which between them see every way that one device can move or zoom against the others:

- *across the epipolar line*: how far off its epipolar line the right camera sees the skin's texture. Moves with a pitch
  or roll between the cameras and with either camera's focal length.
- *the projector as a third view*: the projector column (row, for fringes of axis y) that was decoded at a point against
  the one the rig projects it to. Moves with what the first is blind to (a yaw between the cameras, both focal lengths
  alike) and with the projector itself. The ripple that the projector's gamma leaves averages out over a block.

What counts is the systematic part, which averaging does not remove; it is compared with what noise and the
calibration's own uncertainty allow, and never allowed more than an absolute limit. Each sees what the other is blind
to, so a rig that one of them cannot judge is unjudged. A rig without a calibrated projector is judged by the first
alone: nothing then tells a yaw between its cameras.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import Reconstruction
from metrology.errors import RigError
from metrology.far_offset import measure_far_offsets
from metrology.fringe import Axis
from metrology.results import Rivet, RivetDetection
from metrology.rig import PROJECTOR_OF, Rig
from metrology.robust import MAD
from metrology.texture_offset import PATCH_PX, TextureOffsets, measure_offsets
from metrology.third_view import third_view

Verdict = Literal["ok", "warning", "unjudged", "refused"]


@dataclass(frozen=True)
class HealthSettings:
    """What is measured and judged."""

    patch_spacing_px: int = 80
    """Distance between texture patches."""
    block_px: int = 64
    """Side of the blocks over which the third view is averaged; wider than a fringe."""
    sigmas: float = 5.0
    """Standard deviations (noise and calibration together) that a systematic deviation must exceed to be warned of."""
    epipolar_floor_px: float = 0.05
    projector_floor_px: float = 0.02
    """epipolar_floor_px, projector_floor_px: systematic deviations that are not warned of however small the noise: what
    registration of the skin's changing sheen, and the projector's gamma, leave after averaging."""
    refuse_px: float = 0.5
    """Systematic deviation of either kind from which the rig is refused, whatever noise or calibration allow: several
    times what a sound calibration leaves. Where noise alone may show so much, that kind tells nothing."""

    def __post_init__(self) -> None:
        if self.patch_spacing_px < 8 or self.block_px < 16:
            raise RigError(
                f"health check: found patches every {self.patch_spacing_px} px and blocks of {self.block_px} px, "
                "expected at least 8 and 16"
            )
        if not (self.sigmas > 0 and 0 < self.epipolar_floor_px < self.refuse_px > self.projector_floor_px > 0):
            raise RigError("health check: found limits that are not positive and rising, expected floor below refusal")


@dataclass(frozen=True)
class RigHealth:
    """How well a rig fits a scan."""

    epipolar_rms_px: float | None
    """Root mean square distance of texture patches from their epipolar lines in the right image, noise included; None
    where too few patches are found again in the right image."""
    epipolar_drift_px: float | None
    """Root mean square of its systematic part over the field."""
    n: int
    """Patches."""
    projector_rms_px: float | None
    """Root mean square over blocks of decoded minus projected coordinate, projector pixels."""
    projector_n: int
    """Blocks."""
    verdict: Verdict
    """Unjudged: at least one of the two cannot be told, and the other refuses nothing."""
    reason: str | None
    """What does not fit, or why it cannot be told."""


_LEAST_PATCHES = 12
_LEAST_BLOCKS = 12
# Where patches far apart are too few (a small picture, a small thing in a large one), they lie side by side, up to so
# many. On bent surfaces their counterparts bend along the epipolar lines, which tells nothing of what lies across.
_MOST_DENSE = 1500
_BENT_RMS_PX = 1.0
_LEAST_BLOCK_PART = 0.1
_OUTLIER_MADS = 4.0


def epipolar_health(
    reconstruction: Reconstruction,
    rivets: Sequence[Rivet | RivetDetection] = (),
    axis: Axis = "x",
    settings: HealthSettings | None = None,
) -> RigHealth:
    """Judge the rig of a reconstruction by the reconstruction itself.

    Parameters
    ----------
    rivets : sequence of Rivet or RivetDetection
        Their rims join the texture's patches.
    axis : "x" or "y"
        Of the fringes.
    """
    settings = settings or HealthSettings()
    allowed = _calibration_sigma(reconstruction.rig)
    epipolar = _across(reconstruction, _patch_centres(reconstruction, rivets, settings), settings)
    projector = _third_view(reconstruction, axis, settings)
    findings = [_judge(_EPIPOLAR, epipolar, allowed[0], settings)]
    if reconstruction.rig.projector:
        findings.append(_judge(_PROJECTOR, projector, allowed[1], settings))
    verdict = max((found for found, _ in findings), key=_ORDER.index)
    reason = "; ".join(text for _, text in findings if text) or None
    if reason and verdict in _ADVICE:
        reason = f"{reason}: {_culprit(reconstruction.rig, findings) or _ADVICE[verdict]}"
    return RigHealth(
        epipolar_rms_px=epipolar.rms if epipolar else None,
        epipolar_drift_px=epipolar.drift if epipolar else None,
        n=epipolar.count if epipolar else 0,
        projector_rms_px=projector.rms if projector else None,
        projector_n=projector.count if projector else 0,
        verdict=verdict,
        reason=reason,
    )


def _culprit(rig: Rig, findings: Sequence[tuple[Verdict, str | None]]) -> str | None:
    """A projector that was taken over from another rig, where it alone does not fit."""
    other = rig.extra.get(PROJECTOR_OF)
    if other is None or len(findings) < 2 or findings[0][0] in _ADVICE:
        return None
    return f"the projector was taken from rig {other!r} and stands elsewhere: `flushline rig fit-projector` finds it"


def projector_rms(reconstruction: Reconstruction, axis: Axis, settings: HealthSettings | None = None) -> float | None:
    """Root mean square over blocks of decoded minus projected coordinate, px; None where there are too few points."""
    found = _third_view(reconstruction, axis, settings or HealthSettings())
    return None if found is None else found.rms


_ORDER: tuple[Verdict, ...] = ("ok", "warning", "unjudged", "refused")
CALIBRATE = "calibrate the rig again"
"""What a warning advises."""
_ADVICE: dict[Verdict, str] = {
    "warning": CALIBRATE,
    "refused": f"{CALIBRATE}, or give the rig that took the scan",
}
# What is off, and what is missing where it cannot be told.
_EPIPOLAR = ("texture lies off the epipolar lines by", "too little texture that both cameras see alike")
_PROJECTOR = ("the decoded projector coordinate is off by", "too few points")


@dataclass(frozen=True)
class _Deviation:
    """rms: of all values; drift: of their systematic part; sigma: the drift that noise alone would show; floor: the
    drift that is never warned of.
    """

    rms: float
    drift: float
    sigma: float
    count: int
    floor: float


def _judge(
    what: tuple[str, str], found: _Deviation | None, allowed: float, settings: HealthSettings
) -> tuple[Verdict, str | None]:
    """Verdict and reason by one observable; more drift never makes it milder, nor does more noise excuse it."""
    off, missing = what
    if found is None:
        return "unjudged", f"cannot tell whether the rig still fits: {missing}"
    limit = max(found.floor, min(settings.sigmas * float(np.hypot(found.sigma, allowed)), settings.refuse_px))
    if found.drift > settings.refuse_px:
        return "refused", f"{off} {found.drift:.4g} px RMS, expected at most {limit:.3f} px"
    if settings.sigmas * found.sigma > settings.refuse_px:
        noise = f"{settings.sigmas * found.sigma:.3g} px, expected at most {settings.refuse_px:g} px"
        return "unjudged", f"cannot tell whether the rig still fits: {off} {found.drift:.3f} px with noise of {noise}"
    if found.drift > limit:
        return "warning", f"{off} {found.drift:.3f} px RMS, expected at most {limit:.3f} px"
    return "ok", None


def _across(reconstruction: Reconstruction, centres: NDArray[np.int64], settings: HealthSettings) -> _Deviation | None:
    """Texture across the epipolar lines: patches a few pixels around them, far apart or else side by side, else blocks
    over the whole image.
    """
    rig, refuse = reconstruction.rig, settings.refuse_px
    near = _epipolar(measure_offsets(reconstruction, centres), rig, settings.epipolar_floor_px)
    if near is not None and settings.sigmas * near.sigma <= refuse:
        return near
    beside = measure_offsets(reconstruction, _dense_centres(reconstruction), _BENT_RMS_PX)
    dense = _epipolar(beside, rig, settings.epipolar_floor_px)
    if dense is not None and settings.sigmas * dense.sigma <= refuse:
        return dense
    # Patches that lie out of reach are found nowhere, or by chance in places that contradict each other.
    far = _epipolar(measure_far_offsets(reconstruction), rig, refuse)
    for found in (far, dense, near):
        if found is not None and settings.sigmas * found.sigma <= max(refuse, found.drift):
            return found
    return None


def _calibration_sigma(rig: Rig) -> tuple[float, float]:
    """Deviations (epipolar, projector; px) that the calibration's covariance predicts; 0 where none is kept."""
    calibration = rig.extra.get("calibration")
    told = calibration.get("health_sigma_px", {}) if isinstance(calibration, dict) else {}
    return float(told.get("epipolar", 0.0)), float(told.get("projector", 0.0))


def _patch_centres(
    reconstruction: Reconstruction, rivets: Sequence[Rivet | RivetDetection], settings: HealthSettings
) -> NDArray[np.int64]:
    height, width = reconstruction.left.texture.shape
    half = settings.patch_spacing_px // 2
    grid = np.meshgrid(
        np.arange(half, width, settings.patch_spacing_px), np.arange(half, height, settings.patch_spacing_px)
    )
    # Above and below a rivet's centre its rim runs along the epipolar line.
    rims = [(r.u_px, r.v_px + side * r.major_px / 2) for r in rivets for side in (-1, 1)]
    extra = np.rint(np.array(rims).reshape(-1, 2)).astype(np.int64)
    return np.concatenate([np.stack(grid, -1).reshape(-1, 2), extra])


def _dense_centres(reconstruction: Reconstruction) -> NDArray[np.int64]:
    """Centres of patches side by side, wherever there are points."""
    valid = reconstruction.valid
    spacing = max(PATCH_PX, int(np.sqrt(valid.sum() / _MOST_DENSE)))
    v, u = np.nonzero(valid[spacing // 2 :: spacing, spacing // 2 :: spacing])
    return np.stack([u, v], -1) * spacing + spacing // 2


def _epipolar(offsets: TextureOffsets, rig: Rig, floor: float) -> _Deviation | None:
    """The systematic part is a quadratic over the field: offset, roll and zoom are its linear, yaw its product term."""
    if len(offsets.across_px) < _LEAST_PATCHES:
        return None
    size = np.array([rig.left.width, rig.left.height]) / 2
    x, y = ((offsets.left_px - size) / size[0]).T
    terms = np.column_stack([np.ones_like(x), x, y, x * y, x * x, y * y])
    design = terms[:, : max(1, min(terms.shape[1], len(x) // 8))]
    value, keep = offsets.across_px, np.ones(len(x), bool)
    # The patches' own sigmas know the camera's noise, not the sheen that differs between the views.
    weight = 1 / (offsets.sigma_px**2 + np.median(offsets.sigma_px) ** 2)
    for _ in range(5):
        root = np.sqrt(weight * keep)
        solution = np.linalg.lstsq(design * root[:, None], value * root, rcond=None)[0]
        residual = value - design @ solution
        scatter = MAD * float(np.median(np.abs(residual[keep]))) + 1e-6
        keep = np.abs(residual) < _OUTLIER_MADS * scatter
    design, value, root = design[keep], value[keep], np.sqrt(weight[keep])
    fitted = design @ solution
    pseudo = np.linalg.pinv(design * root[:, None])
    spread = (design @ (pseudo * root)) * (value - fitted)[None]
    sigma = float(np.sqrt(np.mean(np.sum(spread**2, axis=1))))
    return _Deviation(
        rms=float(np.sqrt(np.mean(value**2))),
        drift=float(np.sqrt(np.mean(fitted**2))),
        sigma=sigma,
        count=int(keep.sum()),
        floor=floor,
    )


def _third_view(reconstruction: Reconstruction, axis: Axis, settings: HealthSettings) -> _Deviation | None:
    blocks = third_view(reconstruction, axis, settings.block_px)
    if blocks is None:
        return None
    full = blocks.part > _LEAST_BLOCK_PART
    if full.sum() < _LEAST_BLOCKS:
        return None
    rms, sigma = (float(np.sqrt(np.mean(values[full] ** 2))) for values in (blocks.off_px, blocks.sigma_px))
    return _Deviation(rms, rms, sigma, int(full.sum()), settings.projector_floor_px)
