"""Checks of what a specification says."""

from __future__ import annotations

from metrology.errors import SpecError

Point = tuple[float, float]


def require(condition: bool, what: str, found: object, expected: str) -> None:
    """Refuse a value that is out of bounds, saying which, what was found and what was expected."""
    if not condition:
        raise SpecError(f"{what}: found {found}, expected {expected}")
