"""Frames of other programs by their names: which camera, count, step or bit each of them is."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from metrology.errors import SceneError
from metrology.fringe import FringeCode
from storage.frames import can_be_turned, read_as_grey, read_header, write_frame
from storage.scene_models import Camera

FIELDS = ("camera", "pose", "exposure", "count", "step", "frame", "path", "bit", "inverse")
GREY = "grey"
SHEET = "contact-sheet.png"
"""The picture that `scene new` draws beside the frames."""
PICTURES = (".png", ".bmp", ".tif", ".tiff", ".jpg", ".jpeg", ".npy", ".pgm")
_GREY_ALONE = (".pgm",)
_LEFT = ("left", "l", "cam0", "camera0", "cam_0", "cam1", "camera1", "0", "1", "a", "左", "gauche", "top", "upper",
         "up", "main", "primary", "master")  # fmt: skip

Values = dict[str, str]


def natural(text: str) -> tuple[tuple[int, str], ...]:
    """A key that sorts 2 before 10."""
    return tuple((int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", text))


def matching(folder: Path, pattern: str) -> dict[Path, Values]:
    """Files of a folder whose path fits a pattern such as ``{camera}/f{count}_{step}.png``, with what it says."""
    unknown = sorted(set(re.findall(r"\{(\w*)\}", pattern)) - set(FIELDS))
    if unknown:
        raise SceneError(f"pattern {pattern!r}: found {{{unknown[0]}}}, expected {', '.join(FIELDS)}")
    parts = [part for part in re.split(r"(\{\w+\}|\*)", pattern.replace("\\", "/")) if part]
    seen: set[str] = set()
    expression = ""
    for part, before in zip(parts, ["", *parts], strict=False):
        name = part[1:-1] if part.startswith("{") else ""
        if name in seen:
            expression += f"(?P={name})"
        elif name:  # right behind another field a number begins where the digits do
            any_text = ".+?" if name == "path" else "[^/]+?"
            text = r"\d+" if before.startswith("{") else any_text
            expression += ("" if before[:1] not in ("{", "*") else r"(?<!\d)") + f"(?P<{name}>{text})"
            seen.add(name)
        else:
            expression += "[^/]*" if part == "*" else re.escape(part)
    wanted = re.compile(expression)
    found, other = {}, []
    for path in sorted(folder.rglob("*")):
        relative = path.relative_to(folder).as_posix()
        if path.name == SHEET:
            continue
        if not relative.startswith(f"{GREY}/") and path.is_file() and (fits := wanted.fullmatch(relative)):
            found[path] = fits.groupdict()
        elif path.suffix.lower() in PICTURES:
            other.append(relative)
    if not found:
        there = f"; there are {len(other)} others, such as {other[0]}" if other else ""
        raise SceneError(f"{folder}: found no file that fits {pattern!r}, expected the frames{there}")
    return found


def without_others(found: Mapping[Path, Values]) -> tuple[dict[Path, Values], list[str]]:
    """The frames without pictures that one camera alone has, and whose name has no number (texture.png); and notes."""
    field = next((name for name in ("frame", "path") if any(name in values for values in found.values())), "")
    named: dict[str, set[str]] = {}
    for values in found.values():
        named.setdefault(values.get("camera", ""), set()).add(values.get(field, ""))
    if len(named) != 2:
        return dict(found), []
    first, second = named.values()
    others = (
        {name for name in first ^ second if not re.search(r"\d", name)} if first < second or second < first else set()
    )
    aside = [path for path, values in found.items() if values.get(field) in others]
    notes = [f"note: {path.name} is left aside: one camera alone has a picture of this name" for path in aside]
    return {path: values for path, values in found.items() if path not in aside}, notes


def cameras_of(found: Mapping[Path, Values], left: str | None) -> dict[Camera, str]:
    """Which value of {camera} is left and which right."""
    names = sorted({values["camera"] for values in found.values() if "camera" in values}, key=natural)
    if len(names) != 2:
        raise SceneError(
            f"found {len(names)} cameras ({', '.join(names[:5])}), expected two by {{camera}} in the pattern"
        )
    if left is not None and left not in names:
        raise SceneError(f"--left: found {left!r}, expected one of {', '.join(names)}")
    first = left or next((name for name in names if name.lower() in _LEFT), names[0])
    return {"left": first, "right": next(name for name in names if name != first)}


def exposure_names(found: Mapping[Path, Values]) -> list[str]:
    """What {exposure} is, in natural order; one empty name where there is but one exposure."""
    return sorted({values.get("exposure", "") for values in found.values()}, key=natural)


def count_names(found: Mapping[Path, Values], code: FringeCode, labels: Sequence[str]) -> tuple[list[str], bool]:
    """What {count} is of each count, in the code's order; and whether `labels` or the numbers themselves told it.

    Parameters
    ----------
    found : mapping
        Paths, and what their names say.
    labels : sequence of str
        What the counts are said to be called: any names, or numbers that names with leading zeros fit too.
    """
    names = sorted({values["count"] for values in found.values() if "count" in values}, key=natural)
    plain = {name.lstrip("0") or "0": name for name in names}
    if labels and set(labels) <= set(names):
        return list(labels), True
    for told in (list(labels), [str(count) for count in code.counts]):
        if told and set(told) == set(plain):
            return [plain[one] for one in told], True
    return names, False


def by_count_and_step(found: Mapping[Path, Values], camera: str, code: FringeCode, labels: Sequence[str]) -> list[Path]:
    """A camera's fringe frames, count-major; counts in the order of the code, told by number or by `labels`."""
    mine = {path: values for path, values in found.items() if values.get("camera", camera) == camera}
    ordered, _ = count_names(mine, code, labels) if len(code.counts) > 1 else ([""], True)
    if len(ordered) != len(code.counts):
        raise SceneError(
            f"camera {camera!r}: found the counts {', '.join(ordered)}, expected {len(code.counts)}: "
            f"{', '.join(map(str, labels or code.counts))} (--labels: what they are called, in the order of --counts)"
        )
    listed = []
    for name, steps in zip(ordered, code.step_counts, strict=True):
        own = [path for path, values in mine.items() if name in ("", values.get("count"))]
        own.sort(key=lambda path: natural(mine[path].get("step", path.name)))
        if len(own) != steps:
            called = ", ".join(mine[path].get("step", path.name) for path in own[:4])
            raise SceneError(
                f"{f'camera {camera!r}' if camera else 'one camera (no {camera} in the pattern)'}, count {name}: "
                f"found {len(own)} steps ({called}{', …' if len(own) > 4 else ''}), expected {steps}"
            )
        listed += own
    return listed


def by_number(found: Mapping[Path, Values], camera: str) -> list[Path]:
    """A camera's frames in the order of their numbers."""
    mine = [path for path, values in found.items() if values.get("camera", camera) == camera]
    return sorted(mine, key=lambda path: natural(found[path].get("frame", found[path].get("path", path.as_posix()))))


def shared_sequence(found: Mapping[Path, Values], way: str) -> dict[Path, Values]:
    """Frames of both cameras that one number runs through, with the camera of each: first or second.

    Parameters
    ----------
    way : str
        "turns": the cameras come by turns; "halves": all of one, then all of the other.
    """
    ordered = by_number(found, "")
    if len(ordered) % 2 or len(exposure_names(found)) > 1 or any("camera" in values for values in found.values()):
        raise SceneError(
            f"--cameras {way}: found {len(ordered)} frames, expected as many of either camera, of one exposure, by a "
            "pattern without {camera}"
        )
    first = set(ordered[::2] if way == "turns" else ordered[: len(ordered) // 2])
    return {path: values | {"camera": "first" if path in first else "second"} for path, values in found.items()}


def runs_through(pattern: str) -> bool:
    """Whether a pattern numbers a camera's frames from first to last: {frame}, or {path}, which may have folders."""
    return "{frame}" in pattern or "{path}" in pattern


def in_sequence(paths: Sequence[Path], code: FringeCode, sequence: Sequence[str]) -> list[Path]:
    """Frames that run through in one number, in Flushline's order: fringes, Gray code, white and black.

    Parameters
    ----------
    paths : sequence of Path
        In the order in which they were shown.
    sequence : sequence of str
        What was shown: fringes (count by count), fringes-by-step, gray, inverse (those of all bits, where they do not
        come each beside its bit), white, black, skip or skip:N.
    """
    gray = code.gray
    bits = gray.bits if gray else 0
    sizes = {
        "fringes": code.fringe_frames,
        "fringes-by-step": code.fringe_frames,
        "gray": bits if "inverse" in sequence else gray.stripe_frames if gray else 0,
        "inverse": bits,
        "white": 1,
        "black": 1,
        "skip": 1,
    }
    blocks: dict[str, list[Path]] = {}
    at = 0
    for token in sequence:
        name, _, number = token.partition(":")
        if name not in sizes or (number and not number.isdigit()):
            raise SceneError(f"--sequence: found {token!r}, expected {', '.join(sizes)} or skip:N")
        size = int(number) if number else sizes[name]
        blocks.setdefault(name, []).extend(paths[at : at + size])
        at += size
    if at != len(paths):
        more = "where white, black and others (skip:N) stand" if len(paths) > at else "what is not there"
        raise SceneError(
            f"found {len(paths)} frames, from {paths[0].name} to {paths[-1].name}, expected {at} for the sequence "
            f"{' '.join(sequence)}: --sequence says {more}"
        )
    stripes, inverses = blocks.get("gray", []), blocks.get("inverse", [])
    if inverses:
        stripes = [path for pair in zip(stripes, inverses, strict=False) for path in pair]
    listed = blocks.get("fringes", []) + _count_by_count(blocks.get("fringes-by-step", []), code) + stripes
    if gray and gray.references:
        listed += blocks.get("white", []) + blocks.get("black", [])
    if len(listed) != code.frames:
        raise SceneError(f"found {len(listed)} frames in {' '.join(sequence)}, expected {code.frames} for this code")
    return listed


def _count_by_count(paths: Sequence[Path], code: FringeCode) -> list[Path]:
    """Frames that run through all counts at each step, as those that run through all steps of each count."""
    if paths and len(set(code.step_counts)) > 1:
        raise SceneError(f"--sequence fringes-by-step: found steps {code.steps}, expected as many of each count")
    counts = len(code.counts)
    return [path for k in range(counts) for path in paths[k::counts]]


def as_grey(path: Path, folder: Path) -> tuple[Path, str | None]:
    """A frame that scenes can have: the file itself, or a grey PNG of it in `folder`/grey, with a note."""
    try:
        read_header(path, SceneError)
        return path, None
    except SceneError as problem:
        frame = read_as_grey(path, SceneError) if can_be_turned(path) else None
        if frame is None:
            raise problem from None
    target = (folder / GREY / path.relative_to(folder)).with_suffix(".png")
    target.parent.mkdir(parents=True, exist_ok=True)
    write_frame(target, frame)
    if path.suffix.lower() in (".jpg", ".jpeg"):
        return target, "JPEG has lost what the eye does not see, and phases do"
    grey = path.suffix.lower() in _GREY_ALONE
    return target, f"{path.suffix} was written as PNG" if grey else "colour was turned to grey"
