"""What tables, columns and views hold, in the person's language.

Their meanings stand once, in English, where they are declared, and come along with the tables in DuckDB and Parquet.
Those that go by columns and steps are few texts with a place for these.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache

from dashboard.reasons import expression_of
from dashboard.words import _
from storage.archive.beside import TABLES_BESIDE
from storage.archive.schema import TABLES
from storage.archive.views import VIEWS

_PATTERNS = (
    "expanded uncertainty (95 %) of {column}, {unit}",
    "expanded uncertainty (95 %) of {column}",
    "wall time of the step {step}, s",
    "of the whole panel: {what}",
    "{point} in the rig frame (left camera), to the right, mm",
    "{point} in the rig frame, down, mm",
    "{point} in the rig frame, away from the rig, mm",
    "column of {pixel} in the raw {camera} image, px",
    "row of {pixel} in the raw {camera} image, px",
    "One row per {one} of each scene. What could not be measured is NULL and reason says why",
    "One row per {one} of each assembled panel, whatever number of scans saw it",
    "The {many} of the newest scan of each station",
    "{many} of the newest scans that do not pass, the gravest first, then by {quantity}",
)
"""Texts with places; the first that fits is taken."""
_PLACES = {"column": "[a-z0-9]+(?:_[a-z0-9]+)+|value", "unit": "mm|degrees", "camera": "left|right"}
"""What may stand in a place, where not anything may."""
_AS_WRITTEN = ("column", "step")


def meaning(text: str) -> str:
    """What a table, column or view holds."""
    pattern, values = _parts(text)
    said = {name: value if name in _AS_WRITTEN else _(value) for name, value in values.items()}
    return _(pattern, **said) if said else _(text)


@cache
def _parts(text: str) -> tuple[str, dict[str, str]]:
    """A pattern and what stands in its places; the text itself where none fits."""
    for pattern in _PATTERNS:
        if found := re.fullmatch(expression_of(pattern, _PLACES), text):
            return pattern, found.groupdict()
    return text, {}


def _declared() -> Iterator[str]:
    for table in (*TABLES, *TABLES_BESIDE):
        yield table.comment
        yield from (column.comment for column in table.columns)
    yield from (view.comment for view in VIEWS)


def texts() -> Iterator[str]:
    """Everything that needs a translation."""
    yield from _PATTERNS
    for pattern, values in map(_parts, _declared()):
        yield from (value for name, value in values.items() if name not in _AS_WRITTEN) if values else (pattern,)
