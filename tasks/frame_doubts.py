"""What is odd about a scan's frames and did not stop it: said in a plain line, and its values widened or doubted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from metrology.cloud import DecodedView, PixelFlag, Reconstruction
from metrology.contrast_match import CONTRAST_LIMIT, contrast_apart
from metrology.focus import fringe_blur
from metrology.frame_doubts import FrameDoubt
from metrology.frame_ghosts import beyond_movement, moved_by
from metrology.fringe import Axis, FringeCode
from metrology.noise_texture import NoiseTexture
from metrology.reconstruct import coordinate_size
from metrology.rig import Rig
from metrology.ripple import with_equal_ripples
from metrology.third_view import bent_places
from storage.scene import Scene
from tasks.scan_checks import CheckedFrames

# Edges are taken to reach two blur radii and a pixel: at twice the blur a fifteenth of the light comes from beyond.
# Sound cameras and projectors together have 1.0 to 1.3 times it.
_BLURRED = 2.0
# Beyond a quarter more not borders alone but rings and the skin beside edges are mixed.
_SHIFTED = 1.25
# Noise below half a level does not average rounding out. The rounding of fringes of so many levels is as large as the
# noise of a good scan: 0.29 levels to 12 as 1.5 to 60.
_HALF_A_LEVEL, _FAINT = 0.5, 12.0
_STRIDE = 4
# Of the deviation from which frames are refused: flicker of 2 % with vibration leaves less than half.
_DOUBTFUL = 0.5
# Independent pixels leave a grain of 1, known to 2 %. The mildest sharpening that cameras offer leaves 0.85.
_SHARPENED, _WIDENED = 0.88, 1.1
# A colour camera's interpolation leaves a correlation of 0.25 between neighbours and a grain of 1.6: that is no fault,
# only a wider U95.
_SMOOTHED, _COARSE, _WAVES = 0.35, 1.9, 0.05
# Cameras differ by less in what they make of a projector's harmonics.
_HARMONICS_APART = 0.02
# Columns of a colour camera scatter up to twice as far as its blocks, and harmonics that change with the light, as a
# camera's gamma makes them, leave more. A filter's reach ends: far pixels share less.
_STRIPED, _PER_HARMONIC, _REACHES = 2.0, 5.0, 0.6
# Of lit pixels; a pixel is lit that reaches this level.
_MOST_CUT, _BRIGHT = 0.002, 10
# What counts miss each other by: sound scans leave less than noise once flicker and movement are allowed for, a second
# picture of a fiftieth 0.003 to 0.018. One camera alone does not tell movement: 15 µm of it leave up to 0.005.
_DISAGREEMENT_RAD, _DISAGREEMENT_MOVED_RAD = 0.004, 0.006
# Flicker of this share from row to row makes relief of some micrometres; a sound scan's rows differ by noise alone.
_ROLLING = 0.006
# Glints of heads and edges are less.
_MOST_CLIPPED = 0.05


def widened(view: DecodedView, texture: NoiseTexture | None) -> DecodedView:
    """The view with the σ that means over several pixels have where neighbours share their noise."""
    wider = max(texture.grain, texture.columns) if texture else 1.0
    return view if wider <= _WIDENED else replace(view, sigma=view.sigma * np.float32(wider))


def frame_doubts(
    views: Sequence[DecodedView],
    checked: Sequence[CheckedFrames],
    rig: Rig,
    code: FringeCode,
    blur_radius_px: float,
) -> list[FrameDoubt]:
    """What the frames of the cameras make doubtful, the first of its kind."""
    size = coordinate_size(rig, code)
    both, bent = list(zip(views, checked, strict=True)), len(checked) == 2 and _shapes(checked) is not None
    found = (
        (_blurred(view, frames, size, _BLURRED * blur_radius_px) for view, frames in both),
        (_rounded(view, frames) for view, frames in both),
        (_clipped(view, frames) for view, frames in both),
        (_cut_off(frames) for frames in checked),
        (_rolling(frames) or _processed(frames.camera, frames.texture, bent) for frames in checked),
        _seen_twice(checked, rig, code.axis),
    )
    return [doubt for kind in found if (doubt := next(filter(None, kind), None))]


def bent_light(reconstruction: Reconstruction, axis: Axis) -> tuple[FrameDoubt, ...]:
    """Places where a lens bends light otherwise than the rig says: relief there may be none."""
    found = bent_places(reconstruction, axis)
    if not found:
        return ()
    worst = max(found, key=lambda bent: bent.off_px)
    (left, right), (top, bottom) = worst.place.u_px, worst.place.v_px
    return (
        FrameDoubt(
            f"light bent locally (places: {len(found)}, the worst {right - left:.0f} × {bottom - top:.0f} px around u "
            f"{(left + right) / 2:.0f}, v {(top + bottom) / 2:.0f} in the left picture): the projector coordinate "
            f"is up to {worst.off_px:.2f} px off what the rig says, expected at most {worst.limit_px:.2f}: what looks "
            "like a dent or a bump there may be none; look for a drop, dirt or stray light on a lens or its window "
            "(either camera's or the projector's), and for fringes that mirror in something; clean them and scan again",
            f"light bent locally: the projector coordinate is up to {worst.off_px:.2f} px off",
            relief=True,
            places=tuple(bent.place for bent in found),
        ),
    )


def veiled(reconstruction: Reconstruction) -> tuple[FrameDoubt, ...]:
    """Contrast that one camera alone loses in a part of its picture: relief at the ends of what is lit may be none."""
    found = contrast_apart(reconstruction)
    if found is None:
        return ()
    return (
        FrameDoubt(
            f"veiled: the cameras' fringes differ in contrast by {found:.0%} more in a part of the picture than what "
            f"changes smoothly over it, expected at most {CONTRAST_LIMIT:.0%}: what looks like a dent or a bump may be "
            "none; look for stray light or dirt on one camera's lens or its window, and for a lamp that shines into it",
            "fringes of one camera veiled in a part of its picture",
            relief=True,
        ),
    )


def without_unevenness(
    left: DecodedView, right: DecodedView, checked: Sequence[CheckedFrames], scene: Scene, size: int
) -> tuple[DecodedView, DecodedView, tuple[str, ...]]:
    """Both views without what uneven frames, or a camera's gamma, leave in one and not in the other; and what is said.

    Parameters
    ----------
    size : int
        W, projector pixels along the fringe axis.
    """
    worst = {view.camera: max((judged.deviation for judged in view.found), default=0.0) for view in checked}
    uneven, shapes = any(judged.uneven for view in checked for judged in view.found), _shapes(checked)
    if not uneven and not shapes:
        return left, right, ()
    left, right, difference = with_equal_ripples(left, right, scene.code, size, of_shape=bool(shapes))
    remarks = []
    if shapes:
        remarks.append(
            f"the cameras see fringes of different shape (harmonics of {shapes[0]:.0%} and {shapes[1]:.0%} of their "
            "amplitude, expected the same): one of them has a gamma or contrast curve; the ripple that it makes was "
            "taken out; let both cameras give linear grey levels"
        )
    elif difference > 1:
        camera = max(worst, key=lambda name: worst[name])
        remarks.append(
            f"the frames of the {camera} camera are uneven in another way than the other camera's (a blurred frame, a "
            "late trigger, light that flickers): the ripple that they make was taken out; look at triggers and light"
        )
    left_over = {view.camera: max((judged.unexplained for judged in view.found), default=0.0) for view in checked}
    if difference <= 1 and max(left_over.values()) > _DOUBTFUL:
        cameras = " and ".join(name for name, deviation in left_over.items() if deviation > _DOUBTFUL)
        remarks.append(
            f"frames of the {cameras} camera hardly fit each other ({max(left_over.values()):.0%} of what is refused): "
            "look for light that flickers or changes, dark parts cut off at black, movement, or a blurred frame"
        )
    return left, right, tuple(remarks)


def _shapes(checked: Sequence[CheckedFrames]) -> tuple[float, float] | None:
    """Harmonics of the fringes in both cameras, as shares of their amplitude, where they differ."""
    one, other = (frames.texture.harmonics if frames.texture else None for frames in checked)
    if one is None or other is None or np.abs(one - other).max() <= _HARMONICS_APART:
        return None
    return float(np.abs(one).max()), float(np.abs(other).max())


def _blurred(view: DecodedView, frames: CheckedFrames, size: int, limit: float) -> FrameDoubt | None:
    """Fringes so blurred that edges reach farther than they are taken to."""
    blur = fringe_blur(frames.sample, view, size) if frames.found else None
    if blur is None or blur <= limit:
        return None
    clause = f"fringes of the {frames.camera} camera blurred by {blur:.1f} px"
    return FrameDoubt(
        f"blurred: the {frames.camera} camera's fringes are blurred by {blur:.1f} px, expected at most {limit:.1f}; "
        "gaps are not measured, heights and steps beside edges may be off; did something move while it exposed, or "
        "is the camera or the projector out of focus? Scan again at rest; whoever turns a focus ring calibrates again",
        clause,
        quantities=("width",) if blur <= _SHIFTED * limit else ("width", "step", "height", "tilt"),
    )


def _rounded(view: DecodedView, frames: CheckedFrames) -> FrameDoubt | None:
    """Fringes of so few levels, and noise so low, that rounding to grey levels draws relief."""
    seen = np.isfinite(view.coordinate[::_STRIDE, ::_STRIDE])
    if view.noise is None or not seen.any():
        return None
    fringes = float(np.median(view.modulation[::_STRIDE, ::_STRIDE][seen])) / frames.level_step
    level = float(np.median(view.texture[::_STRIDE, ::_STRIDE][seen]))
    noise = np.sqrt(view.noise.read_variance + view.noise.gain * level) / frames.level_step
    if fringes >= _FAINT or noise > _HALF_A_LEVEL:
        return None
    camera = frames.camera
    return FrameDoubt(
        f"faint: the {camera} camera's fringes have {fringes:.0f} grey levels (of {frames.level_step:.0f} each), "
        f"expected {_FAINT:g} at least; rounding may show as defects and steps that are none, and gaps are not "
        "measured; expose longer, look at focus and other light, and let the files keep all bits of the camera",
        f"fringes of the {camera} camera of {fringes:.0f} grey levels, whose rounding may look like it",
        relief=True,
        quantities=("width",),
    )


def _clipped(view: DecodedView, frames: CheckedFrames) -> FrameDoubt | None:
    """Crests cut off in many pixels of fringes with harmonics, which cancel between cameras in whole fringes only."""
    seen = np.isfinite(view.coordinate[::_STRIDE, ::_STRIDE])
    if len(frames.found) != 1 or frames.texture is None or not seen.any():  # of several exposures one is whole
        return None
    clipped = float(((view.flags[::_STRIDE, ::_STRIDE] & PixelFlag.SATURATED_SAMPLES) != 0)[seen].mean())
    harmonics = float(np.abs(frames.texture.harmonics).max())
    if clipped <= _MOST_CLIPPED or harmonics <= _HARMONICS_APART:
        return None
    camera = frames.camera
    return FrameDoubt(
        f"overexposed: the crests of the {camera} camera's fringes are cut off in {clipped:.0%} of its pixels, "
        f"expected at most {_MOST_CLIPPED:.0%} where fringes are no sinusoids (harmonics of {harmonics:.0%}): what "
        "looks like a dent or a bump may be none; take a shorter exposure, or one as well; is the camera's black level "
        "raised?",
        f"crests of the {camera} camera's fringes cut off",
        relief=True,
    )


def _cut_off(frames: CheckedFrames) -> FrameDoubt | None:
    """Troughs cut off at black: a fringe that stays above it touches 0 in one step, not in a quarter of its period."""
    code, levels = frames.sample.code, frames.sample.frames(0)
    if not code.counts or frames.level_step > 1:  # 0 is then whatever lies below a step
        return None
    cut, lit = np.zeros(levels.shape[1], bool), np.zeros(levels.shape[1], bool)
    for k, steps in enumerate(code.step_counts):
        own = levels[: code.fringe_frames][code.count_of == k]
        bright = own.max(0) >= _BRIGHT
        lit |= bright
        cut |= bright & ((own <= 0).sum(0) > max(1, steps // 4))
    share = float(cut.sum() / max(1, lit.sum()))
    if share <= _MOST_CUT:
        return None
    return FrameDoubt(
        f"cut off at black: {share:.1%} of the {frames.camera} camera's lit pixels are 0 for a quarter of a fringe and "
        "more, expected none: dark edges lie elsewhere in such pictures, and gaps are not measured; raise the camera's "
        "black level",
        f"pictures of the {frames.camera} camera cut off at black",
        quantities=("width",),
    )


def _seen_twice(checked: Sequence[CheckedFrames], rig: Rig, axis: Axis) -> Iterator[FrameDoubt | None]:
    """A second picture of the fringes, which every frame holds, in each camera."""
    told = [[judged.disagreement for judged in frames.found] for frames in checked]
    moved = moved_by(rig, axis) if len(checked) == 2 else None
    found = [[missed.beyond_noise() if missed else 0.0 for missed in camera] for camera in told]
    if moved:
        for k, (left, right) in enumerate(zip(*told, strict=True)):
            if left and right:
                found[0][k], found[1][k] = beyond_movement(left, right, moved)
    limit = _DISAGREEMENT_RAD if moved else _DISAGREEMENT_MOVED_RAD
    return (_second(frames, max(each, default=0.0), limit) for frames, each in zip(checked, found, strict=True))


def _second(frames: CheckedFrames, found: float, limit: float) -> FrameDoubt | None:
    if found <= limit:
        return None
    camera = frames.camera
    return FrameDoubt(
        f"the {camera} camera sees a second, fainter picture of the fringes (phases of its counts miss each other by "
        f"{found:.3f} rad, expected at most {limit:g}): what looks like a dent or a bump may be none; look "
        "for a reflection within the lens, its filter or a window, or from something bright beside the skin, and for "
        "movement between the counts",
        f"a second picture of the fringes in the {camera} camera",
        relief=True,
    )


def _rolling(frames: CheckedFrames) -> FrameDoubt | None:
    """Light that flickers while the shutter rolls from row to row."""
    found = max((judged.rolling for judged in frames.found), default=0.0)
    if found <= _ROLLING:
        return None
    camera = frames.camera
    return FrameDoubt(
        f"the brightness of the {camera} camera's frames changes from row to row, in each frame another way "
        f"({found:.1%}, expected at most {_ROLLING:.1%}): what looks like a dent or a bump may be none; light flickers "
        "while the shutter rolls: expose for whole periods of the light, or take a global shutter",
        f"frames of the {camera} camera whose brightness changes from row to row",
        relief=True,
    )


def _processed(camera: str, texture: NoiseTexture | None, bent: bool) -> FrameDoubt | None:
    """Pictures that are not as the sensor gave them, by their noise; a `bent` shape of fringes shows in columns too."""
    if texture is None:
        return None
    smoothed = texture.neighbours > (_SMOOTHED if texture.grain <= _COARSE else _SMOOTHED / 3)
    far, columns, scatter = abs(texture.waves), texture.columns, max(texture.grain, texture.columns)
    striped = _STRIPED * max(texture.grain, 1) * (1 + _PER_HARMONIC * float(np.abs(texture.harmonics).max()))
    if (columns > striped and not bent) or (
        far > (_REACHES * texture.neighbours if smoothed else _WAVES) or (texture.grain > _COARSE and not smoothed)
    ):
        return FrameDoubt(
            f"the {camera} camera's pictures bear waves or stripes that change from frame to frame (pixels far apart "
            f"share {far:.0%} of their noise, and means of columns and blocks scatter {scatter:.1f} "
            f"times as far as a sensor's, expected none and 1.0): what looks like a dent or a bump may be none; look "
            "for a beat (moiré) of camera and projector, a lamp that flickers, or the camera's readout",
            f"pictures of the {camera} camera with waves or stripes that change from frame to frame",
            relief=True,
        )
    if smoothed:
        return FrameDoubt(
            f"the {camera} camera's pictures were smoothed, scaled or compressed (neighbouring pixels share "
            f"{texture.neighbours:.0%} of their noise, expected none): U95 allows for that, gaps are not "
            "measured, and what looks like a dent or a bump may be none; keep pictures as the sensor gives them, "
            "without filters and JPEG",
            f"pictures of the {camera} camera smoothed, scaled or compressed",
            relief=True,
            quantities=("width",),
        )
    if texture.grain < _SHARPENED and texture.neighbours < 0:
        return FrameDoubt(
            f"the {camera} camera's pictures were sharpened (their noise averages out {1 / texture.grain:.1f} times as "
            "fast as a sensor's): gaps are not measured, and steps and heights beside edges may be off; switch the "
            "camera's sharpening off",
            f"pictures of the {camera} camera sharpened",
            quantities=("width",),
        )
    return None
