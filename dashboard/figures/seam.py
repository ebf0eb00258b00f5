"""A seam as engineers draw it: step and gap over its whole length, between their limits."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from dashboard.figures.base import escape, stacked
from dashboard.findings import feature_parameter, feature_words
from dashboard.locale import Locale
from dashboard.palette import INK, SEVERITY_COLOURS, SEVERITY_SYMBOLS, SEVERITY_WORDS, decision_words, quantity_words
from dashboard.seam_course import STEP, Course, SeamCourse
from dashboard.words import _
from metrology.kinds import SEAM_STATION
from metrology.verdicts import SEVERITIES
from storage.review import Feature
from storage.wording import capital

_BEFORE = "rgba(138,143,152,0.55)"
_SPREAD = "rgba(138,143,152,0.22)"
_AIR = 0.15  # of what is drawn, above and below


def seam_course_figure(course: SeamCourse, chosen: Feature | None, locale: Locale, height: int = 430) -> go.Figure:
    """Step above gap; a click on a position comes back with its URL parameter as customdata."""
    fig = stacked(locale, height, (0.5, 0.5), 0.05)
    fig.update_layout(dragmode="zoom", clickmode="event+select")
    for number, drawn in enumerate(course.courses, 1):
        _add_stretches(fig, course, number)
        _add_course(fig, course, drawn, number, locale)
        _add_limits(fig, course, drawn, number)
        title = quantity_words(drawn.quantity.name)
        if drawn.quantity is STEP and course.into_wind:
            title = _("step into the wind")
        fig.update_yaxes(title=f"{capital(title)}, mm", range=_range(drawn), row=number, col=1)
    fig.update_xaxes(title=_("along the seam, mm"), row=2, col=1)
    if chosen is not None and "@" in chosen.id and chosen.id.split("@")[0] == course.name:
        fig.add_vline(float(chosen.id.split("@")[1].split("-")[0]), line={"color": INK, "width": 1, "dash": "dot"})
    return fig


def _add_stretches(fig: go.Figure, course: SeamCourse, number: int) -> None:
    """What does not pass, as bands behind the curve."""
    for first, last, severity in course.stretches:
        fig.add_vrect(
            first - 1, last + 1, layer="below", line_width=0, opacity=0.16,
            fillcolor=SEVERITY_COLOURS.get(severity, INK), row=number, col=1, exclude_empty_subplots=False,
        )  # fmt: skip


def _add_course(fig: go.Figure, course: SeamCourse, drawn: Course, number: int, locale: Locale) -> None:
    if course.before:
        fig.add_scatter(
            x=course.before_s_mm, y=drawn.before, mode="lines", line={"color": _BEFORE, "width": 3}, hoverinfo="skip",
            name=escape(_("before: {aircraft}", aircraft=course.before)), showlegend=number == 1, row=number, col=1,
        )  # fmt: skip
    upper, lower = drawn.values + drawn.u95, drawn.values - drawn.u95
    for edge, fill in ((upper, None), (lower, "tonexty")):
        fig.add_scatter(
            x=course.s_mm, y=edge, mode="lines", line={"width": 0}, fill=fill, fillcolor=_SPREAD, hoverinfo="skip",
            showlegend=False, row=number, col=1,
        )  # fmt: skip
    for name in reversed(SEVERITIES):
        part = np.array([k for k, own in enumerate(drawn.severities) if own == name and np.isfinite(drawn.values[k])])
        if len(part):
            fig.add_scatter(
                x=course.s_mm[part], y=drawn.values[part], mode="markers", name=_(SEVERITY_WORDS[name]),
                showlegend=number == 1, legendgroup=str(name), customdata=_parameters(course, part),
                marker={"color": SEVERITY_COLOURS[name], "symbol": SEVERITY_SYMBOLS[name], "size": 5},
                text=_said(course, drawn, part, locale), hovertemplate="%{text}<extra></extra>", row=number, col=1,
            )  # fmt: skip


def _parameters(course: SeamCourse, part: np.ndarray) -> list[str]:
    ids = course.rows["feature_id"].iloc[part]
    return [feature_parameter(Feature(SEAM_STATION.name, str(name))) for name in ids]


def _said(course: SeamCourse, drawn: Course, part: np.ndarray, locale: Locale) -> list[str]:
    signed = drawn.quantity.signed
    rows = course.rows.iloc[part]
    return [
        f"<b>{escape(feature_words(str(row.feature_id), locale))}</b><br>"
        f"{escape(locale.measured(drawn.values[k], drawn.u95[k], 'mm', signed))}<br>{decision_words(row.decision)}"
        for k, row in zip(part, rows.itertuples(), strict=True)
    ]


def _add_limits(fig: go.Figure, course: SeamCourse, drawn: Course, number: int) -> None:
    """Limits (dashed) and serious limits (dotted) at each place: they may change along the seam."""
    for bound, dash in zip(drawn.bounds, ("dash", "dash", "dot", "dot"), strict=True):
        if np.isfinite(bound).any():
            fig.add_scatter(
                x=course.s_mm, y=bound, mode="lines", hoverinfo="skip", showlegend=False,
                line={"color": INK, "width": 1.3, "dash": dash, "shape": "hvh"}, row=number, col=1,
            )  # fmt: skip


def _range(drawn: Course) -> list[float] | None:
    """From what is measured and the limits; serious limits only where values come near them."""
    shown = np.concatenate([drawn.values, drawn.before, *drawn.bounds[:2]])
    shown = shown[np.isfinite(shown)]
    if not shown.size:
        return None
    low, high = float(shown.min()), float(shown.max())
    air = max(0.02, _AIR * (high - low))
    return [low - air, high + air]
