"""Nominal fasteners and seams from a list, CSV or XLSX: one row per fastener, or per corner of a seam's course."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from metrology.errors import SpecError
from metrology.panel import NominalRivet, NominalSeam

COLUMNS = ("id", "x", "y", "z", "nx", "ny", "nz", "diameter", "zone", "row", "location")
"""What a list may have; id, x, y and z it must have. Lengths in mm, in the panel's frame."""
_NEEDED = ("id", "x", "y", "z")

Row = Mapping[str, Any]


def read_rivets(path: Path, names: Mapping[str, str] | None = None) -> tuple[NominalRivet, ...]:
    """Fasteners of a list.

    Parameters
    ----------
    names : mapping, optional
        What the list calls a column, by its name in `COLUMNS`.
    """
    return tuple(_rivet(place, row) for place, row in _rows(path, names or {}))


def read_seams(path: Path, names: Mapping[str, str] | None = None) -> tuple[NominalSeam, ...]:
    """Seams of a list; rows of one id are the corners of its course, in their order."""
    corners: dict[str, list[tuple[float, float, float]]] = {}
    zones: dict[str, str] = {}
    for place, row in _rows(path, names or {}):
        name = _text(place, row, "id")
        corners.setdefault(name, []).append(_vector(place, row, ("x", "y", "z")))
        if row.get("zone"):
            zones[name] = str(row["zone"])
    return tuple(NominalSeam(name, tuple(course), zones.get(name, "default")) for name, course in corners.items())


def _rivet(place: str, row: Row) -> NominalRivet:
    diameter = _number(place, row, "diameter") if _given(row, "diameter") else None
    if diameter is not None and diameter <= 0:
        raise SpecError(f"{place}, diameter: found {diameter:g}, expected a positive number of mm")
    given = [_given(row, name) for name in ("nx", "ny", "nz")]
    return NominalRivet(
        _text(place, row, "id"),
        _vector(place, row, ("x", "y", "z")),
        diameter,
        str(row["zone"]).strip() if _given(row, "zone") else "default",
        _vector(place, row, ("nx", "ny", "nz")) if all(given) else None,
        *(str(row[name]).strip() if _given(row, name) else None for name in ("row", "location")),
    )


def _rows(path: Path, names: Mapping[str, str]) -> list[tuple[str, Row]]:
    """Rows with the place they stand at, by the names of `COLUMNS`."""
    if unknown := sorted(set(names) - set(COLUMNS)):
        raise SpecError(f"column {unknown[0]!r}: expected one of {', '.join(COLUMNS)}")
    lines = _xlsx(path) if path.suffix.lower() in (".xlsx", ".xlsm") else _csv(path)
    if not lines:
        raise SpecError(f"{path}: found nothing in it, expected a line of column names and rows below")
    head = [str(cell or "").strip() for cell in lines[0]]
    lower = [cell.lower() for cell in head]
    where = {
        name: lower.index(names.get(name, name).lower()) for name in COLUMNS if names.get(name, name).lower() in lower
    }
    if missing := [name for name in _NEEDED if name not in where]:
        found = ", ".join(head) or "none"
        raise SpecError(
            f"{path}: found columns {found}, expected one for {missing[0]!r}: name it by --column {missing[0]}=NAME"
        )
    rows: list[tuple[str, Row]] = []
    for number, cells in enumerate(lines[1:], 2):
        if any(str(cell or "").strip() for cell in cells):
            rows.append((f"{path}: row {number}", {name: cells[k] for name, k in where.items() if k < len(cells)}))
    return rows


def _csv(path: Path) -> list[Sequence[Any]]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as problem:
        said = getattr(problem, "strerror", None) or "bytes that are no UTF-8"
        raise SpecError(f"{path}: found {said}, expected a CSV or XLSX file") from None
    first = text.partition("\n")[0]
    separator = max(",;\t", key=first.count)
    return [row for row in csv.reader(text.splitlines(), delimiter=separator) if row]


def _xlsx(path: Path) -> list[Sequence[Any]]:
    try:
        from openpyxl import load_workbook
    except ImportError:
        raise SpecError(
            f"{path}: found no openpyxl to read it, expected pip install 'flushline[lists]', or a CSV file"
        ) from None
    try:
        book = load_workbook(path, read_only=True, data_only=True)
    except Exception as problem:  # openpyxl raises what the zip and XML below it raise
        raise SpecError(f"{path}: found {' '.join(str(problem).split())}, expected an XLSX file") from None
    try:
        return [row for row in book.worksheets[0].iter_rows(values_only=True) if any(cell is not None for cell in row)]
    finally:
        book.close()


def _given(row: Row, name: str) -> bool:
    return bool(str(row.get(name) if row.get(name) is not None else "").strip())


def _text(place: str, row: Row, name: str) -> str:
    if not _given(row, name):
        raise SpecError(f"{place}, {name}: found nothing, expected a name")
    return str(row[name]).strip()


def _number(place: str, row: Row, name: str) -> float:
    cell = row.get(name)
    try:
        value = float(cell if isinstance(cell, (int, float)) else str(cell).strip().replace(",", "."))
    except ValueError:
        raise SpecError(f"{place}, {name}: found {str(cell)!r}, expected a number") from None
    if not abs(value) <= 1e6:  # no aircraft is a kilometre long; what is not finite is no number
        raise SpecError(f"{place}, {name}: found {value:g}, expected a number of mm")
    return value


def _vector(place: str, row: Row, names: Sequence[str]) -> tuple[float, float, float]:
    x, y, z = (_number(place, row, name) for name in names)
    return x, y, z
