"""Likely mix-ups of frames, tried on decoded views when a scan does not fit its rig: which one makes it fit.

A mix-up is undone on the decoded views (exchange them, turn or mirror an image, reverse the coordinate) or on the rig
(leave out the lens distortion, take R and t in another convention); the scan is then triangulated and the rig judged as
always. All are tried by the third view, or texture, with every third row and column of large images; those that fit are
confirmed by texture with all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from metrology.cloud import DecodedView, Reconstruction
from metrology.epipolar import trying_rigs
from metrology.fringe import Axis
from metrology.reconstruct import triangulate
from metrology.rig import Device, Rig
from metrology.rig_health import HealthSettings, epipolar_health, projector_rms
from metrology.rig_plausibility import poses, stands_left

Turn = tuple[int, int]  # steps through an image's rows and columns, 1 or −1

_EVERY = 3
_LARGE_PX = 900  # images narrower than this are not thinned: too few patches of texture would be left
# What is mixed up is off by many pixels; put right it is ten times closer, even where the rig has drifted a little.
_CLOSER = 10.0
_MOST_OFF_PX = 5.0
_CONFIRMED = 3
# Of the pixels that both cameras decode, the share that must find a counterpart.
_LEAST_MATCHED = 0.3  # of what both cameras decoded


@dataclass(frozen=True)
class MixUp:
    """What was mixed up."""

    when: str
    """What makes the scan fit, to be read after "the frames fit the rig when …"."""
    expected: str
    """What the scan should be."""


@dataclass(frozen=True)
class _Scan:
    left: DecodedView
    right: DecodedView
    rig: Rig


@dataclass(frozen=True)
class _Hypothesis:
    mix_up: MixUp
    undo: Callable[[_Scan, int], _Scan]


_TURNS: dict[Turn, str] = {
    (-1, -1): "turned by 180° (they are upside-down)",
    (1, -1): "mirrored left to right",
    (-1, 1): "mirrored top to bottom",
}
_ANY = Device(2, 2, np.eye(3), np.zeros(5), np.eye(3), np.zeros(3))
_AS_CALIBRATED = "frames as the cameras gave them when the rig was calibrated"
_AS_LISTED = "scene.json to list them as the rig's cameras are"
_AS_SHOWN = "the steps in the order that scene.json says"


@trying_rigs()
def find_mix_up(
    reconstruction: Reconstruction, axis: Axis, projector_size: int, settings: HealthSettings | None = None
) -> MixUp | None:
    """The mix-up that explains why a scan does not fit its rig; None where none does.

    Parameters
    ----------
    reconstruction : Reconstruction
        As it came out with the frames as they are.
    axis : "x" or "y"
        Of the fringes.
    projector_size : int
        Projector pixels along the fringe axis.
    """
    settings = settings or HealthSettings()
    scan = _Scan(reconstruction.left, reconstruction.with_right(), reconstruction.rig)
    misfit = _misfit(scan, axis, settings)
    if scan.rig.projector is None and not np.isfinite(misfit) and reconstruction.matched >= _LEAST_MATCHED:
        return None  # nothing tells that the frames do not fit: of two cameras exchanged and mirrored ones do as well
    limit = min(misfit / _CLOSER, _MOST_OFF_PX)
    tried = [_exchanges_and_turns(scan.rig.projector is not None), _conventions(), _undistortions()]
    if stands_left(scan.rig.with_right()):  # where the cameras' lenses are alike, an inverse pose is exchanged cameras
        tried[:2] = tried[1::-1]
    for hypotheses in tried:
        found: list[tuple[float, _Hypothesis]] = []
        for hypothesis in hypotheses:
            undone = hypothesis.undo(scan, projector_size)
            if _sizes_fit(undone) and (misfit := _misfit(undone, axis, settings)) < limit:
                found.append((misfit, hypothesis))
        for _, hypothesis in sorted(found, key=lambda item: item[0])[:_CONFIRMED]:
            if _fits(hypothesis.undo(scan, projector_size), axis, settings):
                return hypothesis.mix_up
    return None


def _misfit(scan: _Scan, axis: Axis, settings: HealthSettings) -> float:
    """How far the projector, or texture without one, is from where a scan's points tell, px; infinite where they are
    too few to tell.
    """
    every = _EVERY if scan.rig.left.width >= _LARGE_PX else 1
    rig = _thinned_rig(scan.rig, every)
    reconstruction = triangulate(_thinned(scan.left, every), _thinned(scan.right, every), rig)
    if reconstruction.matched < _LEAST_MATCHED:
        return np.inf
    if scan.rig.projector is None:
        drift = epipolar_health(reconstruction, (), axis, settings).epipolar_drift_px
        return np.inf if drift is None else every * drift
    rms = projector_rms(reconstruction, axis, replace(settings, block_px=max(16, settings.block_px // every)))
    return np.inf if rms is None else rms


def _fits(scan: _Scan, axis: Axis, settings: HealthSettings) -> bool:
    """Whether texture bears out what the third view says; a rig that has drifted a little may still be mixed up."""
    reconstruction = triangulate(_thinned(scan.left, 1), _thinned(scan.right, 1), scan.rig)
    health = epipolar_health(reconstruction, (), axis, settings)
    if scan.rig.projector is None and health.epipolar_drift_px is None:
        return False
    return max(health.projector_rms_px or 0.0, health.epipolar_drift_px or 0.0) <= _MOST_OFF_PX


def _exchanges_and_turns(projector: bool) -> Iterator[_Hypothesis]:
    """What is done to the frames of both cameras, alone or together, and to those of one.

    Steps reversed in both cameras alike are told by a projector alone.
    """
    for exchanged in (False, True):
        for turn, turned in {(1, 1): "", **_TURNS}.items():
            for reverse in (False, True) if projector else (False,):
                parts = ["left and right are exchanged"] if exchanged else []
                parts += [f"all frames are {turned}"] if turned else []
                parts += ["the phase steps are taken in reverse order"] if reverse else []
                expected = [_AS_LISTED] if exchanged else []
                expected += [_AS_CALIBRATED] if turned else []
                expected += [_AS_SHOWN] if reverse else []
                if parts:
                    mix_up = MixUp(" and ".join(parts), " and ".join(expected))
                    yield _Hypothesis(mix_up, _undoing((turn, turn), exchanged, (reverse, reverse)))
    for name, which in (("left", 0), ("right", 1)):
        for turn, turned in _TURNS.items():
            turns = (turn, (1, 1)) if which == 0 else ((1, 1), turn)
            mix_up = MixUp(f"the {name} camera's frames are {turned}", _AS_CALIBRATED)
            yield _Hypothesis(mix_up, _undoing(turns, False, (False, False)))
        mix_up = MixUp(f"the {name} camera's phase steps are taken in reverse order", _AS_SHOWN)
        yield _Hypothesis(mix_up, _undoing(((1, 1), (1, 1)), False, (which == 0, which == 1)))


def _conventions() -> Iterator[_Hypothesis]:
    """R and t of the right camera in each other convention; cameras whose lenses are exchanged."""
    expected = "a rig whose R and t lead from the left camera to the right one"
    for number, (said, _) in enumerate(poses(_ANY)):
        yield _Hypothesis(MixUp(f"its right camera's pose is read otherwise: {said}", expected), _posed(number))
    yield _Hypothesis(MixUp("K and distortion of its cameras are exchanged", "those of the left camera first"), _lenses)


def _posed(number: int) -> Callable[[_Scan, int], _Scan]:
    def undo(scan: _Scan, _: int) -> _Scan:
        right = list(poses(scan.rig.with_right()))[number][1]
        return replace(scan, rig=replace(scan.rig, right=right))

    return undo


def _lenses(scan: _Scan, _: int) -> _Scan:
    left, right = scan.rig.left, scan.rig.with_right()
    exchanged = (
        replace(left, K=right.K, distortion=right.distortion),
        replace(right, K=left.K, distortion=left.distortion),
    )
    return replace(scan, rig=replace(scan.rig, left=exchanged[0], right=exchanged[1]))


def _undistortions() -> Iterator[_Hypothesis]:
    """Frames that a program undistorted, with the camera's own matrix or one of the two that OpenCV offers for it, or
    that it rectified.
    """
    for names in (("left", "right"), ("left",), ("right",)):
        whose = "the cameras'" if len(names) == 2 else f"the {names[0]} camera's"
        when = f"{whose} lens distortion is left out (the frames were undistorted already)"
        for share in (None, 0.0, 1.0):
            yield _Hypothesis(MixUp(when, "frames as the cameras take them"), _undistorted(names, share))
    expected = "frames as the cameras take them, or a rig of their rectification (rig import of its P1 and P2)"
    mix_up = MixUp("its cameras stand parallel, their lens distortion is left out (the frames are rectified)", expected)
    for flags in (cv2.CALIB_ZERO_DISPARITY, 0):
        for share in (-1.0, 0.0, 1.0):
            yield _Hypothesis(mix_up, _rectified(flags, share))


def _undoing(turns: tuple[Turn, Turn], exchanged: bool, reverse: tuple[bool, bool]) -> Callable[[_Scan, int], _Scan]:
    def undo(scan: _Scan, size: int) -> _Scan:
        left = _turned(scan.left, turns[0], size if reverse[0] else None)
        right = _turned(scan.right, turns[1], size if reverse[1] else None)
        return _Scan(right, left, scan.rig) if exchanged else _Scan(left, right, scan.rig)

    return undo


def _undistorted(names: tuple[str, ...], share: float | None) -> Callable[[_Scan, int], _Scan]:
    """Cameras without distortion; `share` 0 keeps no border without picture, 1 the whole picture (OpenCV's alpha)."""

    def plain(device: Device) -> Device:
        K = device.K
        if share is not None:
            size = (device.width, device.height)
            K = np.asarray(cv2.getOptimalNewCameraMatrix(K, device.lens, size, share)[0], float)
        return replace(device, K=K, distortion=np.zeros(5))

    def undo(scan: _Scan, _: int) -> _Scan:
        left = plain(scan.rig.left) if "left" in names else scan.rig.left
        right = plain(scan.rig.with_right()) if "right" in names else scan.rig.with_right()
        return replace(scan, rig=replace(scan.rig, left=left, right=right))

    return undo


def _rectified(flags: int, share: float) -> Callable[[_Scan, int], _Scan]:
    """Cameras as OpenCV's rectification has them; `share` as above, −1 where it is left to OpenCV."""

    def undo(scan: _Scan, _: int) -> _Scan:
        left, right, projector = scan.rig.left, scan.rig.with_right(), scan.rig.projector
        lenses = (left.K, left.lens, right.K, right.lens)
        size = (left.width, left.height)
        found = cv2.stereoRectify(*lenses, size, right.R, right.t.reshape(3, 1), flags=flags, alpha=share)
        turn, first, second = (np.asarray(found[k], dtype=float) for k in (0, 2, 3))
        if first[0, 0] <= 0:  # OpenCV finds no part that is whole in both pictures
            return scan
        beside = np.linalg.solve(second[:, :3], second[:, 3])
        plain = replace(left, K=first[:, :3], distortion=np.zeros(5))
        right = replace(right, K=second[:, :3], distortion=np.zeros(5), R=np.eye(3), t=beside)
        projector = projector and replace(projector, R=projector.R @ turn.T)
        return replace(scan, rig=replace(scan.rig, left=plain, right=right, projector=projector))

    return undo


def _turned(view: DecodedView, turn: Turn, size: int | None) -> DecodedView:
    """A view with its image turned, and its coordinate counted from the projector's other end where a size is given."""
    if size is not None:
        # Reversed steps decode x + ½ as its negative, whole fringes apart from W − (x + ½).
        view = replace(view, coordinate=(np.float32(size - 1) - view.coordinate).astype(np.float32))
    return _sliced(view, (slice(None, None, turn[0]), slice(None, None, turn[1])))


def _sliced(view: DecodedView, part: tuple[slice, slice]) -> DecodedView:
    return DecodedView(
        coordinate=view.coordinate[part],
        sigma=view.sigma[part],
        modulation=view.modulation[part],
        texture=view.texture[part],
        flags=view.flags[part],
        noise=view.noise,
    )


def _thinned(view: DecodedView, every: int) -> DecodedView:
    """Every so many rows and columns of a view, in memory of their own as the compiled kernels want it."""
    thin = _sliced(view, (slice(None, None, every), slice(None, None, every)))
    return DecodedView(
        coordinate=np.ascontiguousarray(thin.coordinate),
        sigma=np.ascontiguousarray(thin.sigma),
        modulation=np.ascontiguousarray(thin.modulation),
        texture=np.ascontiguousarray(thin.texture),
        flags=np.ascontiguousarray(thin.flags),
        noise=thin.noise,
    )


def _thinned_rig(rig: Rig, every: int) -> Rig:
    return replace(rig, left=_thinned_device(rig.left, every), right=_thinned_device(rig.with_right(), every))


def _thinned_device(device: Device, every: int) -> Device:
    """The camera whose pixels are every third, or so, of a camera's."""
    K = device.K.copy()
    K[:2] /= every
    return replace(device, width=-(-device.width // every), height=-(-device.height // every), K=K)


def _sizes_fit(scan: _Scan) -> bool:
    pairs = ((scan.left, scan.rig.left), (scan.right, scan.rig.with_right()))
    return all(view.coordinate.shape == (device.height, device.width) for view, device in pairs)
