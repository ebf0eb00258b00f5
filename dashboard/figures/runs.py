"""Seconds per step and rig health over time."""

from __future__ import annotations

import pandas as pd
import plotly.graph_objects as go

from dashboard.figures.base import NAMES, escape, figure, stacked
from dashboard.locale import Locale
from dashboard.palette import BLUE, GREEN, GREY, ORANGE, PURPLE, RED, YELLOW
from dashboard.words import _
from metrology.steps import TIMED

_STEP_COLOURS = (BLUE, ORANGE, GREEN, YELLOW, PURPLE, RED, GREY, "#0072B2", "#44AA99", "#882255")
_SYMBOLS = ("circle", "diamond", "square", "x", "triangle-up", "cross")


def seconds_figure(nights: pd.DataFrame, locale: Locale, height: int = 400) -> go.Figure:
    """Seconds of each step, stacked, per day."""
    fig = figure(locale, height, barmode="stack")
    few = len(nights) < 12  # days as names: a time axis would show hours
    for step, colour in zip(TIMED, _STEP_COLOURS, strict=False):
        values = nights[f"seconds_{step}"]
        if values.notna().any():
            fig.add_bar(
                x=nights["date"] if few else nights["day"],
                y=values,
                name=_(step.replace("_", " ")),
                marker_color=colour,
                hovertemplate="%{y:.2f} s<extra>" + _(step.replace("_", " ")) + "</extra>",
            )
    fig.update_yaxes(title=_("s per scan"))
    fig.update_xaxes(**({**NAMES, "autorange": "reversed"} if few else {"tickformat": locale.axis_dates}))
    return fig


def rig_figure(days: pd.DataFrame, locale: Locale, height: int = 380) -> go.Figure:
    """Fit of cameras and projector above, depth noise below, one colour and shape per rig calibration."""
    fig = stacked(locale, height, (1 / 3, 1 / 3, 1 / 3), 0.07)
    for i, (rig, part) in enumerate(days.groupby("rig_id", sort=False)):
        colour, symbol = _STEP_COLOURS[i % len(_STEP_COLOURS)], _SYMBOLS[i % len(_SYMBOLS)]
        for row, column, digits in ((1, "epipolar", 3), (2, "projector", 4), (3, "sigma", 4)):
            fig.add_scatter(
                x=part["day"],
                y=part[column],
                mode="lines+markers",
                name=escape(rig),
                legendgroup=str(rig),
                showlegend=row == 1,
                line={"color": colour, "width": 1.3},
                marker={"symbol": symbol, "size": 6},
                hovertemplate=f"%{{y:.{digits}f}}<extra>{escape(rig)}</extra>",
                row=row,
                col=1,
            )
    fig.update_xaxes(tickformat=locale.axis_dates)
    for row, title in enumerate((_("cameras, px"), _("projector, px"), _("noise, mm")), start=1):
        fig.update_yaxes(title=title, rangemode="tozero", row=row, col=1)
    return fig
