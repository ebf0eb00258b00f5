"""What a folder of frames that nobody has described seems to hold, and the command that makes a scene of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flows.new_scene import guess_lines
from metrology.code_guess import CodeGuess, guess_code
from metrology.errors import SceneError
from metrology.frame_kinds import Run, runs_of, sample
from metrology.fringe import Axis, FringeCode, GrayCode
from metrology.saturation import saturation_level
from storage.frame_patterns import NamePattern, name_patterns
from storage.frames import read_as_grey
from storage.scene_names import by_number, cameras_of, matching, natural

_PER_STRIPE = (1, 2, 4)  # stripes per fringe that codes have
_MOST_PATTERNS = 4
_LEAST_FRAMES = 3
_LEAST_BITS, _MOST_BITS = 3, 14
_COUNTS = (
    "COUNT: how many fringes the projector showed across, in the frames' order; the frames do not tell. Periods in "
    "projector pixels do as well: --periods in place of --counts"
)
_ID = "ID is the rig's, as `flushline rig import --id` has it; whether all is right shows scene new's contact sheet"


@dataclass(frozen=True)
class _Command:
    """A call of `scene new` as far as the frames tell it."""

    text: str
    code: FringeCode | None
    """None where the numbers of fringes are not known."""
    frames: tuple[int, ...]
    """Which of the frames, in the order of their names, are the code's."""


def guess_folder(folder: Path) -> list[str]:
    """Lines that say which pictures there are, what they show, and what to call.

    Raises
    ------
    SceneError
        Where there are no pictures, or none that show a pattern.
    """
    patterns = [one for one in name_patterns(folder) if len(one.paths) >= _LEAST_FRAMES]
    lines = []
    for one in patterns[:_MOST_PATTERNS]:
        lines += _of_pattern(folder, one)
    if not lines:
        raise SceneError(f"{folder}: found no three pictures whose names differ in numbers alone, expected frames")
    if more := patterns[_MOST_PATTERNS:]:
        lines.append(f"and {len(more)} more kinds of names, such as {more[0].paths[0].name}")
    return [*lines, _ID] if any("--rig ID" in line for line in lines) else lines


def _of_pattern(folder: Path, named: NamePattern) -> list[str]:
    found = matching(folder, named.pattern)
    cameras = cameras_of(found, None) if "{camera}" in named.pattern else {"left": ""}
    frames = {side: _in_order(found, name) for side, name in cameras.items()}
    called = ", ".join(f"{side} {name!r}" for side, name in cameras.items() if name) or "one camera"
    lines = [f"{len(named.paths)} pictures fit --pattern '{named.pattern}': {called}"]
    try:
        runs = runs_of(sample(_pictures(frames["left"])))
    except SceneError as problem:
        return [*lines, f"  {problem}"]
    if "{count}" in named.pattern and (len(runs) > 1 or not runs[0].steps):
        return [
            *lines,
            f"  in no order of one code; where these are several captures, guess one: {frames['left'][0].parent}",
        ]
    names = sorted({values.get("count", "") for values in found.values()}, key=natural)
    lines += [f"  {_told(run, first)}" for run, first in zip(runs, _firsts(runs), strict=True)]
    across = any(run.axis == "x" for run in runs)
    for axis in ("x", "y"):
        command = _command(folder, named.pattern, runs, axis, frames["left"], names)
        if command is not None:
            lines.append(f"  {command.text}")
            lines += [f"    {line}" for line in _agreement(command, frames)]
            if axis == "y" and not across:
                lines.append(
                    "    --axis y is for cameras that stand upright; where they lie on their side, leave it out"
                )
    return lines


def _in_order(found: dict[Path, dict[str, str]], camera: str) -> list[Path]:
    """One camera's frames by count and step, or by their number."""
    counted = any("count" in values for values in found.values())
    if not counted:
        return by_number(found, camera)
    mine = [path for path, values in found.items() if values.get("camera", camera) == camera]
    return sorted(mine, key=lambda path: (natural(found[path]["count"]), natural(found[path]["step"])))


def _pictures(paths: Sequence[Path]) -> Iterator[NDArray]:
    shape = None
    for path in paths:
        frame = read_as_grey(path) if path.suffix.lower() != ".npy" else np.load(path, allow_pickle=False)
        if frame is None or frame.ndim != 2 or shape not in (None, frame.shape):
            raise SceneError(f"{path}: found no picture of one size with the others, expected frames of one camera")
        shape = frame.shape
        yield frame


def _firsts(runs: Sequence[Run]) -> list[int]:
    return [sum(run.frames for run in runs[:place]) for place in range(len(runs))]


def _told(run: Run, first: int) -> str:
    """One run in words."""
    where = f"frame {first + 1}" if run.frames == 1 else f"frames {first + 1} to {first + run.frames}"
    if run.kind in ("white", "black"):
        return f"{where}: all {run.kind}"
    along = f"along {run.axis}"
    if run.kind == "gray":
        return f"{where}: stripes {along}, {'each followed by its inverse' if run.inverse else 'without inverses'}"
    if not run.steps:
        return f"{where}: fringes {along}, in no even steps that could be found"
    each = f"{run.steps[0]} steps" if len(set(run.steps)) == 1 else f"{' and '.join(map(str, run.steps))} steps"
    return f"{where}: fringes {along}, {len(run.steps)} count{'s' * (len(run.steps) > 1)} of {each}"


def _command(
    folder: Path, pattern: str, runs: Sequence[Run], axis: Axis, paths: Sequence[Path], names: Sequence[str]
) -> _Command | None:
    """`scene new` for the fringes and stripes along one axis; None where there are none. `names` are the counts'."""
    fringes = next((k for k, run in enumerate(runs) if (run.kind, run.axis) == ("fringes", axis) and run.steps), None)
    gray = next((k for k, run in enumerate(runs) if (run.kind, run.axis) == ("gray", axis) and _bits(run)), None)
    if fringes is None and gray is None:
        return None
    steps = runs[fringes].steps if fringes is not None else ()
    firsts, kinds = _firsts(runs), [run.kind for run in runs]
    own = [firsts[k] + n for k in (fringes, gray) if k is not None for n in range(runs[k].frames)]
    stripes, inverse = 0, False
    if gray is not None:
        inverse, stripes = runs[gray].inverse, 2 ** _bits(runs[gray])
    references = gray is not None and not inverse and {"white", "black"} <= set(kinds)
    own += [firsts[kinds.index(kind)] for kind in ("white", "black") if references]
    shown = GrayCode(stripes, inverse, references) if stripes else None
    code = _code(axis, steps, shown, [paths[k] for k in own], names)
    counts = code.counts if code else [f"COUNT{k + 1}" for k in range(len(steps))]
    words = [f"flushline scene new {folder} --pattern '{pattern}'"]
    words += ["--axis y"] * (axis == "y") + [" ".join(["--counts", *map(str, counts)])]
    words += [" ".join(["--steps", *map(str, steps[:1] if len(set(steps)) == 1 else steps)])] * bool(steps)
    words += [f"--gray {stripes}"] * bool(stripes) + ["--inverse"] * inverse + ["--references"] * references
    if "{frame}" in pattern:
        used = {fringes: "fringes", gray: "gray"}
        uniform = {k: run.kind for k, run in enumerate(runs) if run.kind in ("white", "black") and run.frames == 1}
        tokens = [used.get(k) or uniform.get(k) or f"skip:{run.frames}" for k, run in enumerate(runs)]
        words.append(f"--sequence {' '.join(tokens)}")
    return _Command(" ".join([*words, "--rig ID"]), code, tuple(own))


def _bits(run: Run) -> int:
    """Bits of Gray code; 0 where so few or so many frames are none."""
    bits = run.frames // (2 if run.inverse else 1)
    return bits if _LEAST_BITS <= bits <= _MOST_BITS else 0


def _code(
    axis: Axis, steps: tuple[int, ...], gray: GrayCode | None, paths: Sequence[Path], names: Sequence[str]
) -> FringeCode | None:
    """The code whose counts the frames bear out: one tried against the stripes, several as they are named; None where
    they are not told.
    """
    if not steps:
        return FringeCode(axis, 4, (), gray)
    tried: list[tuple[int, ...]] = []
    if gray is not None and len(steps) == 1:
        tried = [(gray.stripes // each,) for each in _PER_STRIPE]
    elif gray is None and len(steps) == len(names) > 1 and all(name.isdigit() and int(name) > 0 for name in names):
        said = tuple(int(name) for name in names)
        tried = [said] if said != tuple(range(1, len(names) + 1)) else []  # which merely number the counts
    frames = np.stack(list(_pictures(paths))) if tried else np.empty(0)
    best: tuple[float, FringeCode] | None = None
    for counts in tried:
        try:
            code = FringeCode(axis, steps, counts, gray)
            agreement = guess_code(frames, code, saturation_level(frames[None], frames[None, : steps[0]])).agreement
        except SceneError:
            continue
        if best is None or agreement > best[0] + 0.02:
            best = agreement, code
    return best[1] if best else None


def _agreement(command: _Command, frames: dict[str, list[Path]]) -> list[str]:
    """What the frames say of the code, where it is known; what else is to be said."""
    if command.code is None:
        return [_COUNTS]
    found: dict[str, CodeGuess] = {}
    for side, paths in frames.items():
        try:
            levels = np.stack(list(_pictures([paths[k] for k in command.frames])))
            fringes = levels[None, : command.code.fringe_frames or None]
            found[side] = guess_code(levels, command.code, saturation_level(levels[None], fringes))
        except (SceneError, IndexError) as problem:
            return [f"{side} camera: {problem}"]
    return guess_lines(found)
