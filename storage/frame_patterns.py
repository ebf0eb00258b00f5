"""Patterns of frames' names that nobody has told: which part is the camera, which the count, the step, the number."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from metrology.errors import SceneError
from storage.frame_pages import pages_of
from storage.scene_names import GREY, PICTURES, SHEET, matching, natural

_SIDES = "left|right|左|右"
_AT_END = r"(?<=[a-z])[LR](?![A-Za-z])"  # the camera in names such as grayL_01
_WORD = rf"(?i:{_SIDES})|{_AT_END}|(?:(?!(?i:{_SIDES})|{_AT_END})[A-Za-z])+|(?:(?!左|右)[^A-Za-z\d])+"
_TOKEN = re.compile(rf"\d+|{_WORD}")
_DECIMAL_TOKEN = re.compile(rf"\d+(?:\.\d+)?|{_WORD}")
_NUMBER = re.compile(r"\d+(\.\d+)?")
_PAIRS = (
    ("left", "right"), ("l", "r"), ("lt", "rt"), ("lft", "rgt"), ("master", "slave"), ("a", "b"), ("cama", "camb"),
    ("lcam", "rcam"), ("caml", "camr"), ("imgl", "imgr"), ("iml", "imr"), ("cameral", "camerar"), ("左", "右"),
    ("links", "rechts"), ("gauche", "droite"), ("main", "sub"), ("primary", "secondary"),
    ("top", "bottom"), ("upper", "lower"), ("up", "down"), ("first", "second"),
)  # fmt: skip
_CAMERA_WORDS = ("cam", "camera", "c", "view", "cameras", "frames", "sensor", "dev")
_LEAST_FRAMES = 3
_MOST_JOINED = 8  # kinds of names that one capture has

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
    for path, tokens in _tokens(paths, folder).items():
        groups.setdefault(_shape(tokens), {})[path] = tokens
    found = [_of_group(group) for group in _joined(groups)]
    return sorted(found, key=lambda one: -len(one.paths))


def joint_patterns(folder: Path, patterns: Sequence[NamePattern]) -> list[NamePattern]:
    """Patterns that take several kinds of names together, such as those of fringes, stripes, white and black: one of
    all kinds where there is one, else of those in folders that are called alike.
    """
    if (whole := _joint_pattern(folder, patterns)) is not None:
        return [whole]
    beside: dict[str, list[NamePattern]] = {}
    for one in patterns:
        beside.setdefault(one.pattern.rpartition("/")[0], []).append(one)
    found = (_joint_pattern(folder, kinds) for kinds in beside.values())
    return [one for one in found if one is not None]


def _joint_pattern(folder: Path, patterns: Sequence[NamePattern]) -> NamePattern | None:
    """One pattern for several kinds of names; None where there is none that has as many pictures of either camera."""
    if not 2 <= len(patterns) <= _MOST_JOINED:
        return None
    fields = [re.split(r"(\{\w+\}|\*)", one.pattern) for one in patterns]
    first = _common(fields)
    last = [part[::-1] for part in _common([[part[::-1] for part in parts[::-1]] for parts in fields])][::-1]
    before, behind = "".join(first), "".join(last)
    middles = [one.pattern[len(before) : len(one.pattern) - len(behind)] for one in patterns]
    if not all(middles) or any("{camera}" in middle for middle in middles):
        return None
    field = "{path}" if any("/" in middle for middle in middles) else "{frame}"
    pattern = f"{before}{field}{behind}"
    paths = tuple(path for one in patterns for path in one.paths)
    found = matching(folder, pattern)
    if set(found) != set(paths):
        return None
    if "{camera}" in pattern:
        names = [values["camera"] for values in found.values()]
        if len(set(names)) != 2 or names.count(names[0]) * 2 != len(names):
            return None
    return NamePattern(pattern, paths)


def _common(parts: Sequence[Sequence[str]]) -> list[str]:
    """What lists of words and fields begin with alike, up to a field that is not the camera's; of words also a part."""
    alike: list[str] = []
    for words in zip(*parts, strict=False):
        other_field = any(re.search(r"[{}*]", word) and "camera" not in (word[1:-1], word[-2:0:-1]) for word in words)
        if len(set(words)) > 1 or other_field:
            return alike if any(re.search(r"[{}*]", word) for word in words) else [*alike, _common_start(words)]
        alike.append(words[0])
    return alike


def _common_start(words: Sequence[str]) -> str:
    first, last = min(words), max(words)
    return first[: next((k for k, (a, b) in enumerate(zip(first, last, strict=False)) if a != b), len(first))]


def _is_frame(path: Path, folder: Path) -> bool:
    inside = path.relative_to(folder).parts
    if path.suffix.lower() not in PICTURES or path.name == SHEET or inside[0] == GREY or not path.is_file():
        return False
    if any(part.startswith(".") for part in inside):  # other programs' notes, what a kill left of pages
        return False
    return not pages_of(folder, path).is_dir()


def _tokens(paths: Sequence[Path], folder: Path) -> dict[Path, Tokens]:
    """The words, numbers and what lies between them of each path. Numbers have decimals where some of a kind do and
    others do not: phases 0, 1.5708, 3.1416.
    """
    inside = {path: path.relative_to(folder).as_posix() for path in paths}
    plain = {path: tuple(_TOKEN.findall(text)) for path, text in inside.items()}
    shapes = {_shape(tokens) for tokens in plain.values()}
    for path, text in inside.items():
        decimal = tuple(_DECIMAL_TOKEN.findall(text))
        if decimal != plain[path] and _shape(decimal) in shapes:
            plain[path] = decimal
    return plain


def _shape(tokens: Tokens) -> Tokens:
    return tuple("#" if _NUMBER.fullmatch(token) else token for token in tokens)


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
    words = [place for place in varying if not _NUMBER.fullmatch(columns[place][0])]
    digits = [place for place in varying if _NUMBER.fullmatch(columns[place][0])]
    names = {place: "{camera}" if columns[place] == columns[words[0]] else "*" for place in words}
    if not words and (camera := _numbered_camera(columns, digits)) is not None:
        names[camera] = "{camera}"
        digits = [place for place in digits if columns[place] != columns[camera]]
        names |= {place: "{camera}" for place in varying if columns[place] == columns[camera]}
    sides = [place for place, name in names.items() if name == "{camera}"]
    told = [place for place in digits if sides and _one_to_one(columns[place], columns[sides[0]])]
    names |= dict.fromkeys(told, "*")  # a second word for the camera, as in L/cam0_1.png, L/left1.png
    digits = [place for place in digits if place not in told]
    first = next(iter(group.values()))
    if span := _one_number(columns, digits, sides):
        names |= dict.fromkeys(span, "") | {span[0]: "{frame}"}
    else:
        names |= _fields(columns, digits)
    return NamePattern("".join(names.get(place, token) for place, token in enumerate(first)), tuple(group))


def _fields(columns: Sequence[Tokens], digits: Sequence[int]) -> dict[int, str]:
    """What each number is: the frame's where there is one, else count and step; a number may stand twice, as in
    s1/s1_2.png.
    """
    distinct = list(dict.fromkeys(columns[place] for place in digits))
    fields = ["{frame}"] if len(distinct) == 1 else ["{count}", "{step}"]
    if len(distinct) > 2:
        fields = ["*"] * (len(distinct) - 2) + fields
    return {place: fields[distinct.index(columns[place])] for place in digits}


def _one_number(columns: Sequence[Tokens], digits: Sequence[int], sides: Sequence[int]) -> list[int]:
    """The places of numbers that are one together, as a time of day and its milliseconds, with what lies between; none
    where they are not. The first of them then is another one in almost every picture of a camera, or the last one does
    not run through the same values beside each of the others, as steps do.
    """
    span = list(range(digits[0], digits[-1] + 1)) if len(digits) > 1 else []
    if not span or set(span) & set(sides) or any("/" in columns[place][0] for place in span):
        return []
    frames = len(columns[0]) // (2 if sides else 1)
    different = len(set(columns[span[0]]))
    if frames < 2 * _LEAST_FRAMES or (different <= frames // 2 and _run_through(columns, digits)):
        return []
    return span


def _run_through(columns: Sequence[Tokens], digits: Sequence[int]) -> bool:
    """Whether the last number runs through the same values, or the first of them, beside each of the others."""
    own: dict[Tokens, set[str]] = {}
    for *others, last in zip(*(columns[place] for place in digits), strict=True):
        own.setdefault(tuple(others), set()).add(last)
    return all(values <= max(own.values(), key=len) for values in own.values())


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
