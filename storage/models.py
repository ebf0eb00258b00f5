"""Checking documents against models: identifiers, times and paths, and complaints in one line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    Strict,
    StringConstraints,
    ValidationError,
)

from metrology.errors import FlushlineError
from metrology.moments import in_utc, moment_of
from storage.documents import ErrorType, brief, closest, shown

MAX_IDENTIFIER_LENGTH = 64
MAX_PATH_LENGTH = 1024
# No separator, no leading dot: an identifier becomes a folder name and part of a scene's name.
IDENTIFIER_PATTERN = r"[A-Za-z0-9_-][A-Za-z0-9._-]*"

Model = TypeVar("Model", bound=BaseModel)


class StrictModel(BaseModel):
    """Base of what Flushline writes itself: unknown keys are refused, numbers must be finite numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


Identifier = Annotated[
    str,
    Strict(),
    StringConstraints(pattern=f"^{IDENTIFIER_PATTERN}$", min_length=1, max_length=MAX_IDENTIFIER_LENGTH),
]
"""Aircraft serial, panel, station, rig: letters, digits, ``.``, ``_``, ``-``; no leading dot."""


def _moment(value: object) -> datetime:
    if isinstance(value, str):
        return moment_of(value)
    if isinstance(value, datetime):  # TOML has times of its own
        return in_utc(value)
    # A number, which pydantic would take for seconds since 1970.
    raise ValueError("an ISO 8601 time with its zone as text, such as 2026-11-20T08:15:00Z")


UtcTime = Annotated[datetime, BeforeValidator(_moment)]
"""A moment, given with its zone and kept in UTC: the one way in which documents give times."""

WholeNumber = Annotated[int, Strict()]

PositiveNumber = Annotated[float, Strict(), Field(gt=0)]


def _one_line(text: str) -> str:
    # Line breaks and control characters would reach terminals, tables and reports; lone surrogates no file at all.
    if not text.isprintable():
        raise ValueError("one line of printable text")
    return text


Line = Annotated[str, Strict(), AfterValidator(_one_line)]
"""Free text for people."""


def leads_inside(path: str) -> bool:
    """Whether a relative path stays in the folder that it starts from."""
    pure = PurePosixPath(path)
    return not (not path or "\0" in path or "\\" in path or pure.is_absolute() or ".." in pure.parts)


def _inside(path: str) -> str:
    # Programs on Windows write left\f00.png for left/f00.png.
    parts = path.replace("\\", "/").split("/")
    named = [part for part in parts if part not in ("", ".")]
    absolute = parts[0] == "" or parts[0].endswith(":")
    if len(path) > MAX_PATH_LENGTH or not path.isprintable() or not named or absolute or ".." in named:
        raise ValueError(f"found path {shown(path)}, expected one inside the folder, relative to it")
    return "/".join(named)


InnerPath = Annotated[str, Strict(), AfterValidator(_inside)]
"""A file of the folder that the manifest lies in, with ``/`` between folders.

Links there are its owner's, and followed."""


def _plain_name(name: str) -> str:
    if _inside(name) != PurePosixPath(name).name or name.startswith("."):
        raise ValueError(f"found name {name!r}, expected that of a file in the folder itself")
    return name


FileName = Annotated[str, Strict(), AfterValidator(_plain_name)]
"""A file or folder right in a folder: no separator, no leading dot."""


def validate(model: type[Model], document: Mapping[str, Any], path: Path, error: ErrorType) -> Model:
    """`document` as `model`, or one line naming the file, the key, what was found and what was expected."""
    try:
        return model.model_validate(document)
    except ValidationError as problem:
        raise error(f"{path}: {first_problem(problem, _keys_of(model))}") from None
    except FlushlineError as problem:
        raise error(f"{path}: {problem}") from None


def first_problem(problem: ValidationError, keys_at: Callable[[tuple[int | str, ...]], list[str]]) -> str:
    """The first complaint of pydantic in Flushline's words; how many follow is said in brackets."""
    # A key that nobody knows is more telling than the one that is missing because of it.
    first = min(problem.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
    place = first["loc"]
    more = problem.error_count() - 1
    tail = f" (and {more} more)" if more else ""
    return f"{_complaint(first, place, keys_at)}{tail}"


# Where pydantic speaks of its own types, not of the document's.
_EXPECTED = {
    "model_type": "a table of keys",
    "dict_type": "a table of keys",
    "tuple_type": "a list",
    "list_type": "a list",
    "too_short": "a list of at least {min_length}",
    "too_long": "a list of at most {max_length}",
    "string_too_short": "at least {min_length} characters",
    "string_too_long": "at most {max_length} characters",
}


def _complaint(first: Any, place: tuple[int | str, ...], keys_at: Callable[[tuple[int | str, ...]], list[str]]) -> str:
    where = brief(".".join(str(part) for part in place))
    at = f"{where}: " if where else ""
    if first["type"] == "extra_forbidden":
        return f"found unknown key {where!r}, expected {closest(str(place[-1]), keys_at(place[:-1]))}"
    if first["type"] == "missing":
        return f"found no key {where!r}, expected it"
    expected = str(first["msg"])
    for prefix in ("Input should be ", "Value error, "):
        expected = expected.removeprefix(prefix)
    if "pattern" in first.get("ctx", {}):
        expected = "letters, digits, '.', '_' and '-' only, without a leading dot"
    if expected.startswith("found "):  # a validator of ours that says both itself
        return f"{at}{expected}"
    expected = _EXPECTED.get(first["type"], expected).format(**first.get("ctx", {}))
    return f"{at}found {shown(first['input'])}, expected {expected[:1].lower()}{expected[1:]}"


def _keys_of(model: type[BaseModel]) -> Callable[[tuple[int | str, ...]], list[str]]:
    """The keys that a model knows at a place inside it, for hints."""

    def keys_at(place: tuple[int | str, ...]) -> list[str]:
        current: type[BaseModel] = model
        for part in place:
            field = current.model_fields.get(str(part))
            inner = field.annotation if field else None
            if not (isinstance(inner, type) and issubclass(inner, BaseModel)):
                return []
            current = inner
        return [field.alias or name for name, field in current.model_fields.items()]

    return keys_at
