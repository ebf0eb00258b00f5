"""TOML tables to frozen dataclasses: unknown keys, missing keys and wrong types are refused by name."""

from __future__ import annotations

import types
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from metrology.errors import FlushlineError, SpecError

T = TypeVar("T")


def build(cls: type[T], table: object, where: str) -> T:
    """An instance of a dataclass from a TOML table.

    Parameters
    ----------
    cls : a frozen dataclass whose fields are numbers, strings, booleans, tuples, literals, optionals or dataclasses
    table : what TOML gave
    where : str
        The table's key, for messages.
    """
    if not isinstance(table, Mapping):
        raise SpecError(f"{where}: found {_shown(table)}, expected a table")
    hints = get_type_hints(cls)
    known = {f.name: f for f in fields(cls)}  # type: ignore[arg-type]
    for key in table:
        if key not in known:
            raise SpecError(f"{_join(where, key)}: found an unknown key, expected one of {', '.join(known)}")
    missing = [
        name for name, f in known.items()
        if name not in table and f.default is MISSING and f.default_factory is MISSING
    ]  # fmt: skip
    if missing:
        raise SpecError(f"{_join(where, missing[0])}: found nothing, expected {_named(hints[missing[0]])}")
    values = {key: _value(hints[key], value, _join(where, key)) for key, value in table.items()}
    try:
        return cls(**values)
    except FlushlineError as error:
        raise SpecError(f"{where}: {error}" if where else str(error)) from error


def _join(where: str, key: str) -> str:
    return f"{where}.{key}" if where else key


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "…"


def _named(hint: Any) -> str:
    """A type in words."""
    if hint in _SCALARS:
        return _SCALARS[hint][1]
    if get_origin(hint) is Literal:
        return " or ".join(repr(v) for v in get_args(hint))
    if get_origin(hint) is tuple:
        kinds = get_args(hint)
        if kinds[-1] is Ellipsis:
            return f"a list, each entry {_named(kinds[0])}"
        return f"a list of {len(kinds)} values"
    return "a table" if is_dataclass(hint) else "a value"


_SCALARS: dict[Any, tuple[tuple[type, ...], str]] = {
    float: ((int, float), "a number"),
    int: ((int,), "a whole number"),
    str: ((str,), "text"),
    bool: ((bool,), "true or false"),
}


def _value(hint: Any, value: object, where: str) -> Any:
    origin = get_origin(hint)
    if origin in (Union, types.UnionType):
        # TOML has no null: an optional key that is there has a value.
        return _value(next(h for h in get_args(hint) if h is not type(None)), value, where)
    if is_dataclass(hint):
        return build(hint, value, where)  # type: ignore[arg-type]
    if origin is tuple:
        return _tuple(hint, value, where)
    if origin is Literal:
        accepted = value in get_args(hint)
    else:
        accepted = isinstance(value, _SCALARS[hint][0]) and (hint is bool or not isinstance(value, bool))
    if not accepted:
        raise SpecError(f"{where}: found {_shown(value)}, expected {_named(hint)}")
    return float(value) if hint is float else value  # type: ignore[arg-type]


def _tuple(hint: Any, value: object, where: str) -> tuple[Any, ...]:
    kinds = get_args(hint)
    if kinds[-1] is Ellipsis:
        if kinds[0] is float and isinstance(value, (int, float)) and not isinstance(value, bool):
            # One number stands for a list of one: width_mm = 2.0
            return (float(value),)
        if not isinstance(value, list):
            raise SpecError(f"{where}: found {_shown(value)}, expected {_named(hint)}")
        return tuple(_value(kinds[0], item, f"{where}[{k}]") for k, item in enumerate(value))
    if not isinstance(value, list) or len(value) != len(kinds):
        raise SpecError(f"{where}: found {_shown(value)}, expected {_named(hint)}")
    return tuple(_value(kind, item, f"{where}[{k}]") for k, (kind, item) in enumerate(zip(kinds, value, strict=True)))
