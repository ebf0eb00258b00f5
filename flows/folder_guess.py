"""What a folder of frames that nobody has described seems to hold, and the command that makes a scene of it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from shlex import quote

import numpy as np
from numpy.typing import NDArray

from flows.new_scene import guess_lines
from metrology.code_guess import CodeGuess, guess_code
from metrology.errors import SceneError
from metrology.frame_kinds import FrameSample, Run, runs_of, sample
from metrology.fringe import Axis, FringeCode, GrayCode
from metrology.saturation import code_saturation
from storage.frame_pages import write_pages
from storage.frame_patterns import NamePattern, joint_patterns, name_patterns
from storage.frames import can_be_turned, read_as_grey, read_frame, read_header
from storage.scene_names import (
    Values,
    by_number,
    cameras_of,
    matching,
    natural,
    runs_through,
    shared_sequence,
    without_others,
)

_PER_STRIPE = (1, 2, 4)  # stripes per fringe that codes have
_MOST_PATTERNS = 4
_LEAST_FRAMES = 3
_LEAST_BITS, _MOST_BITS = 3, 14
_MOST_KEPT_BYTES = 2**30
_ONE_VIEW = 0.8  # correlation of what changes from frame to frame
_COUNTS = (
    "How many fringes the projector showed across, the frames do not tell. Periods in projector pixels do as well: "
    "--periods in place of --counts"
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
    open: str = ""
    """Which frames each number that is left open is of."""


@dataclass(frozen=True)
class _Folder:
    """A folder of frames. Each is read once, as many as fit into a part of the memory, and each code tried once."""

    path: Path
    kept: dict[Path, NDArray] = field(default_factory=dict)
    told: dict[tuple[tuple[Path, ...], FringeCode], CodeGuess | SceneError] = field(default_factory=dict)

    def frames(self, paths: Sequence[Path]) -> Iterator[NDArray]:
        """Frames of one camera, in grey."""
        shape = None
        for path in paths:
            frame = self.kept.get(path)
            if frame is None:
                frame = read_as_grey(path, SceneError) if can_be_turned(path) else _frame(path)
            if frame is None or shape not in (None, frame.shape):
                raise SceneError(f"{path}: found no picture of one size with the others, expected frames of one camera")
            if (len(self.kept) + 1) * frame.nbytes < _MOST_KEPT_BYTES:
                self.kept[path] = frame
            shape = frame.shape
            yield frame

    def guess(self, paths: Sequence[Path], code: FringeCode) -> CodeGuess:
        """What frames say of a code; SceneError where they contradict it."""
        key = (tuple(paths), code)
        if key not in self.told:
            try:
                levels = np.stack(list(self.frames(paths)))
                self.told[key] = guess_code(levels, code, code_saturation(levels[None], code))
            except SceneError as problem:
                self.told[key] = problem
        found = self.told[key]
        if isinstance(found, SceneError):
            raise SceneError(str(found)) from None
        return found


def guess_folder(folder: Path) -> list[str]:
    """Lines that say which pictures there are, what they show, and what to call.

    Frames that lie in one file together are written out.

    Raises
    ------
    SceneError
        Where there are no pictures, or none that show a pattern.
    """
    lines = write_pages(folder)
    try:
        named = name_patterns(folder)
    except SceneError as problem:
        raise SceneError(". ".join([str(problem), *lines])) from None
    read = _Folder(folder)
    patterns = [_looked(read, one) for one in _without_parts(folder, named) if len(one.paths) >= _LEAST_FRAMES]
    for joint in joint_patterns(folder, named):
        parts = [one for one in patterns if set(one.named.paths) <= set(joint.paths)]
        together = _look_at(read, joint) if len(joint.paths) >= _LEAST_FRAMES else None
        if together and together.sound and (together.known or not any(one.known for one in parts)):
            patterns = [together, *(one for one in patterns if one not in parts)]
    shown = sorted(patterns[:_MOST_PATTERNS], key=lambda one: not one.across)
    if not shown:
        none = f"{folder}: found no three pictures whose names differ in numbers alone, expected frames"
        raise SceneError(". ".join([none, *lines]))
    for one in shown:
        lines += one.lines
    if more := patterns[_MOST_PATTERNS:]:
        lines.append(f"and {len(more)} more kinds of names, such as {more[0].named.paths[0].name}")
    return [*lines, _ID] if any("--rig ID" in line for line in lines) else lines


def _without_parts(folder: Path, named: Sequence[NamePattern]) -> list[NamePattern]:
    """Patterns whose names no other one has among its own."""
    having = {one.pattern: set(matching(folder, one.pattern)) for one in named}
    return [one for one in named if not any(set(one.paths) < having[other.pattern] for other in named if other != one)]


@dataclass(frozen=True)
class _Look:
    """What was seen of the pictures of one pattern."""

    named: NamePattern
    lines: tuple[str, ...]
    runs: tuple[Run, ...] = ()
    known: bool = False
    """Whether all of its codes are told, fringes' numbers too."""

    @property
    def across(self) -> bool:
        """Whether patterns along x are among them."""
        return any(run.axis == "x" for run in self.runs)

    @property
    def sound(self) -> bool:
        """Whether these are the frames of one code along each axis."""
        shown = [(run.kind, run.axis) for run in self.runs if run.axis]
        return 0 < len(shown) == len(set(shown)) and all(run.steps for run in self.runs if run.kind == "fringes")


def _looked(folder: _Folder, named: NamePattern) -> _Look:
    """What one camera shows, or both where one number runs through the frames of both."""
    look = _look_at(folder, named)
    found = matching(folder.path, named.pattern)
    if (look.known and look.sound) or "{camera}" in named.pattern or not runs_through(named.pattern) or len(found) % 2:
        return look
    shared = [_look_at(folder, named, way) for way in ("turns", "halves") if _two_views(folder, found, way)]
    fitting = [both for both in shared if both.sound and (both.known or not look.sound)]
    return max(fitting, key=lambda both: both.known, default=look)


def _two_views(folder: _Folder, found: Mapping[Path, Values], way: str) -> bool:
    """Whether frames that are shared out among two cameras show the same code, and from two places."""
    told = shared_sequence(found, way)
    try:
        first, second = (sample(folder.frames(by_number(told, name))) for name in ("first", "second"))
        return not _alike(first, second) and runs_of(first) == runs_of(second)
    except SceneError:
        return False


def _alike(first: FrameSample, second: FrameSample) -> bool:
    """Whether two series show one pattern at the same pixels: one camera took both."""
    swings = [(one.here - one.here.mean(0)).ravel() for one in (first, second)]
    return first.here.shape == second.here.shape and float(np.corrcoef(*swings)[0, 1]) > _ONE_VIEW


def _look_at(folder: _Folder, named: NamePattern, shared: str = "") -> _Look:
    """`shared`: the way in which both cameras' frames share one number, where they do."""
    found = matching(folder.path, named.pattern)
    if shared:
        found = shared_sequence(found, shared)
    found, aside = without_others(found)
    cameras = cameras_of(found, None) if shared or "{camera}" in named.pattern else {"left": ""}
    frames = {side: _in_order(found, name) for side, name in cameras.items()}
    called = ", ".join(f"{side} {name!r}" for side, name in cameras.items() if name) or "one camera"
    lines = [f"{len(found)} pictures fit --pattern '{named.pattern}': {called}", *(f"  {note}" for note in aside)]
    if len({len(paths) for paths in frames.values()}) > 1:
        counted = ", ".join(f"{len(paths)} of the {side} camera" for side, paths in frames.items())
        return _Look(named, (*lines, f"  found {counted}, expected as many of either"))
    try:
        runs = runs_of(sample(folder.frames(frames["left"])))
    except SceneError as problem:
        return _Look(named, (*lines, f"  {problem}"))
    names = sorted({values.get("count", "") for values in found.values()}, key=natural)
    if "{count}" in named.pattern and (len(runs) > 1 or len(runs[0].steps) != len(names)):
        if len(runs) == 1 and runs[0].by_step:  # what stands first in the names is the step
            turned = named.pattern.replace("{count}", "{}").replace("{step}", "{count}").replace("{}", "{step}")
            return _look_at(folder, NamePattern(turned, named.paths))
        return _Look(named, (*lines, f"  {_several(folder.path, named)}"))
    lines += [f"  {_told(run, first)}" for run, first in zip(runs, _firsts(runs), strict=True)]
    look = _Look(named, (), tuple(runs))
    known = []
    for axis in ("x", "y"):
        command = _command(folder, named.pattern, runs, axis, frames["left"], names, shared)
        if command is not None:
            try:
                said = _agreement(folder, command, frames)
            except SceneError as problem:
                known.append(False)
                lines.append(f"  along {axis}: {problem}")
                continue
            known.append(command.code is not None)
            lines += [f"  {command.text}", *(f"    {line}" for line in said)]
            if axis == "y" and not look.across:
                lines.append(
                    "    --axis y is for cameras that stand upright; where they lie on their side, leave it out"
                )
    return replace(look, lines=tuple(lines), known=bool(known) and all(known))


def _several(folder: Path, named: NamePattern) -> str:
    """What is to be said of pictures that are no one code by their two numbers."""
    parts = named.pattern.split("/")
    depth = next(k for k, part in enumerate(parts) if "{count}" in part) + 1
    if depth == len(parts):
        return "in no order of one code: the two numbers in the names are not the counts and their steps"
    one = folder.joinpath(*named.paths[0].relative_to(folder).parts[:depth])
    return f"in no order of one code; where these are several captures, guess one: flushline scene guess {one}"


def _in_order(found: dict[Path, dict[str, str]], camera: str) -> list[Path]:
    """One camera's frames by count and step, or by their number."""
    counted = any("count" in values for values in found.values())
    if not counted:
        return by_number(found, camera)
    mine = [path for path, values in found.items() if values.get("camera", camera) == camera]
    return sorted(mine, key=lambda path: (natural(found[path]["count"]), natural(found[path]["step"])))


def _frame(path: Path) -> NDArray:
    return read_frame(path, read_header(path, SceneError), SceneError)


def _firsts(runs: Sequence[Run]) -> list[int]:
    return [sum(run.frames for run in runs[:place]) for place in range(len(runs))]


def _told(run: Run, first: int) -> str:
    """One run in words."""
    where = f"frame {first + 1}" if run.frames == 1 else f"frames {first + 1} to {first + run.frames}"
    if run.kind in ("white", "black"):
        return f"{where}: all {run.kind}"
    along = f"along {run.axis}"
    if run.kind == "gray":
        beside = "then the inverses of all" if run.apart else "each followed by its inverse"
        return f"{where}: stripes {along}, {beside if run.inverse else 'without inverses'}"
    if not run.steps:
        return f"{where}: fringes {along}, in no even steps that could be found"
    each = f"{run.steps[0]} steps" if len(set(run.steps)) == 1 else f"{' and '.join(map(str, run.steps))} steps"
    turn = ", all counts of a step one after the other" if run.by_step else ""
    return f"{where}: fringes {along}, {len(run.steps)} count{'s' * (len(run.steps) > 1)} of {each}{turn}"


def _command(
    folder: _Folder,
    pattern: str,
    runs: Sequence[Run],
    axis: Axis,
    paths: Sequence[Path],
    names: Sequence[str],
    shared: str = "",
) -> _Command | None:
    """`scene new` for the fringes and stripes along one axis; None where there are none. `names` are the counts'."""
    fringes = next((k for k, run in enumerate(runs) if (run.kind, run.axis) == ("fringes", axis) and run.steps), None)
    gray = next((k for k, run in enumerate(runs) if (run.kind, run.axis) == ("gray", axis) and _bits(run)), None)
    if fringes is None and gray is None:
        return None
    steps = runs[fringes].steps if fringes is not None else ()
    firsts, kinds = _firsts(runs), [run.kind for run in runs]
    own = [firsts[k] + n for k in (fringes, gray) if k is not None for n in _own_order(runs[k])]
    stripes, inverse = 0, False
    if gray is not None:
        inverse, stripes = runs[gray].inverse, 2 ** _bits(runs[gray])
    references = gray is not None and not inverse and {"white", "black"} <= set(kinds)
    own += [firsts[kinds.index(kind)] for kind in ("white", "black") if references]
    shown = GrayCode(stripes, inverse, references) if stripes else None
    code = _code(folder, axis, steps, shown, [paths[k] for k in own], names)
    counts = code.counts if code else [f"COUNT{k + 1}" for k in range(len(steps))]
    words = [f"flushline scene new {quote(str(folder.path))} --pattern '{pattern}'"]
    words += [f"--cameras {shared}"] * bool(shared) + ["--axis y"] * (axis == "y")
    if code and code.size_px:
        words += ["--periods " + " ".join(str(code.size_px // count) for count in code.counts)]
    else:
        words += [" ".join(["--counts", *map(str, counts)])]
    words += [" ".join(["--steps", *map(str, steps[:1] if len(set(steps)) == 1 else steps)])] * bool(steps)
    words += [f"--gray {stripes}"] * bool(stripes) + ["--inverse"] * inverse + ["--references"] * references
    if runs_through(pattern):
        used = {fringes: "fringes", gray: "gray"}
        if fringes is not None and runs[fringes].by_step:
            used[fringes] = "fringes-by-step"
        if gray is not None and runs[gray].apart:
            used[gray] = "gray inverse"
        uniform = {k: run.kind for k, run in enumerate(runs) if run.kind in ("white", "black") and run.frames == 1}
        tokens = [used.get(k) or uniform.get(k) or "" for k in range(len(runs))]
        words.append(f"--sequence {' '.join(_skipping(tokens, runs))}")
    ends = np.cumsum([0, *steps])
    inside = [paths[k].relative_to(folder.path).with_suffix("").as_posix() for k in own]
    shown_by = [(inside[ends[k]], inside[ends[k + 1] - 1]) for k in range(len(steps))]
    left_open = "; ".join(f"COUNT{k + 1}: {first} to {last}" for k, (first, last) in enumerate(shown_by))
    return _Command(" ".join([*words, "--rig ID"]), code, tuple(own), f"{left_open}. ")


def _skipping(tokens: Sequence[str], runs: Sequence[Run]) -> Iterator[str]:
    """What the frames run through; those that have no name are passed over together."""
    for skipped, group in groupby(zip(tokens, runs, strict=True), key=lambda each: not each[0]):
        if skipped:
            yield f"skip:{sum(run.frames for _, run in group)}"
        else:
            yield from (token for token, _ in group)


def _own_order(run: Run) -> list[int]:
    """A run's frames in Flushline's order."""
    numbers, half = list(range(run.frames)), run.frames // 2
    if run.by_step:
        return [n for k in range(len(run.steps)) for n in numbers[k :: len(run.steps)]]
    return [n for pair in zip(numbers[:half], numbers[half:], strict=True) for n in pair] if run.apart else numbers


def _bits(run: Run) -> int:
    """Bits of Gray code; 0 where so few or so many frames are none."""
    bits = run.frames // (2 if run.inverse else 1)
    return bits if _LEAST_BITS <= bits <= _MOST_BITS else 0


def _code(
    folder: _Folder,
    axis: Axis,
    steps: tuple[int, ...],
    gray: GrayCode | None,
    paths: Sequence[Path],
    names: Sequence[str],
) -> FringeCode | None:
    """The code whose counts the frames bear out: one tried against the stripes, several as they are named; None where
    they are not told.
    """
    if not steps:
        return FringeCode(axis, 4, (), gray)
    tried: list[tuple[tuple[int, ...], int | None]] = []
    if gray is not None and len(steps) == 1:
        tried = [((gray.stripes // each,), None) for each in _PER_STRIPE]
    elif gray is None and len(steps) == len(names) > 1 and all(name.isdigit() and int(name) > 0 for name in names):
        said = tuple(int(name) for name in names)
        size = math.lcm(*said)
        if said != tuple(range(1, len(names) + 1)):  # which merely number the counts
            tried = [(said, None), (tuple(size // period for period in said), size)]
    best: tuple[float, FringeCode] | None = None
    for told, size_px in tried:
        try:
            code = FringeCode(axis, steps, told, gray, size_px=size_px)
            agreement = folder.guess(paths, code).agreement
        except SceneError:
            continue
        if best is None or agreement > best[0] + 0.02:
            best = agreement, code
    return best[1] if best else None


def _agreement(folder: _Folder, command: _Command, frames: dict[str, list[Path]]) -> list[str]:
    """What the frames say of the code, where it is known; SceneError where they contradict it."""
    if command.code is None:
        return [command.open + _COUNTS]
    found: dict[str, CodeGuess] = {}
    for side, paths in frames.items():
        try:
            found[side] = folder.guess([paths[k] for k in command.frames], command.code)
        except (SceneError, IndexError) as problem:
            raise SceneError(f"{side} camera: {problem}") from None
    return guess_lines(found)
