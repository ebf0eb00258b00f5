"""Rows of the archive's tables as the results that they were stored from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar

from metrology.results import Feature

Row = TypeVar("Row", bound=Feature)


def result_of(kind: type[Row], row: Mapping[str, Any]) -> Row:
    """A feature from its row; what is NaN or lacks in an older table is None."""
    return kind(**{f.name: _given(row.get(f.name)) for f in fields(kind)})


def _given(value: Any) -> Any:
    return None if isinstance(value, float) and value != value else value
