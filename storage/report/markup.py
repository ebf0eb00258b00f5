"""The parts that every report page has: the shell, tables, numbers, pictures within the page."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from html import escape

from storage.report.verdicts import CLASSES, SIGNS

_STYLE = """
:root { --ink: #1c2733; --soft: #5b6875; --line: #d7dde3; --paper: #fff; --shade: #f4f6f8; }
* { box-sizing: border-box; }
body { font: 15px/1.5 system-ui, "Segoe UI", sans-serif; color: var(--ink); background: var(--paper);
  max-width: 1180px; margin: 2em auto; padding: 0 1.2em; }
h1 { font-size: 1.6em; margin: 0; } h2 { font-size: 1.2em; margin: 2em 0 .4em; border-bottom: 2px solid var(--line); }
h3 { font-size: 1em; margin: 1.4em 0 .3em; }
p.sub { color: var(--soft); margin: .1em 0 1em; }
table { border-collapse: collapse; margin: .6em 0; font-size: .92em; }
th, td { padding: .2em .7em; border-bottom: 1px solid var(--line); text-align: left; vertical-align: top; }
th { color: var(--soft); font-weight: 600; white-space: nowrap; }
td.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
td.why { font-size: .9em; color: var(--soft); }
.badge { display: inline-block; padding: .05em .6em; border-radius: 1em; border: 1.5px solid; white-space: nowrap;
  font-weight: 600; font-size: .92em; }
.big { font-size: 1.15em; padding: .2em 1em; }
.pass { color: #00664b; background: #e3f4ee; } .nearly { color: #00664b; background: #fff; border-style: dashed; }
.fail { color: #9c3a00; background: #fdeadd; } .doubt { color: #9c3a00; background: #fff; border-style: dashed; }
.none { color: #4b5563; background: #eef0f2; }
.warning { background: #fff4d6; border-left: 4px solid #d99a00; padding: .3em 1em; margin: .3em 0; }
figure { margin: .8em 0; } figure img, figure svg { max-width: 100%; height: auto; display: block; }
figcaption { color: var(--soft); font-size: .9em; margin-top: .3em; }
.pair { display: flex; gap: 1.2em; flex-wrap: wrap; } .pair figure { flex: 1 1 480px; min-width: 0; }
details { margin: .6em 0; } summary { cursor: pointer; color: var(--soft); }
pre { background: var(--shade); padding: .8em; overflow-x: auto; font-size: .82em; }
code { font-size: .92em; overflow-wrap: anywhere; }
@media print {
  body { font-size: 10pt; max-width: none; margin: 0; } h2 { break-after: avoid; }
  tr, figure { break-inside: avoid; } thead { display: table-header-group; }
  .badge, .warning, svg { -webkit-print-color-adjust: exact; print-color-adjust: exact; }
  details.hide-in-print { display: none; }
}
"""


def page(title: str, parts: Iterable[str]) -> str:
    """A whole HTML document that refers to nothing outside itself."""
    made = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><title>{escape(title)}</title>'
        f"<style>{_STYLE}</style></head><body>\n{chr(10).join(parts)}\n"
        f'<p class="sub">Report made {made} by Flushline.</p>\n</body></html>\n'
    )


def badge(decision: str, count: int | None = None, big: bool = False) -> str:
    """A decision with its sign, and how often it occurs."""
    times = "" if count is None else f"{count} "
    classes = f"badge {CLASSES[decision]}" + (" big" if big else "")
    return f'<span class="{classes}">{SIGNS[decision]} {times}{escape(decision)}</span>'


def number(value: float | None, digits: int, sign: bool = False) -> str:
    """A number, or a dash."""
    return "–" if value is None else f"{value:{'+' if sign else ''}.{digits}f}"


def with_u95(value: float | None, u95: float | None, digits: int, sign: bool = False) -> str:
    """A value with its expanded uncertainty."""
    if value is None:
        return "–"
    return number(value, digits, sign) + ("" if u95 is None else f" ± {u95:.{digits}f}")


def table(heads: Sequence[str], rows: Iterable[Sequence[str]], numeric: Sequence[int] = ()) -> str:
    """A table; cells are HTML already, `numeric` columns stand right-aligned. A last column "why" is set smaller."""

    def cell(k: int, text: str) -> str:
        kind = ' class="n"' if k in numeric else ' class="why"' if heads[k] == "why" else ""
        return f"<td{kind}>{text}</td>"

    body = "".join(f"<tr>{''.join(cell(k, text) for k, text in enumerate(row))}</tr>" for row in rows)
    return f"<table><thead><tr>{''.join(f'<th>{h}</th>' for h in heads)}</tr></thead><tbody>{body}</tbody></table>"


def facts(pairs: Iterable[tuple[str, str]]) -> str:
    """Names and what they are; the values are HTML already."""
    return f"<table>{''.join(f'<tr><th>{escape(name)}</th><td>{value}</td></tr>' for name, value in pairs)}</table>"


def figure(content: str, caption: str) -> str:
    """A picture or drawing with words under it."""
    return f"<figure>{content}<figcaption>{escape(caption)}</figcaption></figure>"


def data_uri(content: bytes, kind: str) -> str:
    """A picture as part of the page."""
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def moment(value: datetime | None) -> str:
    """A time in UTC."""
    return "–" if value is None else f"{value.astimezone(UTC):%Y-%m-%d %H:%M:%S} UTC"
