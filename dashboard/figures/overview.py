"""Figures of the overview: what waits by aircraft and panel, and how all findings stand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from dashboard.figures.base import escape, figure
from dashboard.locale import Locale
from dashboard.palette import COUNTS, DECISION_COLOURS, MISSING
from dashboard.words import _
from storage.templates import rendered

_MOST_AIRCRAFT = 25
_LETTER_PX, _MOST_LETTERS, _SCALE_PX = 6.4, 24, 74


def panel_matrix(
    panels: pd.DataFrame, aircraft: Sequence[str], locale: Locale, height: int = 385
) -> tuple[go.Figure, int]:
    """What waits, by aircraft (newest above) and panel; returns how many aircraft fit too.

    A click comes back with (aircraft, panel, …) as customdata.
    """
    rows = list(aircraft[:_MOST_AIRCRAFT])
    columns = sorted(panels["panel"].unique())
    place = {(a, p): (i, j) for i, a in enumerate(rows) for j, p in enumerate(columns)}
    part = panels[panels["aircraft_serial"].isin(rows)]
    waiting = np.full((len(rows), len(columns)), np.nan)
    for row in part.itertuples():
        waiting[place[row.aircraft_serial, row.panel]] = row.waiting
    margins = _margins(rows, columns)
    fig = figure(locale, height, margin=margins, showlegend=False, clickmode="event+select", dragmode=False)
    fig.add_heatmap(
        z=waiting,
        x=columns,
        y=rows,
        colorscale=COUNTS,
        zmin=0,
        zmax=max(1.0, float(np.nanmax(waiting))) if part.size else 1.0,
        xgap=1,
        ygap=1,
        hoverinfo="skip",
        colorbar={"title": {"text": _("waiting")}, "thickness": 10},
    )
    doubtful = part[part["unjudged"] > 0]
    fig.add_scatter(
        x=doubtful["panel"], y=doubtful["aircraft_serial"], mode="text", text="?", textfont={"color": "black"},
        hoverinfo="skip",
    )  # fmt: skip
    text = [_said(r, locale) for r in part.itertuples()]
    # Heat maps send no clicks; invisible markers on top of them do.
    fig.add_scatter(
        x=part["panel"],
        y=part["aircraft_serial"],
        mode="markers",
        marker={"symbol": "square", "size": 14, "opacity": 0},
        customdata=part[["aircraft_serial", "panel"]].to_numpy(),
        text=text,
        hovertemplate="%{text}<extra></extra>",
        selected={"marker": {"opacity": 0}},
        unselected={"marker": {"opacity": 0}},
    )
    fig.update_xaxes(type="category", tickangle=-60, tickfont={"size": 10}, showgrid=False)
    fig.update_yaxes(type="category", autorange="reversed", tickfont={"size": 10}, showgrid=False)
    fig.update_layout(plot_bgcolor=MISSING)
    return fig, len(rows)


def _margins(rows: Sequence[str], columns: Sequence[str]) -> dict[str, int]:
    """Room for the names (those of columns stand aslant) and the colours' scale, px.

    Plotly would draw all of it a second time to make room itself.
    """
    left, below = (_LETTER_PX * min(_MOST_LETTERS, max(map(len, names), default=0)) for names in (rows, columns))
    return {"l": round(14 + left), "r": _SCALE_PX, "t": 8, "b": round(16 + 0.87 * below)}


def _said(row: Any, locale: Locale) -> str:
    """What a cell of the matrix says."""
    lines = [
        f"<b>{escape(row.aircraft_serial)} {escape(row.panel)}</b>",
        _("{waiting} waiting, {work} of them open work, {fail} fail", waiting=locale.whole(row.waiting),
          work=locale.whole(row.open_work), fail=locale.whole(row.fail)),
        *([_("scans whose rig could not be judged: {n}", n=locale.whole(row.unjudged))] if row.unjudged else ()),
        _("last scan {time}", time=locale.time(row.last_scan)),
    ]  # fmt: skip
    return "<br>".join(lines)


def decision_bar(counts: Mapping[str, int], locale: Locale) -> str:
    """All findings in one bar of HTML, from grave to harmless; a chart of its own would cost the page a redraw."""
    total = max(1, sum(counts.values()))
    parts = [
        {
            "count": count,
            "colour": DECISION_COLOURS[decision],
            "words": f"{_(decision)}: {locale.whole(count)} ({locale.percent(count / total)})",
        }
        for decision, count in counts.items()
        if count
    ]
    return rendered("dashboard", "decision_bar.html", parts=parts)
