"""The picture of what was understood of a scene's frames: what was decoded, and how well frames bear it out."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.cloud import DecodedView
from metrology.decode import decode_phase
from metrology.errors import SceneError
from metrology.fringe import FringeCode
from metrology.gray import runs_along_rows
from metrology.reconstruct import usual_size
from storage.scene import MANIFEST, load_scene
from tasks.scan_checks import check_frames, refuse_wrong_frames
from tasks.settings import SceneChecks

_TILE = 360
_STRIP = 22  # pixels of the words above a tile
_SHADES = 8  # neighbouring stripes have different ones, as do those that are a few off
_MOST_PARTS = 90  # across the projector: more would not be seen in a tile
_WORST = 0.5  # of the modulation: the residual that is drawn brightest


def describe_scene(folder: Path, sheet: Path) -> list[str]:
    """Decode the cameras, draw the contact sheet, and say what was decoded."""
    scene = load_scene(folder)
    size = usual_size(scene.code)
    rows, lines, checked = [], [], []
    for camera in scene.headers:
        frames = scene.frames(camera)
        view = decode_phase(frames, scene.code, size, scene.exposures)
        lit = np.isfinite(view.coordinate)
        strength = float(np.median(view.modulation[lit])) if lit.any() else 0.0
        every = max(1, -(-view.texture.shape[1] // (2 * _TILE)))
        middle = int(np.argsort(scene.exposures)[len(scene.exposures) // 2])
        off = residuals(frames[middle, :, ::every, ::every], view.coordinate[::every, ::every], scene.code, size)
        usual = float(np.nanmedian(off)) if np.isfinite(off).any() else float("nan")
        lines.append(
            f"{camera}: decoded {lit.mean():.0%} of the pixels, modulation {strength:.1f} grey levels, "
            f"noise {view.noise.sigma(100) if view.noise else 0:.2f}, residual {usual:.1%} of the modulation"
        )
        if lit.any() and runs_along_rows(view.coordinate) != (scene.code.axis == "x"):
            lines.append(
                f"note: {camera}: the coordinate changes {'down' if scene.code.axis == 'x' else 'across'} the image: "
                "where the camera is not turned, these are frames of the other --axis"
            )
        rows.append(_row(camera, view, off, scene.code, size))
        checked.append(check_frames(camera, frames, view, scene))
    try:
        refuse_wrong_frames(scene, checked, SceneChecks())
    except SceneError as problem:
        lines.append(f"note: these frames will be refused: {problem}")
    sheet.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(sheet), np.vstack(rows)):
        raise SceneError(f"{sheet}: found a file that cannot be written as a picture, expected the ending .png")
    return [*lines, f"scene: {folder / MANIFEST}", f"contact sheet: {sheet}"]


def residuals(frames: NDArray, coordinate: NDArray, code: FringeCode, size: int) -> Array:
    """Root mean square of frames less what the projector shows at the decoded coordinate, as a share of its modulation.

    Parameters
    ----------
    frames : (frames, h, w) ndarray
        Of one exposure, in Flushline's order.
    coordinate : (h, w) ndarray
    size : int
        Projector pixels along the fringe axis.

    Returns
    -------
    (h, w) float64
        NaN where nothing was decoded.
    """
    seen = np.isfinite(coordinate)
    shown = code.lines((coordinate[seen] + 0.5) / size)
    levels = frames[:, seen].astype(float)
    if code.gray:  # fine stripes are blurred, which no residual of the decoding is
        fine = code.fringe_frames + code.gray.stripe_frames // code.gray.bits * -(-code.gray.bits // 2)
        shown, levels = (
            np.delete(of, np.s_[fine : code.fringe_frames + code.gray.stripe_frames], 0) for of in (shown, levels)
        )
    shown -= shown.mean(0)
    levels -= levels.mean(0)
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = (shown * levels).sum(0) / (shown**2).sum(0)
        off = np.sqrt(((levels - gain * shown) ** 2).mean(0)) / np.abs(gain / 2)
    found = np.full(coordinate.shape, np.nan)
    found[seen] = off
    return found


def _row(camera: str, view: DecodedView, off: Array, code: FringeCode, size: int) -> NDArray[np.uint8]:
    """Texture, modulation, coordinate, orders and residuals of one camera beside each other."""
    good = np.isfinite(view.coordinate)
    low, high = np.quantile(view.coordinate[good], [0.001, 0.999]) if good.any() else (0.0, 1.0)
    parts = max(code.counts) if code.counts else code.gray.stripes if code.gray else 1
    merged = -(-parts // _MOST_PARTS)
    order = np.floor((np.nan_to_num(view.coordinate) + 0.5) / size * parts).astype(int)
    seen, ends = order[good], [round(100 * (end + 0.5) / size) for end in (low, high)]
    what = "fringe" if code.counts else "stripe"
    tiles = (
        (f"{camera}: texture", _grey(view.texture)),
        ("modulation", _grey(view.modulation)),
        (
            f"coordinate {ends[0]} to {ends[1]} % of the code",
            _coloured((view.coordinate - low) / max(high - low, 1e-9)),
        ),
        (
            f"{what} {seen.min()} to {seen.max()} of {parts}" if seen.size else "no orders",
            _coloured(np.where(good, order // merged * 3 % _SHADES / (_SHADES - 1), np.nan)),
        ),
        (f"residual, white {_WORST:.0%}", _coloured(off / _WORST, cv2.COLORMAP_HOT)),
    )
    return np.hstack([_tile(words, picture, view.texture.shape) for words, picture in tiles])


def _tile(words: str, picture: NDArray[np.uint8], shape: tuple[int, ...]) -> NDArray[np.uint8]:
    size = (_TILE, round(_TILE * shape[0] / shape[1]))
    shrunk = cv2.resize(picture, size, interpolation=cv2.INTER_NEAREST)
    head = np.zeros((_STRIP, _TILE, 3), np.uint8)
    cv2.putText(head, words, (4, _STRIP - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1, cv2.LINE_AA)
    return np.vstack([head, shrunk])


def _coloured(share: NDArray, colours: int = cv2.COLORMAP_TURBO) -> NDArray[np.uint8]:
    """Colours of values from 0 to 1; black where there are none."""
    level = (np.clip(np.nan_to_num(share), 0, 1) * 255).astype(np.uint8)
    picture = np.asarray(cv2.applyColorMap(level, colours), np.uint8)
    picture[~np.isfinite(share)] = 0
    return picture


def _grey(values: NDArray) -> NDArray[np.uint8]:
    high = max(float(np.quantile(values[::4, ::4], 0.995)), 1e-6)
    grey = np.clip(values / high * 255, 0, 255).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=-1)
