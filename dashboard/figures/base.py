"""What all figures share: margins, number locale, and lines that show on light and dark ground."""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go

from dashboard.locale import Locale
from dashboard.palette import INK
from metrology.tolerance import Limit


def figure(locale: Locale, height: int, **layout: Any) -> go.Figure:
    """An empty figure."""
    fig = go.Figure()
    fig.update_layout(
        height=height,
        margin={"l": 8, "r": 8, "t": 8, "b": 8},
        separators=locale.separators,
        legend={"orientation": "h", "yanchor": "bottom", "y": 1.0, "x": 0, "font": {"size": 11}},
        hoverlabel={"align": "left"},
        uirevision="keep",
        **layout,
    )
    fig.update_xaxes(automargin=True, title_standoff=6, zeroline=False)
    fig.update_yaxes(automargin=True, title_standoff=6, zeroline=False)
    return fig


def limit_lines(
    fig: go.Figure, limit: Limit | None, axis: str = "y", within: tuple[float, float] | None = None, **where: Any
) -> None:
    """Tolerance limits (dashed) and serious limits (dotted) as lines across a figure, where they lie within a range."""
    add = fig.add_hline if axis == "y" else fig.add_vline
    low, high = within or (-np.inf, np.inf)
    for value, dash in zip(limit.bounds if limit else (), ("dash", "dash", "dot", "dot"), strict=False):
        if value is not None and low < value < high:
            add(value, line={"color": INK, "width": 1.3, "dash": dash}, **where)


def escape(text: object) -> str:
    """Text for Plotly's labels, which take some HTML."""
    return str(text).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
