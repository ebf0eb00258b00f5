"""A study's results as files: report.html for people, report.md for pages, one CSV per table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from flows import plotly_page
from flows.study.document import Section, bars_table
from storage.archive.files import replacing
from storage.report import markup
from storage.spreadsheet import ENCODING

SIMULATED = (
    "All figures come from simulated scans: rays traced to a virtual panel whose truth is known exactly. They show "
    "what the method and this software make of such scans; what a real rig reaches is shown by `flushline study real` "
    "and by a part that was measured otherwise."
)


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
    with replacing(path) as partial:
        partial.write_text(text, encoding=encoding, newline="")


def _markdown(title: str, lead: Sequence[str], sections: Sequence[Section]) -> str:
    parts = [f"## {title}", *lead]
    for section in sections:
        parts += [f"### {section.title}", *section.text, *(t.markdown() for t in section.tables if t.shown)]
    return "\n\n".join(parts) + "\n"


def _html(title: str, lead: Sequence[str], sections: Sequence[Section]) -> str:
    shown = [
        {
            "title": section.title,
            "text": section.text,
            "tables": [table for table in section.tables if table.shown],
            "figures": [plotly_page.inline(figure) for figure in section.figures],
        }
        for section in sections
    ]
    return markup.page("study.html", title, "flows", lead=lead, sections=shown, plotly=plotly_page.script())
