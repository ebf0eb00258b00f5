"""Map of an assembled panel in its own frame: fields of the scans, features, stretches, and what is not covered."""

from __future__ import annotations

from typing import Any

import pandas as pd
import plotly.graph_objects as go

from dashboard.figures.base import escape, figure
from dashboard.figures.scene import add_features, mark_chosen
from dashboard.locale import Locale
from dashboard.palette import INK, SEVERITY_COLOURS
from dashboard.panels import PanelView
from metrology.kinds import BY_NAME, KINDS
from metrology.verdicts import SEVERITIES
from storage.review import Feature

_MOST_NAMES = 150
_WIDTH, _LOWEST, _TALLEST = 640, 250, 440  # px


def panel_figure(view: PanelView, chosen: Feature | None, locale: Locale) -> go.Figure:
    """A click on a feature comes back with its URL parameter as customdata; axes are mm of the panel, y upwards."""
    x, y = _extent(view)
    fig = figure(locale, _height(x, y), dragmode="pan", clickmode="event+select")
    for k, row in enumerate(view.findings[view.findings["from_mm"].notna()].itertuples()):
        _add_stretch(fig, view, row, locale, above=k % 2 == 0)
    for severity in reversed(SEVERITIES):
        for kind in reversed(KINDS):
            add_features(fig, kind, view.features[kind.name], severity, locale)
    _add_uncovered(fig, view.coverage)
    _add_names(fig, view)
    mark_chosen(fig, view.features, chosen, INK)
    fig.update_xaxes(title="x, mm", constrain="domain")
    ticks = _ticks(*y)
    fig.update_yaxes(
        title="y, mm", scaleanchor="x", constrain="domain", autorange="reversed", tickvals=ticks,
        ticktext=[f"{-tick}" for tick in ticks],
    )  # fmt: skip
    return fig


def _extent(view: PanelView) -> tuple[tuple[float, float], tuple[float, float]]:
    """Least and most of x and of y downwards over all features and what is not covered, mm."""
    x = pd.concat([*(rows["u_px"] for rows in view.features.values()), view.coverage["x_mm"]]).astype(float)
    y = pd.concat([*(rows["v_px"] for rows in view.features.values()), -view.coverage["y_mm"].astype(float)])
    if not (x.notna() & y.notna()).any():
        return (0.0, 1.0), (0.0, 1.0)
    return (x.min(), x.max()), (y.min(), y.max())


def _height(x: tuple[float, float], y: tuple[float, float]) -> int:
    """As much of the page as the panel's shape needs."""
    ratio = (y[1] - y[0]) / max(x[1] - x[0], 1.0)
    return int(min(_TALLEST, max(_LOWEST, 170 + _WIDTH * ratio)))


def _ticks(low: float, high: float) -> list[int]:
    """Where y is written, so that it can be written as the panel has it: upwards."""
    step = max(10, round((high - low) / 4 / 10) * 10)
    return [k * step for k in range(int(low // step), int(high // step) + 2)]


def _add_stretch(fig: go.Figure, view: PanelView, row: Any, locale: Locale, above: bool) -> None:
    """A broad line behind the positions of a stretch, and what is beyond."""
    kind = BY_NAME[row.feature_kind]
    name, position = kind.id_columns
    course = view.features[kind.name]
    within = course[
        (course[name] == str(row.feature_id).split("@")[0]) & course[position].between(row.from_mm, row.to_mm)
    ].sort_values(position)
    if within.empty:
        return
    fig.add_scatter(
        x=within["u_px"], y=within["v_px"], mode="lines", opacity=0.45, showlegend=False, hoverinfo="skip",
        line={"color": SEVERITY_COLOURS.get(row.severity, INK), "width": 14},
    )  # fmt: skip
    worst = locale.number(row.value, sign=True)
    fig.add_annotation(
        x=within["u_px"].iloc[len(within) // 2], y=within["v_px"].iloc[len(within) // 2], showarrow=False,
        yshift=18 if above else -18,
        text=escape(f"{row.quantity} {worst}, {locale.number(row.length_mm, 0)} mm"), font={"size": 11},
    )  # fmt: skip


def _add_uncovered(fig: go.Figure, coverage: pd.DataFrame) -> None:
    for state, symbol in (("not measured", "square-open"), ("not seen", "square-x-open")):
        part = coverage[coverage["state"] == state]
        if len(part):
            fig.add_scatter(
                x=part["x_mm"], y=-part["y_mm"].astype(float), mode="markers", name=state,
                marker={"symbol": symbol, "size": 13, "color": INK, "line": {"width": 2}},
                text=[f"<b>{escape(r.feature_id)}</b> {state}<br>{escape(r.reason or '')}" for r in part.itertuples()],
                hovertemplate="%{text}<extra></extra>",
            )  # fmt: skip


def _add_names(fig: go.Figure, view: PanelView) -> None:
    """Names of single features; of courses where they begin."""
    for kind in KINDS:
        rows = view.features[kind.name]
        rows = rows[rows["u_px"].notna()]
        if kind.is_course:
            rows = rows.groupby(kind.id_columns[0], as_index=False).first()
        rows = rows.head(_MOST_NAMES)
        if len(rows):
            fig.add_scatter(
                x=rows["u_px"], y=rows["v_px"], mode="text", text=[escape(name) for name in rows[kind.id_columns[0]]],
                textposition="top right", textfont={"size": 10, "color": INK}, hoverinfo="skip", showlegend=False,
            )  # fmt: skip
