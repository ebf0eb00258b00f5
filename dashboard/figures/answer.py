"""The answer of a query as a chart."""

from __future__ import annotations

import pandas as pd
import plotly.graph_objects as go

from dashboard.figures.base import NAMES, figure
from dashboard.locale import Locale
from dashboard.palette import BLUE

_MOST_BARS = 60


def answer_figure(rows: pd.DataFrame, x: str, y: str, locale: Locale, height: int = 300) -> go.Figure:
    """Bars where `x` is a name, of its first values; a line in the order of `x` where it is a number or a time."""
    fig = figure(locale, height, showlegend=False)
    along = rows[x]
    if pd.api.types.is_numeric_dtype(along) or pd.api.types.is_datetime64_any_dtype(along):
        part = rows.sort_values(x)
        fig.add_scatter(x=part[x], y=part[y], mode="lines+markers", line={"color": BLUE})
    else:
        part = rows.head(_MOST_BARS)
        fig.add_bar(x=part[x].astype(str), y=part[y], marker={"color": BLUE})
        fig.update_xaxes(**NAMES)
    fig.update_xaxes(title=x)
    fig.update_yaxes(title=y, automargin=True)  # of any size
    return fig
