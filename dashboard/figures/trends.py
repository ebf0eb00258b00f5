"""Control charts, histogram, Pareto and panel heat map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from plotly.subplots import make_subplots
from scipy import stats

from dashboard.figures.base import escape, figure, limit_lines
from dashboard.first_pass import Yield
from dashboard.locale import Locale
from dashboard.palette import BLUE, DIVERGING, GREEN, INK, ORANGE, PURPLE, RED, SEQUENTIAL
from dashboard.trends import Event, Quantity, Spread
from dashboard.words import N_, _
from metrology.statistics import ControlChart, ParetoBar
from metrology.tolerance import Limit


def control_figure(
    rows: pd.DataFrame,
    chart: ControlChart,
    violations: Mapping[str, np.ndarray],
    quantity: Quantity,
    limit: Limit | None,
    events: Sequence[Event],
    locale: Locale,
    height: int = 420,
) -> go.Figure:
    """Individuals chart above, moving ranges below, in the order of time; events as vertical lines."""
    fig = make_subplots(2, 1, shared_xaxes=True, row_heights=[0.68, 0.32], vertical_spacing=0.06)
    fig.update_layout(figure(locale, height).layout)
    times = locale.axis_times(rows["captured_at"])
    _add_values(fig, rows, times, chart, violations, quantity, locale)
    fig.add_scatter(
        x=times,
        y=chart.moving_range,
        mode="lines+markers",
        line={"color": PURPLE, "width": 1.2},
        marker={"size": 4, "symbol": "square"},
        hovertemplate=_("moving range") + " %{y:.3f}<extra></extra>",
        showlegend=False,
        row=2,
        col=1,
    )
    for value, label, row in (
        (chart.centre, N_("mean"), 1),
        (chart.upper, N_("UCL"), 1),
        (chart.lower, N_("LCL"), 1),
        (chart.range_centre, "mean", 2),
        (chart.range_upper, "UCL", 2),
    ):
        if np.isfinite(value):
            fig.add_hline(
                value,
                line={"color": GREEN if label == "mean" else ORANGE, "width": 1.5},
                annotation_text=f"{_(label)} {locale.number(value, sign=row == 1)}",
                annotation_position="right",
                annotation_font_size=10,
                row=row,
                col=1,
            )
    _add_limits(fig, chart, limit)
    _add_events(fig, [(times.iloc[event.index], escape(event.text)) for event in events])
    fig.update_xaxes(tickformat=locale.axis_dates)
    fig.update_yaxes(title=f"{_(quantity.title)}, {quantity.unit}", row=1, col=1)
    fig.update_yaxes(title=_("moving range"), rangemode="tozero", row=2, col=1)
    fig.update_layout(margin={"r": 84, "l": 8, "t": 8, "b": 8}, clickmode="event+select")
    return fig


def _add_values(
    fig: go.Figure,
    rows: pd.DataFrame,
    times: pd.Series,
    chart: ControlChart,
    violations: Mapping[str, np.ndarray],
    quantity: Quantity,
    locale: Locale,
) -> None:
    """The values in the order of time; those that break a rule larger, in red, with the rule's name."""
    broken: dict[int, list[str]] = {}
    for name, points in violations.items():
        for point in points:
            broken.setdefault(int(point), []).append(name)
    text = [
        f"{escape(r.aircraft_serial)} · {locale.time(r.captured_at)}"
        f"<br>{locale.number(r.value, sign=True)} {quantity.unit}"
        + (" (" + _("mean of {n}", n=locale.whole(r.n)) + ")" if r.n > 1 else "")
        + ("<br>" + _("breaks rule {rules}", rules=", ".join(broken[i])) if i in broken else "")
        for i, r in enumerate(rows.itertuples())
    ]
    fig.add_scatter(
        x=times,
        y=chart.values,
        mode="lines+markers",
        line={"color": BLUE, "width": 1.5},
        marker={
            "size": [9 if i in broken else 6 for i in range(len(rows))],
            "color": [RED if i in broken else BLUE for i in range(len(rows))],
            "symbol": ["triangle-up" if i in broken else "circle" for i in range(len(rows))],
        },
        text=text,
        customdata=rows["scene_id"].astype(str),
        hovertemplate="%{text}<extra></extra>",
        showlegend=False,
        row=1,
        col=1,
    )


def _add_events(fig: go.Figure, marks: Sequence[tuple[Any, str]]) -> None:
    """Vertical lines with their texts; one update for all: each of Plotly's `add_vline` looks through the figure."""
    lines = [
        {
            "type": "line", "xref": "x", "yref": "paper", "x0": at, "x1": at, "y0": 0, "y1": 1,
            "line": {"color": INK, "width": 1, "dash": "dashdot"},
        }
        for at, __ in marks
    ]  # fmt: skip
    texts = [
        {
            "x": at, "y": 1, "xref": "x", "yref": "paper", "text": text, "showarrow": False, "textangle": -90,
            "xanchor": "right", "yanchor": "top", "font": {"size": 10, "color": INK},
        }
        for at, text in marks
    ]  # fmt: skip
    fig.update_layout(shapes=[*fig.layout.shapes, *lines], annotations=[*fig.layout.annotations, *texts])


def _add_limits(fig: go.Figure, chart: ControlChart, limit: Limit | None) -> None:
    """Tolerance limits, where they do not squeeze the chart flat."""
    present = chart.values[np.isfinite(chart.values)]
    if limit is None or not present.size:
        return
    span = max(float(np.ptp(present)), 6 * chart.sigma if np.isfinite(chart.sigma) else 0.0, 1e-6)
    middle = float(present.mean())
    limit_lines(fig, limit, within=(middle - 3 * span, middle + 3 * span), row=1, col=1)


def histogram(values: Spread, quantity: Quantity, limit: Limit | None, locale: Locale, height: int = 260) -> go.Figure:
    """All values with the limits and the normal distribution of their mean and standard deviation."""
    fig = figure(locale, height, bargap=0.05)
    fig.add_bar(
        x=values.centres,
        y=values.counts,
        width=values.width,
        marker_color=BLUE,
        hovertemplate="%{x:.3f}: %{y}<extra></extra>",
        name=_("measured"),
    )
    if values.sd > 0:
        x = np.linspace(values.mean - 4 * values.sd, values.mean + 4 * values.sd, 120)
        fig.add_scatter(
            x=x,
            y=stats.norm.pdf(x, values.mean, values.sd) * values.n * values.width,
            mode="lines",
            line={"color": ORANGE, "width": 2},
            name=_("normal distribution"),
            hoverinfo="skip",
        )
    limit_lines(fig, limit, axis="x")
    fig.update_xaxes(title=f"{_(quantity.title)}, {quantity.unit} (" + _("dashed: limits") + ")")
    fig.update_yaxes(title=_("how many"))
    return fig


def pareto_figure(bars: Sequence[ParetoBar], locale: Locale, height: int = 300) -> go.Figure:
    """Panels from frequent to rare with the cumulated share."""
    fig = figure(locale, height)
    names = [bar.name for bar in bars]
    fig.add_bar(
        x=names,
        y=[bar.count for bar in bars],
        marker_color=BLUE,
        name=_("outside limits"),
        hovertemplate="%{x}: %{y}<extra></extra>",
    )
    fig.add_scatter(
        x=names,
        y=[bar.cumulative for bar in bars],
        yaxis="y2",
        mode="lines+markers",
        line={"color": ORANGE},
        name=_("cumulated share"),
        hovertemplate="%{y:.0%}<extra></extra>",
    )
    fig.update_layout(
        yaxis2={
            "overlaying": "y",
            "side": "right",
            "range": [0, 1.02],
            "tickformat": ".0%",
            "showgrid": False,
            "tickmode": "linear",
            "tick0": 0,
            "dtick": 0.2,
        }
    )
    fig.update_xaxes(type="category", tickangle=-60)
    fig.update_yaxes(title=_("findings outside"), selector={"title": {"text": None}, "overlaying": None})
    return fig


def yield_figure(yields: Sequence[Yield], locale: Locale, height: int = 300) -> go.Figure:
    """The share that passed at once, with its interval, of each panel, aircraft or period."""
    fig = figure(locale, height)
    shares = [one.share for one in yields]
    fig.add_bar(
        x=[one.name for one in yields],
        y=shares,
        marker_color=BLUE,
        error_y={
            "type": "data",
            "symmetric": False,
            "array": [one.interval[1] - one.share for one in yields],
            "arrayminus": [one.share - one.interval[0] for one in yields],
            "color": INK,
            "thickness": 1,
        },
        customdata=[(locale.whole(one.passed), locale.whole(one.n)) for one in yields],
        hovertemplate="%{x}: %{y:.1%} (%{customdata[0]} / %{customdata[1]})<extra></extra>",
        name=_("passed at once"),
    )
    fig.update_xaxes(type="category", tickangle=-60 if len(yields) > 8 else 0)
    fig.update_yaxes(title=_("first-pass yield"), range=[0, 1.02], tickformat=".0%")
    return fig


def layout_figure(rows: pd.DataFrame, measure: str, quantity: Quantity, locale: Locale, height: int = 380) -> go.Figure:
    """Features at their places on the panel, coloured by mean or share outside; each carries its station and name."""
    fig = figure(locale, height, clickmode="event+select")
    outside = measure == "outside"
    limit = float(np.nanpercentile(np.abs(rows["mean"]), 98)) if rows["mean"].notna().any() else 1.0
    text = [
        f"<b>{escape(r.station)} {escape(r.name)}</b><br>"
        + _(
            "mean {mean} {unit}, standard deviation {sd}",
            mean=locale.number(r.mean, sign=True),
            unit=quantity.unit,
            sd=locale.number(r.sd),
        )
        + "<br>"
        + _("{share} of {n} outside", share=locale.percent(r.outside), n=locale.whole(r.n))
        for r in rows.itertuples()
    ]
    scale = (
        {"colorscale": SEQUENTIAL, "cmin": 0, "cmax": max(0.01, float(rows["outside"].max()))}
        if outside
        else {"colorscale": DIVERGING, "cmin": -limit, "cmax": limit}
    )
    fig.add_scattergl(
        x=rows["x"],
        y=rows["y"],
        mode="markers",
        marker={
            "size": 7 if len(quantity.kind.id_columns) > 1 else 13,
            "color": rows["outside" if outside else "mean"],
            "line": {"width": 0.5, "color": INK},
            "colorbar": {
                "title": {"text": _("outside") if outside else quantity.unit},
                "thickness": 12,
                "tickformat": ".0%" if outside else "+.2f",
            },
            **scale,
        },
        text=text,
        customdata=rows[["station", "named"]].to_numpy(dtype=object),
        hovertemplate="%{text}<extra></extra>",
        showlegend=False,
    )
    for station, part in rows.groupby("station"):
        fig.add_annotation(
            x=part["x"].mean(), y=part["y"].max(), text=escape(station), showarrow=False, yshift=16, font={"size": 12}
        )
    fig.update_xaxes(visible=False)
    fig.update_yaxes(visible=False, scaleanchor="x")
    return fig
