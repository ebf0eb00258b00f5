"""From what was detected to a rig with its uncertainty: start values, joint adjustment, outliers, lens model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.calibration.board import Board
from metrology.calibration.bundle import Adjusted, State, adjust, predict
from metrology.calibration.detect import Detection
from metrology.calibration.detect_board import Layout
from metrology.calibration.distortion_model import PINHOLE, USUAL, Evidence, choose_terms
from metrology.calibration.eccentricity import eccentricity
from metrology.calibration.initial import LEAST_POSES, start_values, to_board
from metrology.calibration.observations import DeviceName, Sighting
from metrology.calibration.prediction import FieldUncertainty, field_uncertainty
from metrology.calibration.projected_dots import ProjectedDots
from metrology.calibration.sightings import of_one_layout, refuse_blurred, sightings_of
from metrology.calibration.turned_boards import labelled_alike
from metrology.device_plausibility import check_distortion
from metrology.errors import CalibrationError, RigError
from metrology.rig import Device, Rig
from metrology.rig_plausibility import stands_left

Terms = dict[DeviceName, tuple[str, ...]]

_LEAST_SIGMA_PX = 1e-3
_OUTLIER_SIGMAS = 6.0
_BAD_PART = 0.3  # of a picture's features being outliers: the picture itself is bad
_BAD_RMS_TIMES = 4.0
_ROUNDS = 3
_ENOUGH_POSES = 6
_NOTABLE_FOCAL_U95 = 1e-3  # of the focal length
_NOTABLE_CENTRE_U95_PX = 3.0
_NOTABLE_RMS_PX = {"left": 0.1, "right": 0.1, "projector": 0.5}


@dataclass(frozen=True)
class PoseUse:
    """What became of one pose."""

    pose: int
    used: tuple[str, ...]
    """Sightings that went into the adjustment, as "left board", "right dots" …; empty for a refused pose."""
    features: int
    outliers: int
    """features, outliers: features used and left out."""
    rms_px: dict[str, float]
    """By sighting: root mean square distance of predicted and measured pixels. That of dots is in camera pixels."""
    reasons: tuple[str, ...]
    """Why something was refused."""


@dataclass(frozen=True)
class Calibration:
    """Devices calibrated together."""

    adjusted: Adjusted
    sightings: tuple[Sighting, ...]
    """Those used, eccentricity removed, with the noise that the residuals show."""
    terms: Terms
    """Distortion terms of each device."""
    evidence: tuple[Evidence, ...]
    poses: tuple[PoseUse, ...]
    field: FieldUncertainty | None
    """What the covariance means for measurements; None without a right camera and a projector."""
    rms_px: dict[DeviceName, float]
    """Root mean square reprojection distance by device, of both coordinates together as OpenCV has it; that of the
    projector in its own pixels."""
    warnings: tuple[str, ...]
    board_layout: Layout | None = None
    """Of a ChArUco board: the layout that was found; None where there is but one."""

    def rig(self, rig_id: str, calibrated_at: str) -> Rig:
        """The rig, its covariance and residuals in `extra`; with the devices that were calibrated."""
        devices = self.adjusted.state.devices
        return Rig(
            rig_id,
            calibrated_at,
            devices["left"],
            devices.get("right"),
            devices.get("projector"),
            {"calibration": self.summary()},
        )

    def summary(self) -> dict[str, object]:
        """What a rig file keeps of how it was found; plain numbers and text."""
        return {
            "reprojection_rms_px": dict(self.rms_px),
            "parameters": list(self.adjusted.names),
            "covariance": self.adjusted.covariance.tolist(),
            "health_sigma_px": {
                "epipolar": self.field.epipolar_sigma_px,
                "projector": self.field.projector_sigma_px,
            }
            if self.field
            else {},
            "distortion_terms": {name: list(terms) for name, terms in self.terms.items()},
            "poses": [
                {
                    "pose": use.pose,
                    "used": list(use.used),
                    "features": use.features,
                    "outliers": use.outliers,
                    "rms_px": use.rms_px,
                    "reasons": list(use.reasons),
                }
                for use in self.poses
            ],
            "warnings": list(self.warnings),
            **({"board_layout": self.board_layout} if self.board_layout else {}),
        }


def calibrate(
    detections: Sequence[Detection],
    board: Board,
    pattern: ProjectedDots | None = None,
    projector_size: tuple[int, int] | None = None,
) -> Calibration:
    """Calibrate cameras and projector from detections; CalibrationError where no trustworthy rig follows."""
    reasons: dict[int, list[str]] = {d.pose: [] for d in detections}
    for detection in detections:
        reasons[detection.pose] += [f"{detection.camera}: {reason}" for reason in detection.reasons]
    detections = refuse_blurred(detections, reasons)
    layout, detections = of_one_layout(detections, reasons)
    detections = labelled_alike(detections, board)
    sightings = sightings_of(detections, board, pattern)
    sizes: dict[DeviceName, tuple[int, int]] = {d.camera: d.size for d in detections}
    _require_poses(sightings, sizes, reasons)
    if projector_size is not None:
        sizes["projector"] = projector_size
        _require_projector(sightings, reasons)
    return replace(calibrate_sightings(sightings, sizes, reasons), board_layout=layout)


def calibrate_sightings(
    sightings: Sequence[Sighting],
    sizes: Mapping[DeviceName, tuple[int, int]],
    reasons: Mapping[int, Sequence[str]] | None = None,
) -> Calibration:
    """Calibrate from correspondences: the left camera, and the right one or a projector or both.

    Parameters
    ----------
    sizes : mapping
        Width and height of each device to calibrate, pixels.
    reasons : mapping of pose to texts, optional
        What was refused before.
    """
    notes = {pose: list(texts) for pose, texts in (reasons or {}).items()}
    everything = list(sightings)
    start, contradicting = start_values(sightings, sizes)
    for pose, reason in contradicting.items():
        notes.setdefault(pose, []).append(reason)
    sightings = [s for s in sightings if s.pose in start.rotations and s.device in start.devices]
    state, sightings, bad = _clean(start, sightings)
    for pose, texts in bad.items():
        notes.setdefault(pose, []).extend(texts)
    terms, evidence, adjusted = _choose_model(state, sightings)
    _check(adjusted)
    uses = _pose_uses(everything, sightings, adjusted, notes)
    rms = {name: _rms(sightings, adjusted, name) for name in start.devices}
    warnings = (*_warnings(uses, rms), *_uncertain(adjusted))
    field = field_uncertainty(adjusted)
    return Calibration(adjusted, tuple(sightings), terms, tuple(evidence), uses, field, rms, warnings)


def _require_poses(
    sightings: Sequence[Sighting], sizes: Mapping[DeviceName, tuple[int, int]], reasons: Mapping[int, Sequence[str]]
) -> None:
    seen = {(s.pose, s.device) for s in sightings if s.kind == "board"}
    both = [pose for pose in reasons if all((pose, camera) in seen for camera in sizes)]
    if len(both) < LEAST_POSES:
        raise CalibrationError(
            f"the board was found by every camera in {len(both)} of {len(reasons)} poses, expected at least "
            f"{LEAST_POSES}{_first_reasons(reasons)}"
        )


def _require_projector(sightings: Sequence[Sighting], reasons: Mapping[int, Sequence[str]]) -> None:
    poses = {s.pose for s in sightings if s.kind == "dots" or s.device == "projector"}
    if len(poses) < LEAST_POSES:
        raise CalibrationError(
            f"projector: found its dots or fringes in {len(poses)} of {len(reasons)} poses, expected at least "
            f"{LEAST_POSES}{_first_reasons(reasons)}"
        )


def _first_reasons(reasons: Mapping[int, Sequence[str]], most: int = 2) -> str:
    told = [f"pose {pose}: {texts[0]}" for pose, texts in reasons.items() if texts]
    more = f" and {len(told) - most} more" if len(told) > most else ""
    return f" ({'; '.join(told[:most])}{more})" if told else ""


def _clean(start: State, sightings: Sequence[Sighting]) -> tuple[State, list[Sighting], dict[int, list[str]]]:
    """Adjust robustly, remove eccentricity with the whole model, learn the noise, leave out what does not fit."""
    bad: dict[int, list[str]] = {}
    terms = _free(dict.fromkeys(start.devices, USUAL))
    raw, state = list(sightings), start
    for _ in range(_ROUNDS):
        corrected = [_without_eccentricity(state, s) for s in raw]
        adjusted = adjust(state, corrected, terms)
        state = adjusted.state
        noise = _noise(corrected, adjusted.residuals)
        kept = []
        for sighting, residual in zip(raw, adjusted.residuals, strict=True):
            sigma = noise[sighting.kind, sighting.device]
            keep = np.linalg.norm(residual, axis=1) < _OUTLIER_SIGMAS * sigma
            if reason := _bad_picture(sighting, residual, keep, sigma):
                bad.setdefault(sighting.pose, []).append(reason)
            else:
                kept.append(replace(sighting.only(keep), sigma_px=sigma))
        state, raw = _still_seen(state, kept, bad)
    return state, [_without_eccentricity(state, s) for s in raw], bad


def _still_seen(state: State, sightings: list[Sighting], bad: dict[int, list[str]]) -> tuple[State, list[Sighting]]:
    """Without the poses of which no camera's view of the board is left."""
    seen = {s.pose for s in sightings if s.kind == "board" and s.device != "projector"}
    for device in state.devices:
        with_device = {s.pose for s in sightings if s.device == device or (device == "projector" and s.kind == "dots")}
        if len(seen & with_device) < LEAST_POSES:
            raise CalibrationError(
                f"{device}: {len(seen & with_device)} poses are left that fit together, expected at least "
                f"{LEAST_POSES}{_first_reasons(bad)}"
            )
    rotations = {p: r for p, r in state.rotations.items() if p in seen}
    translations = {p: t for p, t in state.translations.items() if p in seen}
    return State(state.devices, rotations, translations), [s for s in sightings if s.pose in seen]


def _without_eccentricity(state: State, sighting: Sighting) -> Sighting:
    if not sighting.radius.any():
        return sighting
    offset = eccentricity(lambda known: predict(state, sighting, known), sighting.known, sighting.radius)
    return replace(sighting, pixels=sighting.pixels - offset)


def _noise(sightings: Sequence[Sighting], residuals: Sequence[Array]) -> dict[tuple[str, str], float]:
    """Standard deviation of one coordinate by kind and device: the median over pictures of their robust scatter."""
    scatter: dict[tuple[str, str], list[float]] = {}
    for sighting, residual in zip(sightings, residuals, strict=True):
        # The median of a Rayleigh-distributed distance is 1.1774 standard deviations.
        robust = float(np.median(np.linalg.norm(residual, axis=1)) / 1.1774)
        scatter.setdefault((sighting.kind, sighting.device), []).append(robust)
    return {key: max(float(np.median(of)), _LEAST_SIGMA_PX) for key, of in scatter.items()}


def _bad_picture(sighting: Sighting, residual: Array, keep: NDArray[np.bool_], sigma: float) -> str | None:
    outliers = len(keep) - int(keep.sum())
    rms = float(np.sqrt(np.mean(np.square(residual)))) if len(residual) else 0.0
    typical = float(np.median(np.linalg.norm(residual, axis=1)) / 1.1774) if len(residual) else 0.0
    what = "board features" if sighting.kind == "board" else "projected dots"
    if outliers > _BAD_PART * len(keep) or typical > _BAD_RMS_TIMES * sigma:
        return (
            f"{sighting.device}: {what} scatter by {rms:.3f} px, expected about {sigma:.3f} px as in the other poses: "
            "moved between the pictures, blurred or hidden"
        )
    return None


def _choose_model(state: State, sightings: Sequence[Sighting]) -> tuple[Terms, list[Evidence], Adjusted]:
    """The lens model of each device in turn, the others as they stand; and the adjustment with all of them."""
    terms: Terms = dict.fromkeys(state.devices, USUAL)
    evidence: list[Evidence] = []
    tried: dict[tuple[tuple[DeviceName, tuple[str, ...]], ...], Adjusted] = {}
    count = 2 * sum(len(s) for s in sightings)
    for name in state.devices:

        def fit(candidate: tuple[str, ...], name: DeviceName = name) -> tuple[float, int]:
            model = tuple((terms | {name: candidate}).items())
            if model not in tried:
                tried[model] = adjust(state, sightings, _free(dict(model)), robust=False)
            possible = _one_to_one(tried[model].state.devices[name])
            return tried[model].chi2 if possible else np.inf, tried[model].freedom

        terms[name], found = choose_terms(name, fit, count)
        evidence += found
    return terms, evidence, tried[tuple(terms.items())]


def _one_to_one(device: Device) -> bool:
    """Whether a lens is one out to the image's corners: where no board was, terms of high order run away."""
    try:
        check_distortion(device)
    except RigError:
        return False
    return True


def _free(terms: Terms) -> dict[DeviceName, Sequence[str]]:
    return {name: PINHOLE + of for name, of in terms.items()}


def _check(adjusted: Adjusted) -> None:
    devices = adjusted.state.devices
    if "right" in devices and stands_left(devices["right"]):
        raise CalibrationError(
            f"the right camera came out {-devices['right'].centre[0]:.0f} mm to the left of the left one: "
            "left and right frames are swapped throughout (or both cameras hang upside down and are to be named as "
            "their pictures show it)"
        )


def _rms(sightings: Sequence[Sighting], adjusted: Adjusted, name: DeviceName) -> float:
    distances = []
    for sighting, residual in zip(sightings, adjusted.residuals, strict=True):
        if sighting.kind == "board" and sighting.device == name:
            distances.append(np.linalg.norm(residual, axis=1))
        elif sighting.kind == "dots" and name == "projector":
            distances.append(np.linalg.norm(projector_residuals(adjusted.state, sighting), axis=1))
    return float(np.sqrt(np.mean(np.square(np.concatenate(distances)))))


def projector_residuals(state: State, sighting: Sighting) -> Array:
    """(n, 2) projector pixels: dots as a camera saw them, carried to the board and into the projector, minus shown."""
    rotation, translation = state.rotations[sighting.pose], state.translations[sighting.pose]
    seen = to_board(state.devices[sighting.device], sighting.pixels, rotation, translation)
    points = seen @ rotation[:, :2].T + translation
    return np.asarray(state.devices["projector"].project(points) - sighting.known)


def _pose_uses(
    everything: Sequence[Sighting], used: Sequence[Sighting], adjusted: Adjusted, reasons: Mapping[int, Sequence[str]]
) -> tuple[PoseUse, ...]:
    found: dict[tuple[int, str], int] = {(s.pose, f"{s.device} {s.kind}"): len(s) for s in everything}
    uses = []
    for pose in sorted(set(reasons) | {s.pose for s in everything}):
        mine = [(s, r) for s, r in zip(used, adjusted.residuals, strict=True) if s.pose == pose]
        rms = {f"{s.device} {s.kind}": float(np.sqrt(np.mean(np.sum(np.square(r), axis=1)))) for s, r in mine}
        features = sum(len(s) for s, _ in mine)
        outliers = sum(found[pose, name] for name in rms) - features
        uses.append(PoseUse(pose, tuple(rms), features, outliers, rms, tuple(reasons.get(pose, ()))))
    return tuple(uses)


def _warnings(uses: Sequence[PoseUse], rms: Mapping[DeviceName, float]) -> tuple[str, ...]:
    warnings = []
    used = [use for use in uses if use.used]
    if len(used) < _ENOUGH_POSES:
        warnings.append(
            f"few poses: found {len(used)} usable ones, expected at least {_ENOUGH_POSES} for a certain rig"
        )
    lit = [use for use in used if any("dots" in name or "projector" in name for name in use.used)]
    if "projector" in rms and 3 * len(lit) < 2 * len(uses):
        warnings.append(f"projector: its dots or fringes were usable in {len(lit)} of {len(uses)} poses only")
    for use in uses:
        if use.reasons:
            state = "used in part" if use.used else "refused"
            warnings.append(f"pose {use.pose} {state}: {'; '.join(use.reasons)}")
    for device, value in rms.items():
        if value > _NOTABLE_RMS_PX[device]:
            warnings.append(f"{device}: reprojection RMS {value:.3f} px, expected at most {_NOTABLE_RMS_PX[device]} px")
    return tuple(warnings)


def _uncertain(adjusted: Adjusted) -> list[str]:
    """Devices that the poses leave uncertain, whatever their residuals."""
    sigma = dict(zip(adjusted.names, np.sqrt(np.diag(adjusted.covariance)), strict=True))
    warnings = []
    for name, device in adjusted.state.devices.items():
        focal = 2 * sigma[f"{name}.fx"] / device.K[0, 0]
        centre = 2 * max(sigma[f"{name}.cx"], sigma[f"{name}.cy"])
        if focal > _NOTABLE_FOCAL_U95 or centre > _NOTABLE_CENTRE_U95_PX:
            warnings.append(
                f"{name}: the poses leave the focal length uncertain by ±{focal:.2%} and the principal point by "
                f"±{centre:.1f} px (95 %), expected at most ±{_NOTABLE_FOCAL_U95:.1%} and ±{_NOTABLE_CENTRE_U95_PX:g} "
                "px: more poses, tilted in different ways, nearer and farther"
            )
    return warnings
