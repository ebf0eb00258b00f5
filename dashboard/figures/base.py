"""What all figures share: margins, number locale, and lines that show on light and dark ground."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from dashboard.locale import Locale
from dashboard.palette import INK
from metrology.tolerance import Limit

_AXIS = {"automargin": True, "title": {"standoff": 6}, "zeroline": False}
_MOST_DRAWN = 1500
Line = dict[str, Any]
"""A shape or an annotation, as Plotly's layout has it."""


def figure(locale: Locale, height: int, **layout: Any) -> go.Figure:
    """An empty figure."""
    return go.Figure(layout={**_common(locale, height), "xaxis": dict(_AXIS), "yaxis": dict(_AXIS), **layout})


def stacked(locale: Locale, height: int, shares: Sequence[float], spacing: float, **options: Any) -> go.Figure:
    """An empty figure of charts one above the other, with one axis along all of them.

    Parameters
    ----------
    shares : sequence of float
        Of the height, from above.
    spacing : float
        Between two, as a share of the height.
    options
        Of `plotly.subplots.make_subplots`.
    """
    fig = make_subplots(
        len(shares), 1, shared_xaxes=True, row_heights=list(shares), vertical_spacing=spacing, **options
    )
    # In one go: each of Plotly's updates looks through the figure.
    axes = {f"{axis}axis{'' if row == 1 else row}": _AXIS for row in range(1, len(shares) + 1) for axis in "xy"}
    fig.update_layout({**_common(locale, height), **axes})
    return fig


def _common(locale: Locale, height: int) -> dict[str, Any]:
    return {
        "height": height,
        "margin": {"l": 8, "r": 8, "t": 8, "b": 8},
        "separators": locale.separators,
        "legend": {"orientation": "h", "yanchor": "bottom", "y": 1.0, "x": 0, "font": {"size": 11}},
        "hoverlabel": {"align": "left"},
        "uirevision": "keep",
    }


def adds_points(fig: go.Figure, n: int) -> Callable[..., go.Figure]:
    """How a figure of n points adds them: many by WebGL, which takes a browser longer to begin than to draw a few."""
    return fig.add_scattergl if n > _MOST_DRAWN else fig.add_scatter


def add_shapes(fig: go.Figure, shapes: Sequence[Line], annotations: Sequence[Line] = ()) -> None:
    """Shapes and annotations, in one go: each of Plotly's `add_hline` and the like looks through the figure."""
    fig.update_layout(
        shapes=[*fig.layout.shapes, *shapes], annotations=[*fig.layout.annotations, *annotations], overwrite=True
    )


def limit_lines(limit: Limit | None, axis: str = "y", within: tuple[float, float] = (-np.inf, np.inf)) -> list[Line]:
    """Tolerance limits (dashed) and serious limits (dotted) across the first chart, where they lie within a range."""
    low, high = within
    return [
        line_across(axis, value, {"color": INK, "width": 1.3, "dash": dash})
        for value, dash in zip(limit.bounds if limit else (), ("dash", "dash", "dot", "dot"), strict=False)
        if value is not None and low < value < high
    ]


def line_across(axis: str, value: Any, line: Line) -> Line:
    """A line at a value of an axis ("x", "y", "y2" …) over the whole width or height of its chart."""
    along, number = ("y" if axis[0] == "x" else "x"), axis[1:]
    ends = {f"{axis[0]}0": value, f"{axis[0]}1": value, f"{along}0": 0, f"{along}1": 1}
    return {
        "type": "line", f"{axis[0]}ref": axis, f"{along}ref": f"{along}{number} domain", "line": line, **ends
    }  # fmt: skip


def escape(text: object) -> str:
    """Text for Plotly's labels, which take some HTML."""
    return str(text).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
