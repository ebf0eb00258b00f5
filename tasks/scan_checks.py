"""Checks of a scan's frames: one that contradicts the others is refused by name; messages for the person at the rig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import DecodedView, PixelFlag, Reconstruction
from metrology.errors import SceneError
from metrology.frame_consistency import FrameConsistency, contradictory_share, frame_consistency
from metrology.frame_diagnosis import FrameDiagnosis, diagnose_frames
from metrology.frame_faults import FrameFault
from metrology.frame_geometry import expected_gradient
from metrology.frame_sample import FrameSample, sample_frames
from metrology.noise import NoiseModel
from metrology.noise_texture import NoiseTexture, level_step, noise_texture
from metrology.rig import Rig
from metrology.unseen import unseen_skin
from storage.scene import Scene
from storage.scene_models import Camera
from tasks.settings import SceneChecks

CAUSES = {
    PixelFlag.SATURATED: "saturated",
    PixelFlag.LOW_MODULATION: "too dark or without fringes",
    PixelFlag.ORDER_RESIDUAL: "with fringes that contradict each other",
    PixelFlag.UNMATCHED: "without a counterpart in the other camera",
    PixelFlag.SLOPE: "out of range",
}
"""Why pixels have no points, in words."""


@dataclass(frozen=True)
class CheckedFrames:
    """What a camera's frames say about each other."""

    camera: Camera
    sample: FrameSample
    found: tuple[FrameConsistency, ...]
    """Of each exposure."""
    diagnosis: FrameDiagnosis | None
    """Of frames that are suspicious."""
    texture: NoiseTexture | None = None
    """Of the first exposure; None where too little noise is seen."""
    level_step: float = 1.0
    """Grey levels from one that occurs to the next."""


def check_frames(
    camera: Camera, frames: NDArray, view: DecodedView, scene: Scene, rig: Rig | None = None
) -> CheckedFrames:
    """Look at one camera's frames, closely where a coarse grid of them is suspicious.

    Parameters
    ----------
    frames : (exposures, frames, h, w) ndarray of uint8 or uint16
    view : DecodedView
        Of these frames.
    rig : Rig, optional
        Where it is known, an order of frames whose coordinate runs against it is not considered.
    """
    noise = view.noise or NoiseModel(1.0, 0.0)
    sample = sample_frames(frames, scene.code, noise)
    if not scene.code.counts:
        _refuse_odd_stripes(camera, sample, scene)
        return CheckedFrames(camera, sample, (), None)
    found = tuple(frame_consistency(sample, exposure) for exposure in range(len(frames)))
    seen = sum(judged.judged for judged in found) > 0
    if seen and not any(judged.odd for judged in found):
        texture = noise_texture(frames[0], scene.code, sample.saturation)
        return CheckedFrames(camera, sample, found, None, texture, level_step(frames[0]))

    def finer(rows: NDArray[np.int64]) -> FrameSample:
        return sample_frames(frames, scene.code, noise, rows)

    gradient = expected_gradient(rig.cameras[camera], rig.projector, scene.code.axis) if rig else None
    return CheckedFrames(camera, sample, found, diagnose_frames(sample, found, finer, gradient))


def refuse_wrong_frames(scene: Scene, views: Sequence[CheckedFrames], checks: SceneChecks) -> None:
    """Refuse a scan whose frames are not what it says, naming what they look like."""
    if len(views) == 2:
        _refuse_shared_pictures(scene, views[0], views[1])
    orders = [view.diagnosis.order for view in views if view.diagnosis and view.diagnosis.order]
    if orders:
        cameras = [view.camera for view in views if view.diagnosis and view.diagnosis.order]
        alike = len(orders) == 2 and orders[0] == orders[1]
        found = (
            f"of both cameras fit {orders[0].what}"
            if alike
            else "; ".join(
                f"of the {camera} camera fit {order.what}" for camera, order in zip(cameras, orders, strict=True)
            )
        )
        steps = " and ".join(map(str, dict.fromkeys(scene.code.step_counts)))
        raise SceneError(
            f"{scene.folder}: found that the frames {found}; expected the order in which they were shown: "
            f"counts {', '.join(map(str, scene.code.counts))} of {steps} steps, as scene.json says"
        )
    named = [view for view in views if view.diagnosis and view.diagnosis.faults]
    if named:
        raise SceneError("; ".join(_faults(scene, view) for view in named))
    # Gray code and fringes of a sound scan never contradict each other, and no flag counts where they do.
    limit = checks.contradictory_warning_fraction if scene.code.gray else checks.max_contradictory_fraction
    for view in views:
        if not view.found:
            continue
        worst = max(view.found, key=lambda judged: judged.contradictory)
        if worst.contradictory > limit:
            raise SceneError(
                f"{scene.folder}: found fringes that contradict each other in {worst.contradictory:.0%} of the lit "
                f"pixels of the {view.camera} camera, expected hardly any: frames taken one after the other "
                "while nothing moved, in the order and with the fringe counts and steps that scene.json says"
            )
        if any(judged.deviation > 1 for judged in view.found):
            raise SceneError(
                f"{scene.folder}: found frames of the {view.camera} camera that do not fit each other, expected "
                "frames of one scan, taken while nothing moved and in the same light, alike but for their fringes"
            )
        if any(judged.drift > 1 for judged in view.found):
            raise SceneError(
                f"{scene.folder}: found phases of the {view.camera} camera's counts that miss each other, expected one "
                "position: frames of one scan, taken while nothing moved, without a second picture of the fringes "
                "(a reflection within the lens or from something bright beside the skin)"
            )


def contradiction_warnings(reconstruction: Reconstruction, checks: SceneChecks) -> list[str]:
    """A warning for each camera in which fringes contradict each other in more than a sound scan's pixels."""
    warnings = []
    for name, (_, view) in reconstruction.cameras.items():
        share = contradictory_share(view.flags)
        if share > checks.contradictory_warning_fraction:
            warnings.append(
                f"{share:.1%} of the lit pixels of the {name} camera have fringes that contradict each other and "
                "therefore no points; look for movement, reflections of the fringes, or a frame of another scan"
            )
    return warnings


def unseen_warnings(reconstruction: Reconstruction) -> list[str]:
    """A warning where part of the field was not seen, as wide as a fastener and more."""
    unseen = unseen_skin(reconstruction)
    if unseen is None:
        return []
    return [
        f"{unseen.share:.1%} of the field in view have no points (the largest part, around u {unseen.u_px:.0f}, "
        f"v {unseen.v_px:.0f} in the left picture, is {CAUSES[unseen.cause]}): what lies there was not inspected; is "
        "something before the skin, or does it reflect?"
    ]


def _refuse_shared_pictures(scene: Scene, left: CheckedFrames, right: CheckedFrames) -> None:
    """Refuse a picture that both cameras are said to have taken."""
    if left.sample.levels.shape != right.sample.levels.shape:
        return
    pictures = [view.sample.levels.reshape(-1, *view.sample.levels.shape[2:]) for view in (left, right)]
    for index, (one, other) in enumerate(zip(*pictures, strict=True)):
        if np.ptp(one) > 0 and np.array_equal(one, other):
            raise SceneError(
                f"{scene.right[index]}: found the same picture as {_short(scene, 'left', index)}, "
                "expected the right camera's own"
            )


# Frame and inverse add up to the same for every bit.
_ODD_SUM = 0.15
_LEAST_LIT, _LIT = 200, 0.1


def _refuse_odd_stripes(camera: Camera, sample: FrameSample, scene: Scene) -> None:
    """Refuse frames of Gray code alone that repeat one another or are not each a pattern and its inverse."""
    gray, paths = scene.code.gray, scene.left if camera == "left" else scene.right
    assert gray is not None
    for exposure in range(len(sample.levels)):
        levels, first = sample.frames(exposure), exposure * scene.code.frames
        for frame in range(1, gray.stripe_frames):
            same = [other for other in range(frame) if np.array_equal(levels[frame], levels[other])]
            if same and np.ptp(levels[frame]) > 0:
                other = _short(scene, camera, first + same[0])
                raise SceneError(f"{paths[first + frame]}: found the same picture as {other}, expected another bit's")
        if not gray.inverse or gray.bits < 3:
            continue
        sums = levels[: gray.stripe_frames : 2] + levels[1 : gray.stripe_frames : 2]
        usual = np.median(sums, axis=0)
        lit = (np.abs(levels[0] - levels[1]) > _LIT * sample.saturation) & (levels.max(0) < sample.saturation)
        if lit.sum() < _LEAST_LIT:
            continue
        off = np.median(np.abs(sums - usual)[:, lit] / usual[lit], axis=1)
        if off.max() > _ODD_SUM:
            bit = 2 * int(np.argmax(off))
            names = " and ".join(_short(scene, camera, first + frame) for frame in (bit, bit + 1))
            raise SceneError(
                f"{scene.folder}: found that {names} are no pattern and its inverse, expected frames of one scan in "
                "the order that scene.json says"
            )


def _faults(scene: Scene, view: CheckedFrames) -> str:
    """The frames of a camera that do not fit, each with what it looks like."""
    diagnosis = view.diagnosis or FrameDiagnosis()
    paths = scene.left if view.camera == "left" else scene.right
    looks = [(paths[fault.frame], _look(scene, view.camera, fault)) for fault in diagnosis.faults]
    if diagnosis.either:
        names = " or ".join(_short(scene, view.camera, fault.frame) for fault in diagnosis.faults)
        return (
            f"{scene.folder}: found that {names} does not fit the other frames, which one cannot be determined, "
            "expected frames that fit each other"
        )
    return "; ".join(
        f"{path}: found {look}, expected {_expected(scene, fault)}"
        for (path, look), fault in zip(looks, diagnosis.faults, strict=True)
    )


def _expected(scene: Scene, fault: FrameFault) -> str:
    frame = fault.frame % scene.code.frames
    count, step = scene.code.count_of[frame], scene.code.step_of[frame]
    exposure = f" at exposure {fault.frame // scene.code.frames + 1}" if len(scene.exposures) > 1 else ""
    return f"step {step + 1} of count {scene.code.counts[count]}{exposure}"


def _look(scene: Scene, camera: Camera, fault: FrameFault) -> str:
    count = scene.code.counts[scene.code.count_of[fault.frame % scene.code.frames]]
    other = "" if fault.other is None else _short(scene, camera, fault.other)
    look = {
        "same": f"the same picture as {other}",
        "like": f"what {other} shows",
        "dark": "a dark frame",
        "flat": "no fringes",
        "brighter": f"a frame {fault.factor:.2f} times as bright as the others",
        "darker": f"a frame {fault.factor:.2f} times as bright as the others",
        "other": "a picture that does not fit",
    }[fault.look]
    where = _rows(fault.rows)
    if where:
        return f"that it does not fit the other steps of count {count} {where} ({look})"
    return f"{look} (it does not fit the other steps of count {count})" if fault.look == "other" else look


def _rows(rows: Sequence[int | None]) -> str:
    first, end = rows
    if first is None and end is None:
        return ""
    if first is None:
        return f"above row {end}"
    return f"below row {first}" if end is None else f"in rows {first} to {end - 1}"


def _short(scene: Scene, camera: Camera, index: int) -> str:
    path = (scene.left if camera == "left" else scene.right)[index]
    return path.relative_to(scene.folder).as_posix()
