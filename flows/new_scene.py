"""From frames with other programs' names to a scene folder that Flushline inspects."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrology.code_guess import CodeGuess, guess_code
from metrology.errors import SceneError
from metrology.frame_consistency import frame_consistency
from metrology.frame_sample import sample_frames
from metrology.fringe import FringeCode
from metrology.noise import NoiseModel
from metrology.saturation import code_saturation
from storage.documents import read_json, utc_text
from storage.frame_pages import PAGES, write_pages
from storage.frames import read_header, read_stack
from storage.models import validate
from storage.scene_models import FORMAT, MANIFEST, Camera, FringeModel, SceneModel, fringe_document
from storage.scene_names import (
    Values,
    as_grey,
    by_count_and_step,
    by_number,
    cameras_of,
    count_names,
    exposure_names,
    in_sequence,
    matching,
    runs_through,
    shared_sequence,
    without_others,
)

_MOST_CONTRADICTORY = 0.03
_MOST_LABELS = 4
_USUAL_SIGMA = 2 / 255  # of the range
_OFFSETS_ALIKE = 0.06  # radians
_SHIFTS_ALIKE = 0.04  # stripes

Listed = dict[str, list[list[Path]]]
"""Each camera's frames of every exposure, in the code's order as shown."""


def frames_by_name(options: argparse.Namespace, code: FringeCode) -> tuple[Listed, list[str]]:
    """Each camera's frames by the patterns of their names; and notes about them."""
    if options.pattern.startswith(f"{PAGES}/"):
        write_pages(options.folder)
    found = matching(options.folder, options.pattern)
    if options.cameras:
        found = shared_sequence(found, options.cameras)
    found, notes = without_others(found)
    both = options.cameras or "{camera}" in options.pattern
    named: dict[Camera, str] = cameras_of(found, options.left) if both else {"left": ""}
    listed: Listed = {}
    for camera, name in named.items():
        listed[camera] = []
        for exposure in exposure_names(found):
            own = {path: values for path, values in found.items() if values.get("exposure", "") == exposure}
            paths = _of_one_exposure(options, code, own, camera, name)
            grey = [as_grey(path, options.folder) for path in paths]
            notes += [f"note: {note}" for _, note in grey if note]
            listed[camera].append([path for path, _ in grey])
            called = " ".join(filter(None, [repr(name) if name else "the only camera", exposure]))
            notes.append(f"{camera}: {called}, {len(paths)} frames from {paths[0].name} to {paths[-1].name}")
    return listed, notes


def _of_one_exposure(
    options: argparse.Namespace, code: FringeCode, found: Mapping[Path, Values], camera: str, name: str
) -> list[Path]:
    if runs_through(options.pattern):
        usual = ["fringes"] * bool(code.counts) + ["gray"] * bool(code.gray)
        usual += ["white", "black"] * bool(code.gray and code.gray.references)
        paths = in_sequence(by_number(found, name), code, options.sequence or usual)
    else:
        paths = by_count_and_step(found, name, code, _labels(options))
        if options.gray_pattern:
            paths += by_number(matching(options.folder, options.gray_pattern), name)
    if len(paths) != code.frames:
        raise SceneError(f"{camera} camera: found {len(paths)} frames, expected {code.frames} for this code")
    return paths


def _labels(options: argparse.Namespace) -> list[str]:
    """What the counts are called: as given, or by their periods."""
    return options.labels or [str(period) for period in options.periods or ()]


def untold_labels(options: argparse.Namespace, code: FringeCode) -> list[str]:
    """What the counts are called where nothing but the order of the names tells which is which."""
    names, told = count_names(matching(options.folder, options.pattern), code, _labels(options))
    return [] if told else names


def exposure_times(options: argparse.Namespace) -> tuple[float, ...]:
    """The exposures' times, in the order of `frames_by_name`: as they are given, or as the names have them."""
    names = exposure_names(matching(options.folder, options.pattern))
    if len(names) == 1:
        return (1.0,)
    told = options.exposures or [float(n) for n in names if n.replace(".", "", 1).isdigit() and float(n) > 0]
    if len(told) != len(names):
        raise SceneError(
            f"{options.folder}: found {len(told)} times of the exposures {', '.join(names)}, expected {len(names)} "
            "(--exposures, in this order)"
        )
    return tuple(told)


def new_scene(
    folder: Path,
    key: Sequence[str],
    rig_id: str,
    shown: FringeModel,
    listed: Listed,
    guess: bool = True,
    exposures: Sequence[float] = (1.0,),
    labels: Sequence[str] = (),
    replace: bool = False,
) -> list[str]:
    """Write scene.json; returns what is to be said about the code.

    Parameters
    ----------
    key : (aircraft serial, panel, station, captured at)
    shown : FringeModel
        The code as declared.
    listed : dict
        Each camera's frames as shown.
    guess : bool
        Whether the frames say what offsets, direction, order of bits and borders are.
    exposures : sequence of float
        Their times.
    labels : sequence of str
        What the counts are called, where the names' order was taken for theirs.
    replace : bool
        Whether to write in place of another scene.json.
    """
    lines: list[str] = []
    fringe = shown.model_dump(mode="json", exclude_defaults=True)
    document = {
        "format": FORMAT,
        **dict(zip(("aircraft_serial", "panel", "station", "captured_at"), key, strict=True)),
        "rig": rig_id,
        "fringe": fringe,
        "exposures": list(exposures),
        "frames": {
            camera: [[path.relative_to(folder).as_posix() for path in paths] for paths in of]
            for camera, of in listed.items()
        },
    }
    model = validate(SceneModel, document, folder / MANIFEST, SceneError)
    document["captured_at"] = utc_text(model.captured_at)
    if not replace:
        _refuse_another(folder / MANIFEST, document, shown)
    if guess:
        lines, document["fringe"] = _told_by_frames(folder, shown, listed, labels)
        model = validate(SceneModel, document, folder / MANIFEST, SceneError)
    _refuse_contradictions(model, folder)
    return [*lines, *_written(folder / MANIFEST, document, replace)]


def _told_by_frames(
    folder: Path, shown: FringeModel, listed: Listed, labels: Sequence[str]
) -> tuple[list[str], dict[str, Any]]:
    """What the frames say of the code, in words and as scene.json has it."""
    backward = shown.direction < 0 and shown.gray is None  # without Gray code only the user knows
    found = guesses(shown.code, _as_stepped(shown, listed) if backward else listed, labels)
    best = _common(found)
    if len(found) == 1 and best.others:
        offsets = ", ".join(f"{psi:.3f}" for psi in sorted((best.code.phase_offsets_rad or (0.0,))[:1] + best.others))
        raise SceneError(
            f"{folder}: found that counts {', '.join(map(str, shown.code.counts))} agree with the phase offsets "
            f"{offsets} rad alike, expected the one of the patterns, which one camera must know: "
            "--offset RAD (-1.571: sine; cosine: --offset 0 --as-declared)"
        )
    fringe = fringe_document(best.code)
    fringe |= {"direction": -1} if best.direction < 0 or backward else {}
    if best.lsb_first and "gray" in fringe:
        fringe["gray"] |= {"first": "lsb"}
    if best.inverse_first and "gray" in fringe:
        fringe["gray"] |= {"inverse_first": True}
    if best.binary and "gray" in fringe:
        fringe["gray"] |= {"binary": True}
    return guess_lines(found), fringe


def _refuse_another(path: Path, document: Mapping[str, object], shown: FringeModel) -> None:
    """SceneError where scene.json is there and says something else than what is known before frames are read."""
    if not path.exists():
        return
    there = read_json(path, SceneError)
    differ = [key for key in document if key != "fringe" and there.get(key) != document[key]]
    try:
        same = _declared(validate(FringeModel, there.get("fringe") or {}, path, SceneError).code) == _declared(
            shown.code
        )
    except SceneError:
        same = False
    if differ or not same:
        raise _another(path, [*differ, *["fringe"] * (not same)])


def _declared(code: FringeCode) -> tuple[object, ...]:
    """What of a code no frames tell."""
    gray = code.gray and (code.gray.stripes, code.gray.inverse, code.gray.references)
    return code.axis, code.step_counts, code.counts, code.size_px, gray


def _another(path: Path, keys: Sequence[str]) -> SceneError:
    return SceneError(
        f"{path}: found another scene there already (other {', '.join(keys)}), expected none: --replace writes it anew"
    )


def _written(path: Path, document: Mapping[str, object], replace: bool) -> list[str]:
    """Write scene.json unless it says something else; a line where it says the same already."""
    if path.exists() and not replace:
        there = read_json(path, SceneError)
        if there == document:
            return [f"{path}: says so already"]
        differ = [key for key in {**document, **there} if there.get(key) != document.get(key)]
        raise _another(path, differ)
    path.write_text(json.dumps(document, indent=1, ensure_ascii=False), encoding="utf-8")
    return []


def _as_stepped(shown: FringeModel, listed: Listed) -> Listed:
    """The frames with their steps forward."""
    return {camera: [list(shown.ordered(paths)) for paths in of] for camera, of in listed.items()}


def guesses(
    code: FringeCode, listed: Mapping[str, Sequence[Sequence[Path]]], labels: Sequence[str] = ()
) -> dict[str, CodeGuess]:
    """What each camera's frames of the middle exposure say; `labels` as `new_scene` has them."""
    found: dict[str, CodeGuess] = {}
    for camera, of in listed.items():
        paths = of[len(of) // 2]
        frames = _read(paths)
        try:
            saturation = code_saturation(frames[None], code)
            found[camera] = guess_code(frames, code, saturation)
        except SceneError as problem:
            better = _other_labels(frames, code, saturation, labels)
            raise SceneError(f"{paths[0].parent}: {camera} camera: {problem}{better}") from None
    return found


def _other_labels(frames: NDArray, code: FringeCode, saturation: float, labels: Sequence[str]) -> str:
    """The order of the counts' names in which the frames agree, as the end of a message."""
    if not 2 <= len(labels) <= _MOST_LABELS or len(labels) != len(code.counts) or len(set(code.step_counts)) > 1:
        return ""
    steps = code.step_counts[0]
    rest = list(range(code.fringe_frames, code.frames))
    for order in permutations(range(len(labels))):
        shown = [k * steps + step for k in order for step in range(steps)] + rest
        try:
            guess_code(frames[shown], code, saturation)
        except SceneError:
            continue
        return f"; they agree with --labels {' '.join(labels[k] for k in order)}"
    return ""


def guess_lines(found: Mapping[str, CodeGuess]) -> list[str]:
    """What the frames say, in words."""
    lines = []
    for camera, one in found.items():
        said = []
        if one.code.counts:
            offsets = one.code.phase_offsets_rad
            alike = len(set(offsets)) <= 1
            told = f"{offsets[0]:.3f}" if offsets and alike else ", ".join(f"{o:.3f}" for o in offsets) or "0"
            more = " (others agree as well: where the projector matters, --offset says which)" if one.others else ""
            said.append(f"phase offset {told} rad{more}")
            if one.code.gray:
                said.append("steps forward" if one.direction > 0 else "steps backward (direction -1)")
        if one.code.gray:
            inverse = ", each bit's inverse first" if one.inverse_first else ""
            name = "plain binary" if one.binary else "Gray code"
            said.append(f"{name} from the {'finest' if one.lsb_first else 'coarsest'} bit on{inverse}")
        if one.code.gray and one.code.counts:
            said.append(f"stripes' borders {one.code.gray.shift:+.3f} stripes beyond the fringes' wraps")
        lines.append(f"{camera}: {'; '.join(said)}; agreement {one.agreement:.0%}")
    return lines


def _common(found: Mapping[str, CodeGuess]) -> CodeGuess:
    """What the cameras say; SceneError where they say different things, for they saw one projector."""
    if len(found) == 1:
        return found["left"]
    left, right = found["left"], found["right"]
    same = all(
        getattr(left, name) == getattr(right, name) for name in ("direction", "lsb_first", "inverse_first", "binary")
    )
    offsets = [np.array(one.code.phase_offsets_rad or (0.0,) * len(one.code.counts)) for one in (left, right)]
    apart = np.angle(np.exp(1j * (offsets[0] - offsets[1])))
    shifts = [one.code.gray.shift if one.code.gray else 0.0 for one in (left, right)]
    if not same or np.abs(apart).max(initial=0) > _OFFSETS_ALIKE or abs(shifts[0] - shifts[1]) > _SHIFTS_ALIKE:
        raise SceneError(
            f"found cameras whose frames say different things ({'; '.join(guess_lines(found))}), expected frames of "
            "one projector, in the same order for both"
        )
    return left if left.agreement >= right.agreement else right


def _refuse_contradictions(model: SceneModel, folder: Path) -> None:
    code = model.fringe.code
    for camera in model.frames.cameras:
        exposures = getattr(model.frames, camera)
        paths = exposures[len(exposures) // 2]
        if not code.counts:
            continue
        frames = model.fringe.as_gray_code(_read([folder / path for path in model.fringe.ordered(paths)])[None])
        judged = frame_consistency(sample_frames(frames, code, NoiseModel(_usual_variance(frames, code), 0.0)), 0)
        if judged.judged and judged.contradictory > _MOST_CONTRADICTORY:
            raise SceneError(
                f"{folder}: found fringes that contradict each other in {judged.contradictory:.0%} of the lit pixels "
                f"of the {camera} camera, expected the counts, steps and order of the frames that were shown"
            )


def _usual_variance(frames: NDArray, code: FringeCode) -> float:
    """Of a sample, in squares of its own grey levels: that of two levels in 255."""
    return (_USUAL_SIGMA * code_saturation(frames, code)) ** 2


def _read(paths: Sequence[Path]) -> NDArray:
    """(frames, h, w) of one camera."""
    return read_stack(paths, read_header(paths[0], SceneError), SceneError).frames
