"""A study's results as files: report.html for people, report.md for pages, one CSV per table."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from itertools import groupby
from pathlib import Path
from typing import Any

from plotly.offline import get_plotlyjs

from flows.study.document import Section, Table, bars_table
from storage.report import markup
from storage.spreadsheet import ENCODING

SIMULATED = (
    "All figures come from simulated scans: rays traced to a virtual panel whose truth is known exactly. They tell "
    "what the method and this software make of such scans; what a real rig reaches is told by `flushline study real` "
    "and by a part that was measured otherwise."
)


_STYLE = """
.study { overflow-x: auto; } .study th[colspan] { border-left: 2px solid #d7dde3; }
.study thead tr + tr th, .study td { padding: .2em .5em; font-size: .9em; }
"""


def write_report(out: Path, title: str, lead: Sequence[str], sections: Sequence[Section]) -> Path:
    """Write report.html, report.md and tables/*.csv into a folder; returns the HTML file."""
    bars = [bar for section in sections for bar in section.bars]
    if bars:
        sections = [Section("Summary", (), (bars_table(bars),)), *sections]
    tables = out / "tables"
    tables.mkdir(parents=True, exist_ok=True)
    for section in sections:
        for table in section.tables:
            _write(tables / f"{table.name}.csv", table.csv(), ENCODING)
    _write(out / "report.md", _markdown(title, lead, sections))
    _write(out / "report.html", _html(title, lead, sections))
    return out / "report.html"


def _write(path: Path, text: str, encoding: str = "utf-8") -> None:
    """Whole or not at all."""
    partial = path.with_name(f".{path.name}.partial")
    partial.write_text(text, encoding=encoding, newline="")
    partial.replace(path)


def _markdown(title: str, lead: Sequence[str], sections: Sequence[Section]) -> str:
    parts = [f"## {title}", *lead]
    for section in sections:
        parts += [f"### {section.title}", *section.text, *(t.markdown() for t in section.tables if t.shown)]
    return "\n\n".join(parts) + "\n"


def _html(title: str, lead: Sequence[str], sections: Sequence[Section]) -> str:
    parts = [
        f"<style>{_STYLE}</style><script>{get_plotlyjs()}</script>",
        f"<h1>{escape(title)}</h1>",
        *_paragraphs(lead),
    ]
    for section in sections:
        parts += [f"<h2>{escape(section.title)}</h2>", *_paragraphs(section.text)]
        parts += [_table(table) for table in section.tables if table.shown]
        parts += [_figure(figure) for figure in section.figures]
    return markup.page(title, parts)


def _paragraphs(text: Sequence[str]) -> list[str]:
    return [f"<p>{escape(paragraph).replace('`', '')}</p>" for paragraph in text]


def _table(table: Table) -> str:
    rows = [[escape(c.text(v)) for c, v in zip(table.columns, row, strict=True)] for row in table.rows]
    numeric = [k for k, column in enumerate(table.columns) if column.digits is not None]
    body = markup.table([escape(column.name) for column in table.columns], rows, numeric)
    if any(column.group for column in table.columns):
        body = body.replace("<thead>", f"<thead>{_group_heads(table)}", 1)
    caption = f'{escape(table.title)} (<a href="tables/{table.name}.csv">CSV</a>)'
    return f'<h3>{caption}</h3><div class="study">{body}</div>'


def _group_heads(table: Table) -> str:
    """The row of heads that several columns share."""
    groups = [(name, len(list(columns))) for name, columns in groupby(table.columns, key=lambda column: column.group)]
    heads = [f'<th colspan="{n}">{escape(name)}</th>' for name, n in groups]
    return f"<tr>{''.join(heads)}</tr>"


def _figure(figure: Any) -> str:
    figure.update_layout(template="plotly_white", margin={"l": 60, "r": 20, "t": 50, "b": 40})
    return str(figure.to_html(full_html=False, include_plotlyjs=False))
