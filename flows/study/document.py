"""What a study says: sections of text, tables and figures, the same for HTML, Markdown and CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from storage.spreadsheet import harmless

Cell = str | float | int | None


@dataclass(frozen=True)
class Column:
    """A column: `digits` after the point for numbers (None: text), `sign` to show + as well, `group` a common head."""

    name: str
    digits: int | None = None
    sign: bool = False
    group: str = ""

    @property
    def full_name(self) -> str:
        """Group and name."""
        return f"{self.group}: {self.name}" if self.group else self.name

    def text(self, value: Cell) -> str:
        """A cell as people read it."""
        if value is None or (isinstance(value, float) and math.isnan(value)):
            return "–"
        if self.digits is None or isinstance(value, str):
            return str(value)
        return f"{value:{'+' if self.sign else ''}.{self.digits}f}"


@dataclass(frozen=True)
class Table:
    """A table; `name` becomes its CSV file's, and `shown` says whether reports show it."""

    name: str
    title: str
    columns: tuple[Column, ...]
    rows: Sequence[Sequence[Cell]]
    shown: bool = True

    def csv(self) -> str:
        """Header and rows, numbers unrounded, empty where there is no value."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([harmless(column.full_name) for column in self.columns])
        for row in self.rows:
            writer.writerow(["" if isinstance(v, float) and math.isnan(v) else harmless(v) for v in row])
        return text.getvalue()

    @property
    def cells(self) -> list[list[str]]:
        """Rows as people read them."""
        return [[c.text(v) for c, v in zip(self.columns, row, strict=True)] for row in self.rows]

    @property
    def numeric(self) -> list[int]:
        """Columns of numbers."""
        return [k for k, column in enumerate(self.columns) if column.digits is not None]

    @property
    def groups(self) -> list[tuple[str, int]]:
        """The heads that several columns share, each with the number of its columns; none where no column has one."""
        if not any(column.group for column in self.columns):
            return []
        return [(name, len(list(columns))) for name, columns in groupby(self.columns, key=lambda column: column.group)]

    def markdown(self) -> str:
        """As a Markdown table."""
        heads = [column.full_name for column in self.columns]
        rule = ["---" if column.digits is None else "---:" for column in self.columns]
        lines = [[cell.replace("|", "\\|") for cell in line] for line in [heads, rule, *self.cells]]
        return "\n".join(f"| {' | '.join(line)} |" for line in lines)


@dataclass(frozen=True)
class Bar:
    """What a study must show: a figure, its limit (at most) and what the paper reached, in one unit."""

    name: str
    found: float
    limit: float
    unit: str
    paper: float | None = None

    @property
    def met(self) -> bool:
        """Whether the figure is within the limit."""
        return self.found <= self.limit


@dataclass(frozen=True)
class Section:
    """A part of a study's report."""

    title: str
    text: tuple[str, ...] = ()
    """Paragraphs, first of all the conditions."""
    tables: tuple[Table, ...] = ()
    figures: tuple[Any, ...] = ()
    """tuple of plotly.graph_objects.Figure."""
    bars: tuple[Bar, ...] = ()


def bars_table(bars: Sequence[Bar]) -> Table:
    """All bars in one table."""
    columns = (
        Column("figure"), Column("found", 4), Column("limit", 4), Column("paper", 4), Column("unit"), Column("met"),
    )  # fmt: skip
    rows = [(b.name, b.found, b.limit, b.paper, b.unit, "yes" if b.met else "no") for b in bars]
    return Table("bars", "What the study must show", columns, rows)
