"""Patterns of frames' names that nobody has told: which part is the camera, which the count, the step, the number."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from metrology.errors import SceneError
from storage.scene_names import GREY, PICTURES, SHEET, natural

_TOKEN = re.compile(r"\d+|(?i:left|right)|(?:(?!(?i:left|right))[A-Za-z])+|[^A-Za-z\d]+")
_PAIRS = (
    ("left", "right"), ("l", "r"), ("lt", "rt"), ("lft", "rgt"), ("master", "slave"), ("a", "b"), ("cama", "camb"),
    ("lcam", "rcam"), ("caml", "camr"), ("imgl", "imgr"), ("iml", "imr"), ("cameral", "camerar"),
)  # fmt: skip
_CAMERA_WORDS = ("cam", "camera", "c", "view", "cameras", "frames", "sensor", "dev")
_LEAST_FRAMES = 3

Tokens = tuple[str, ...]


@dataclass(frozen=True)
class NamePattern:
    """Names that differ in certain parts alone."""

    pattern: str
    """As `scene new --pattern` takes it."""
    paths: tuple[Path, ...]


def name_patterns(folder: Path) -> list[NamePattern]:
    """Patterns of the pictures in a folder, those of most pictures first.

    Raises
    ------
    SceneError
        Where there are no pictures.
    """
    paths = [
        path for path in sorted(folder.rglob("*"), key=lambda one: natural(one.as_posix())) if _is_frame(path, folder)
    ]
    if not paths:
        raise SceneError(f"{folder}: found no pictures, expected frames as {', '.join(PICTURES)}")
    groups: dict[Tokens, dict[Path, Tokens]] = {}
    for path in paths:
        tokens = tuple(_TOKEN.findall(path.relative_to(folder).as_posix()))
        groups.setdefault(tuple("#" if token.isdigit() else token for token in tokens), {})[path] = tokens
    found = [_of_group(group) for group in _joined(groups)]
    return sorted(found, key=lambda one: -len(one.paths))


def _is_frame(path: Path, folder: Path) -> bool:
    inside = path.relative_to(folder).parts
    return path.suffix.lower() in PICTURES and path.name != SHEET and inside[0] != GREY and path.is_file()


def _joined(groups: Mapping[Tokens, dict[Path, Tokens]]) -> list[dict[Path, Tokens]]:
    """Groups whose shapes differ in words for left and right alone, as one."""
    joined: dict[Tokens, dict[Path, Tokens]] = {}
    for shape, members in groups.items():
        neutral = tuple("\0" if any(token.lower() in pair for pair in _PAIRS) else token for token in shape)
        twins = [other for other in groups if len(other) == len(shape) and other != shape and _are_twins(shape, other)]
        joined.setdefault(neutral if twins else shape, {}).update(members)
    return list(joined.values())


def _are_twins(a: Tokens, b: Tokens) -> bool:
    """Whether two shapes are alike but for words that are a pair of cameras' names."""
    differing = [(x.lower(), y.lower()) for x, y in zip(a, b, strict=True) if x != y]
    return bool(differing) and all(pair in _PAIRS or pair[::-1] in _PAIRS for pair in differing)


def _of_group(group: dict[Path, Tokens]) -> NamePattern:
    columns = list(zip(*group.values(), strict=True))
    varying = [place for place, column in enumerate(columns) if len(set(column)) > 1]
    words = [place for place in varying if not columns[place][0].isdigit()]
    digits = [place for place in varying if columns[place][0].isdigit()]
    names = dict.fromkeys(words, "{camera}")
    if not words and (camera := _numbered_camera(columns, digits)) is not None:
        names[camera] = "{camera}"
        digits = [place for place in digits if columns[place] != columns[camera]]
        names |= {place: "{camera}" for place in varying if columns[place] == columns[camera]}
    sides = [place for place, name in names.items() if name == "{camera}"]
    told = [place for place in digits if sides and _one_to_one(columns[place], columns[sides[0]])]
    names |= dict.fromkeys(told, "*")  # a second word for the camera, as in L/cam0_1.png and R/cam1_1.png
    digits = [place for place in digits if place not in told]
    distinct = list(dict.fromkeys(columns[place] for place in digits))  # a number may stand twice, as in s1/s1_2.png
    fields = ["{frame}"] if len(distinct) == 1 else ["{count}", "{step}"]
    if len(distinct) > 2:
        fields = ["*"] * (len(distinct) - 2) + fields
    for place in digits:
        names[place] = fields[distinct.index(columns[place])]
    first = next(iter(group.values()))
    return NamePattern("".join(names.get(place, token) for place, token in enumerate(first)), tuple(group))


def _one_to_one(a: Tokens, b: Tokens) -> bool:
    return len(set(zip(a, b, strict=True))) == len(set(a)) == len(set(b))


def _numbered_camera(columns: Sequence[Tokens], digits: Sequence[int]) -> int | None:
    """The number that has two values, each of half the pictures; one behind a word for cameras rather than another."""
    halves = [
        place
        for place in digits
        if len(set(columns[place])) == 2 and 2 * columns[place].count(columns[place][0]) == len(columns[place])
    ]
    if len(columns[0]) < 2 * _LEAST_FRAMES:
        return None
    named = [place for place in halves if _word_before(columns, place) in _CAMERA_WORDS]
    plain = [place for place in halves if set(columns[place]) in ({"0", "1"}, {"1", "2"})]
    return next(iter(named or plain), None)


def _word_before(columns: Sequence[Tokens], place: int) -> str:
    words = [columns[at][0] for at in range(max(0, place - 2), place)]
    return next((word.lower() for word in reversed(words) if word.isalpha()), "")
