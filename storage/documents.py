"""Reading JSON and TOML files written by people: every way they can be wrong becomes one line."""

from __future__ import annotations

import difflib
import json
import os
import stat
import tomllib
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Strict, StringConstraints, ValidationError

from metrology.errors import FlushlineError

MAX_DOCUMENT_BYTES = 64 * 2**20
MAX_IDENTIFIER_LENGTH = 64
# No separator, no leading dot: an identifier becomes a folder name and part of a scene's name.
IDENTIFIER_PATTERN = r"[A-Za-z0-9_-][A-Za-z0-9._-]*"

Model = TypeVar("Model", bound=BaseModel)
ErrorType = type[FlushlineError]


class StrictModel(BaseModel):
    """Base of what Flushline writes itself: unknown keys are refused, numbers must be finite numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


Identifier = Annotated[
    str,
    Strict(),
    StringConstraints(pattern=f"^{IDENTIFIER_PATTERN}$", min_length=1, max_length=MAX_IDENTIFIER_LENGTH),
]
"""Aircraft serial, panel, station, rig: letters, digits, ``.``, ``_``, ``-``; no leading dot."""


def _iso_text(value: object) -> object:
    if not isinstance(value, (str, datetime)):
        raise ValueError("an ISO 8601 time with its zone, such as 2026-11-20T08:15:00Z")
    return value


def _in_utc(value: datetime) -> datetime:
    if value.tzinfo is None:
        raise ValueError("an ISO 8601 time with its zone, such as 2026-11-20T08:15:00Z")
    return value.astimezone(UTC)


UtcTime = Annotated[datetime, BeforeValidator(_iso_text), AfterValidator(_in_utc)]
"""A moment, given with its zone and kept in UTC."""

WholeNumber = Annotated[int, Strict()]


def _inside(path: str) -> str:
    pure = PurePosixPath(path)
    if not path or "\0" in path or "\\" in path or pure.is_absolute() or ".." in pure.parts:
        raise ValueError(f"found path {path!r}, expected one inside the folder, relative to it")
    return path


InnerPath = Annotated[str, Strict(), AfterValidator(_inside)]
"""A file of the folder that the manifest lies in. Links in that folder are its owner's and are followed."""


def utc_text(moment: datetime) -> str:
    """ISO 8601 in UTC with a Z, as Flushline's files have it."""
    return moment.astimezone(UTC).isoformat().replace("+00:00", "Z")


def check_regular_file(path: Path, error: ErrorType) -> os.stat_result:
    """Refuse what is missing, a directory, a pipe or a symlink loop before anything opens it."""
    try:
        status = path.stat()
    except FileNotFoundError:
        raise error(f"{path}: found no such file, expected it") from None
    except (OSError, ValueError) as problem:
        raise error(f"{path}: found {_reason(problem)}, expected a readable file") from None
    if not stat.S_ISREG(status.st_mode):
        kind = "a directory" if stat.S_ISDIR(status.st_mode) else "something that is not a file"
        raise error(f"{path}: found {kind}, expected a file")
    return status


def read_bytes(path: Path, error: ErrorType, limit: int | None = None) -> bytes:
    """The whole of a regular file of at most `limit` bytes."""
    size = check_regular_file(path, error).st_size
    if limit is not None and size > limit:
        raise error(f"{path}: found {size} bytes, expected at most {limit}")
    try:
        return path.read_bytes()
    except OSError as problem:
        raise error(f"{path}: found {_reason(problem)}, expected a readable file") from None


def read_json(path: Path, error: ErrorType) -> dict[str, Any]:
    """A JSON object; NaN, infinities and keys given twice are refused."""

    def refuse_constant(name: str) -> float:
        raise ValueError(f"found {name}, expected a finite number")

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        document = dict(pairs)
        if len(document) != len(pairs):
            twice = next(key for key, _ in pairs if sum(key == other for other, _ in pairs) > 1)
            raise ValueError(f"found key {twice!r} twice, expected it once")
        return document

    text = _decode(path, error)
    try:
        document = json.loads(text, parse_constant=refuse_constant, object_pairs_hook=unique)
    except json.JSONDecodeError as problem:
        raise error(
            f"{path}: found broken JSON at line {problem.lineno}, column {problem.colno} ({problem.msg}), "
            "expected a JSON object"
        ) from None
    except ValueError as problem:
        raise error(f"{path}: {problem}") from None
    except RecursionError:
        raise error(f"{path}: found JSON nested too deeply, expected a JSON object") from None
    if not isinstance(document, dict):
        raise error(f"{path}: found {_shown(document)}, expected a JSON object")
    return document


def read_toml(path: Path, error: ErrorType) -> dict[str, Any]:
    """A TOML document."""
    try:
        return tomllib.loads(_decode(path, error))
    except tomllib.TOMLDecodeError as problem:
        raise error(f"{path}: found broken TOML ({problem}), expected a TOML document") from None
    except RecursionError:
        raise error(f"{path}: found TOML nested too deeply, expected a TOML document") from None


def validate(model: type[Model], document: Mapping[str, Any], path: Path, error: ErrorType) -> Model:
    """`document` as `model`, or one line naming the file, the key, what was found and what was expected."""
    try:
        return model.model_validate(document)
    except ValidationError as problem:
        raise error(f"{path}: {first_problem(problem, _keys_of(model))}") from None
    except FlushlineError as problem:
        raise error(f"{path}: {problem}") from None


def check_format(document: Mapping[str, Any], expected: str, path: Path, error: ErrorType) -> None:
    """Name a wrong or missing format before any key is looked at: the file is likely another kind of file."""
    found = document.get("format")
    if found != expected:
        raise error(f'{path}: found format {_shown(found)}, expected "{expected}"')


def first_problem(problem: ValidationError, keys_at: Callable[[tuple[int | str, ...]], list[str]]) -> str:
    """The first complaint of pydantic in Flushline's words; how many follow is said in brackets."""
    first = problem.errors(include_url=False)[0]
    place = first["loc"]
    more = problem.error_count() - 1
    tail = f" (and {more} more like this)" if more else ""
    return f"{_complaint(first, place, keys_at)}{tail}"


def closest(key: str, known: list[str]) -> str:
    """A hint at the key that was probably meant, or the list of all."""
    match = difflib.get_close_matches(key, known, n=1)
    return f"{match[0]!r}" if match else f"one of {', '.join(sorted(known))}"


def _complaint(first: Any, place: tuple[int | str, ...], keys_at: Callable[[tuple[int | str, ...]], list[str]]) -> str:
    where = ".".join(str(part) for part in place)
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
        return f"{where}: {expected}"
    if first["type"].startswith("datetime"):
        expected = "an ISO 8601 time with its zone, such as 2026-11-20T08:15:00Z"
    return f"{where}: found {_shown(first['input'])}, expected {expected[:1].lower()}{expected[1:]}"


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


def _decode(path: Path, error: ErrorType) -> str:
    raw = read_bytes(path, error, MAX_DOCUMENT_BYTES)
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        raise error(f"{path}: found bytes that are not UTF-8 at {problem.start}, expected UTF-8 text") from None


def _reason(problem: Exception) -> str:
    text = problem.strerror if isinstance(problem, OSError) and problem.strerror else str(problem)
    return f'"{text}"'


def _shown(value: object) -> str:
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 80 else text[:77] + "…"
