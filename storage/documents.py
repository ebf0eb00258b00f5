"""Reading JSON and TOML files written by people: every way they can be wrong becomes one line."""

from __future__ import annotations

import difflib
import json
import os
import re
import stat
import tomllib
import unicodedata
from collections import Counter
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from metrology.errors import FlushlineError

MAX_DOCUMENT_BYTES = 16 * 2**20
_LONG_NUMBER = "found a number of thousands of digits, expected less"
_MOST_SHOWN = 80  # characters of a value in a message
# The time that a dotted key takes to read grows with the square of its parts.
_MAX_KEY_PARTS = 64
_LONG_KEY = re.compile(rf"""(?<![\w"'.-])(?:[\w"'-]++[ \t]*+\.[ \t]*+){{{_MAX_KEY_PARTS}}}""")
ErrorType = type[FlushlineError]


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


def read_json(path: Path, error: ErrorType, limit: int = MAX_DOCUMENT_BYTES) -> dict[str, Any]:
    """A JSON object of at most `limit` bytes; NaN, infinities and keys given twice are refused."""

    def refuse_constant(name: str) -> float:
        raise ValueError(f"found {name}, expected a finite number")

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        document = dict(pairs)
        if len(document) != len(pairs):
            twice = Counter(key for key, _ in pairs).most_common(1)[0][0]
            raise ValueError(f"found key {brief(twice)!r} twice, expected it once")
        return document

    text = _decode(path, error, limit)
    try:
        document = json.loads(text, parse_constant=refuse_constant, object_pairs_hook=unique)
    except json.JSONDecodeError as problem:
        raise error(
            f"{path}: found broken JSON at line {problem.lineno}, column {problem.colno} ({problem.msg}), "
            "expected a JSON object"
        ) from None
    except ValueError as problem:
        # What is not said by the two above comes from Python's limit on the digits of a whole number.
        said = str(problem) if str(problem).startswith("found ") else _LONG_NUMBER
        raise error(f"{path}: {said}") from None
    except RecursionError:
        raise error(f"{path}: found JSON nested too deeply, expected a JSON object") from None
    if not isinstance(document, dict):
        raise error(f"{path}: found {shown(document)}, expected a JSON object")
    return document


def read_toml(path: Path, error: ErrorType) -> dict[str, Any]:
    """A TOML document."""
    text = _decode(path, error, MAX_DOCUMENT_BYTES)
    if _LONG_KEY.search(text):
        raise error(f"{path}: found a key of more than {_MAX_KEY_PARTS} parts, expected a TOML document")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as problem:
        raise error(f"{path}: found broken TOML ({problem}), expected a TOML document") from None
    except ValueError:
        raise error(f"{path}: {_LONG_NUMBER}") from None
    except RecursionError:
        raise error(f"{path}: found TOML nested too deeply, expected a TOML document") from None


def check_format(document: Mapping[str, Any], expected: str, path: Path, error: ErrorType) -> None:
    """Name a wrong or missing format before any key is looked at: the file is likely another kind of file."""
    found = document.get("format")
    if found != expected:
        raise error(f'{path}: found format {shown(found)}, expected "{expected}"')


def closest(key: str, known: list[str]) -> str:
    """A hint at the key that was probably meant, or the list of all."""
    match = difflib.get_close_matches(key, known, n=1)
    return f"{match[0]!r}" if match else f"one of {', '.join(sorted(known))}"


def _decode(path: Path, error: ErrorType, limit: int) -> str:
    raw = read_bytes(path, error, limit)
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        raise error(f"{path}: found bytes that are not UTF-8 at {problem.start}, expected UTF-8 text") from None


def _reason(problem: Exception) -> str:
    text = problem.strerror if isinstance(problem, OSError) and problem.strerror else str(problem)
    return f'"{text}"'


def printable(text: str) -> str:
    """Text that can be printed and written anywhere, in one line: what cannot, such as in a folder's name, is escaped.

    A byte of a name that is not UTF-8 becomes ``\\xff``.
    """
    return "".join(c if c.isprintable() or unicodedata.category(c) == "Zs" else _escaped(c) for c in text)


def _escaped(character: str) -> str:
    if "\udc80" <= character <= "\udcff":
        return f"\\x{ord(character) - 0xDC00:02x}"
    return character.encode("unicode_escape").decode()


def shown(value: object) -> str:
    """A value as an error message shows it."""
    return brief(json.dumps(value, ensure_ascii=False, default=str))


def brief(text: str) -> str:
    """A text as a message shows it: the beginning of a long one, and escapes for what no terminal should get."""
    text = text if len(text) <= _MOST_SHOWN else f"{text[: _MOST_SHOWN - 1]}…"
    return printable(text)
