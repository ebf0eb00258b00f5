"""Control charts, histogram, Pareto and panel heat map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from scipy import stats

from dashboard.figures.base import (
    BARE,
    MARGINS,
    NAMES,
    Line,
    adds_points,
    escape,
    figure,
    limit_lines,
    line_across,
    two_charts,
)
from dashboard.first_pass import Yield
from dashboard.locale import Locale
from dashboard.palette import BLUE, DIVERGING, GREEN, INK, ORANGE, PURPLE, RED, SEQUENTIAL
from dashboard.trends import Event, Quantity, Spread
from dashboard.words import N_, _
from metrology.statistics import ControlChart, ParetoBar
from metrology.tolerance import Limit

_MOST_NAMES = 150
_MOST_LEVEL = 8  # names below bars; more stand aslant


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
    times = locale.axis_times(rows["captured_at"])
    lines, texts = _chart_lines(chart, locale)
    marked, said = _event_lines([(times.iloc[event.index], escape(event.text)) for event in events])
    # In one go: each step that changes one of Plotly's figures looks through all of it.
    layout = two_charts(
        locale, height, 0.64, 0.06,
        xaxis={"tickformat": locale.axis_dates},
        xaxis2={"tickformat": locale.axis_dates},
        yaxis={"title": {"text": f"{_(quantity.title)}, {quantity.unit}"}},
        yaxis2={"title": {"text": _("moving range")}, "rangemode": "tozero"},
        shapes=[*lines, *_limits(chart, limit), *marked],
        annotations=[*texts, *said],
        margin={**MARGINS, "r": 84, "t": 8},
        clickmode="event+select",
    )  # fmt: skip
    values = _values(rows, times, chart, violations, quantity, locale)
    return go.Figure([values, _moving_ranges(times, chart)], layout)


def _moving_ranges(times: pd.Series, chart: ControlChart) -> Line:
    return {
        **_in_time(times, chart.moving_range, PURPLE, 1.2),
        "marker": {"size": 4, "symbol": "square"},
        "hovertemplate": _("moving range") + " %{y:.3f}<extra></extra>",
        "xaxis": "x2",
        "yaxis": "y2",
    }


def _in_time(times: pd.Series, values: Any, colour: str, width: float) -> Line:
    """Points joined by a line in the order of time."""
    line = {"color": colour, "width": width}
    return {"type": "scatter", "x": times, "y": values, "mode": "lines+markers", "line": line, "showlegend": False}


def _chart_lines(chart: ControlChart, locale: Locale) -> tuple[list[Line], list[Line]]:
    """Means and control limits of both charts, with their texts at the right."""
    lines, texts = list[Line](), list[Line]()
    for value, label, axis in (
        (chart.centre, N_("mean"), "y"),
        (chart.upper, N_("UCL"), "y"),
        (chart.lower, N_("LCL"), "y"),
        (chart.range_centre, "mean", "y2"),
        (chart.range_upper, "UCL", "y2"),
    ):
        if np.isfinite(value):
            colour = GREEN if label == "mean" else ORANGE
            lines.append(line_across(axis, value, {"color": colour, "width": 1.5}))
            said = f"{_(label)} {locale.number(value, sign=axis == 'y')}"
            texts.append(
                {"x": 1, "xref": "paper", "xanchor": "left", "y": value, "yref": axis, "text": said,
                 "showarrow": False, "font": {"size": 10}}
            )  # fmt: skip
    return lines, texts


def _values(
    rows: pd.DataFrame,
    times: pd.Series,
    chart: ControlChart,
    violations: Mapping[str, np.ndarray],
    quantity: Quantity,
    locale: Locale,
) -> Line:
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
    return {
        **_in_time(times, chart.values, BLUE, 1.5),
        "marker": {
            "size": [9 if i in broken else 6 for i in range(len(rows))],
            "color": [RED if i in broken else BLUE for i in range(len(rows))],
            "symbol": ["triangle-up" if i in broken else "circle" for i in range(len(rows))],
        },
        "text": text,
        "customdata": rows["scene_id"].astype(str),
        "hovertemplate": "%{text}<extra></extra>",
    }


def _event_lines(marks: Sequence[tuple[Any, str]]) -> tuple[list[Line], list[Line]]:
    """Vertical lines over both charts, and their texts."""
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
    return lines, texts


def _limits(chart: ControlChart, limit: Limit | None) -> list[Line]:
    """Tolerance limits, where they do not squeeze the chart flat."""
    present = chart.values[np.isfinite(chart.values)]
    if limit is None or not present.size:
        return []
    span = max(float(np.ptp(present)), 6 * chart.sigma if np.isfinite(chart.sigma) else 0.0, 1e-6)
    middle = float(present.mean())
    return limit_lines(limit, within=(middle - 3 * span, middle + 3 * span))


def histogram(values: Spread, quantity: Quantity, limit: Limit | None, locale: Locale, height: int = 260) -> go.Figure:
    """All values with the limits and the normal distribution of their mean and standard deviation."""
    title = f"{_(quantity.title)}, {quantity.unit} (" + _("dashed: limits") + ")"
    fig = figure(
        locale, height, bargap=0.05, shapes=limit_lines(limit, "x"),
        xaxis={"title": {"text": title}}, yaxis={"title": {"text": _("how many")}},
    )  # fmt: skip
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
            "automargin": True,
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
    fig.update_xaxes(**NAMES, tickangle=-60 if len(bars) > _MOST_LEVEL else 0)
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
    fig.update_xaxes(**NAMES, tickangle=-60 if len(yields) > _MOST_LEVEL else 0)
    fig.update_yaxes(title=_("first-pass yield"), range=[0, 1.02], tickformat=".0%")
    return fig


def layout_figure(rows: pd.DataFrame, measure: str, quantity: Quantity, locale: Locale, height: int = 380) -> go.Figure:
    """Features at their places on the panel, coloured by mean or share outside; each carries its station and name."""
    in_mm = bool(rows.attrs.get("registered"))
    fig = figure(locale, height, margin=MARGINS if in_mm else BARE, clickmode="event+select")
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
    adds_points(fig, len(rows))(
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
            x=part["x"].mean(), y=part["y"].max(), text=escape(station), showarrow=False, yshift=30, font={"size": 12}
        )
    named = rows.drop_duplicates(["station", "named"]).head(_MOST_NAMES)  # a seam's where it begins
    fig.add_scatter(
        x=named["x"], y=named["y"], mode="text", text=[f"{escape(name)}<br> " for name in named["named"]],
        textposition="top center", textfont={"size": 10, "color": INK}, hoverinfo="skip", showlegend=False,
    )  # fmt: skip
    fig.update_xaxes(visible=in_mm, title="x, mm", showgrid=False, constrain="domain")
    fig.update_yaxes(visible=in_mm, title="y, mm", showgrid=False, scaleanchor="x")
    return fig
