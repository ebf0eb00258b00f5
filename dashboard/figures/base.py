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

# Plotly draws all of a figure anew where an axis asks for room while it is drawn: so numbers and times have theirs
# beforehand, and only axes of names, which may be long, ask.
_AXIS = {"automargin": False, "title": {"standoff": 6}, "zeroline": False}
NAMES = {"automargin": True, "type": "category"}
"""An axis of names."""
MARGINS = {"l": 62, "r": 8, "t": 28, "b": 42}
BARE = {"l": 8, "r": 8, "t": 28, "b": 8}
"""Margins round a picture, whose axes are not shown."""
_MOST_DRAWN = 1500
Line = dict[str, Any]
"""A shape or an annotation, as Plotly's layout has it."""


def figure(locale: Locale, height: int, **layout: Any) -> go.Figure:
    """An empty figure."""
    return go.Figure(layout=_layout(locale, height, {"xaxis": _AXIS, "yaxis": _AXIS}, layout))


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


def two_charts(locale: Locale, height: int, share: float, spacing: float, **layout: Any) -> Line:
    """The layout of two charts with one axis along both, for a figure that is made in one go.

    Parameters
    ----------
    share : float
        Of the height, for the upper chart (axes x and y); the lower one (x2 and y2) has the rest but `spacing`.
    layout
        What else it has; of an axis beside what it has here.
    """
    axes = {
        "xaxis": {**_AXIS, "anchor": "y", "matches": "x2", "showticklabels": False},
        "yaxis": {**_AXIS, "anchor": "x", "domain": [1 - share, 1]},
        "xaxis2": {**_AXIS, "anchor": "y2"},
        "yaxis2": {**_AXIS, "anchor": "x2", "domain": [0, 1 - share - spacing]},
    }
    return _layout(locale, height, axes, layout)


def _layout(locale: Locale, height: int, axes: dict[str, Line], more: dict[str, Any]) -> Line:
    """What all figures have, with these axes; `more` adds to the axes that it names."""
    own = {name: {**axis, **more.get(name, {})} for name, axis in axes.items()}
    return {**_common(locale, height), **more, **own}


def _common(locale: Locale, height: int) -> dict[str, Any]:
    return {
        "height": height,
        "margin": dict(MARGINS),
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
