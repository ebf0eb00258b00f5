"""Plotly figures within a report that needs no network."""

from __future__ import annotations

import plotly.graph_objects as go
from markupsafe import Markup
from plotly.offline import get_plotlyjs


def script() -> Markup:
    """What draws the figures, once a page."""
    return Markup(get_plotlyjs())


def inline(figure: go.Figure) -> Markup:
    """A figure as a part of the page."""
    figure.update_layout(template="plotly_white", margin={"l": 60, "r": 20, "t": 50, "b": 40})
    return Markup(figure.to_html(full_html=False, include_plotlyjs=False))
