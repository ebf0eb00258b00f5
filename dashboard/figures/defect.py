"""Close-up of a defect of the skin: a map of heights round it, and sections along and across it."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from dashboard.figures.base import BARE, figure, stacked
from dashboard.locale import Locale
from dashboard.palette import BLUE, DIVERGING, GREEN, INK, MISSING, ORANGE, PURPLE, RED
from dashboard.words import _
from metrology.fits import DefectForm

_LEAST_SCALE_MM = 0.02
_AIR = 0.15  # of what is shown, above and below


def defect_map(form: DefectForm, locale: Locale, height: int = 300) -> go.Figure:
    """The defect as the left camera sees it, coloured by height, with its outline and the two lines of section."""
    fig = figure(locale, height, margin=BARE)
    rows, columns = form.heights.shape
    limit = max(_LEAST_SCALE_MM, float(np.nanpercentile(np.abs(form.heights), 99)))
    fig.add_heatmap(
        z=np.round(form.heights, 4),
        x=form.corner[0] + form.step_mm * np.arange(columns),
        y=form.corner[1] + form.step_mm * np.arange(rows),
        colorscale=DIVERGING,
        zmin=-limit,
        zmax=limit,
        colorbar={"title": {"text": "mm"}, "thickness": 10, "tickformat": "+.2f"},
        hovertemplate="%{z:+.3f} mm<extra>%{x:.1f}, %{y:.1f} mm " + _("from the deepest point") + "</extra>",
        hoverongaps=False,
    )
    x, y = np.vstack([form.outline, form.outline[:1]]).T
    fig.add_scatter(x=x, y=y, mode="lines", line={"color": "white", "width": 4}, hoverinfo="skip", showlegend=False)
    _line(fig, x, y, INK, "dot", _("outline at half depth"))
    for name, turn, colour, dash in (
        (_("section along"), form.turn, GREEN, "solid"),
        (_("section across"), form.turn + 0.5 * np.pi, PURPLE, "dash"),
    ):
        ends = form.reach_mm * np.array([-1.0, 1.0])
        _line(fig, ends * np.cos(turn), ends * np.sin(turn), colour, dash, name)
    fig.update_xaxes(visible=False, constrain="domain", range=_within(form.corner[0], form.step_mm, columns))
    fig.update_yaxes(
        visible=False, range=_within(form.corner[1], form.step_mm, rows)[::-1], scaleanchor="x", constrain="domain"
    )
    fig.update_layout(plot_bgcolor=MISSING, margin={"t": 44}, legend={"y": 1.08, "yanchor": "bottom"})
    return fig


def _within(first: float, step: float, cells: int) -> list[float]:
    return [first - 0.5 * step, first + (cells - 0.5) * step]


def _line(fig: go.Figure, x: np.ndarray, y: np.ndarray, colour: str, dash: str, name: str) -> None:
    line = {"color": colour, "width": 2, "dash": dash}
    fig.add_scatter(x=x, y=y, mode="lines", line=line, hoverinfo="skip", name=name)


def defect_sections(form: DefectForm, depth: float, u95: float, locale: Locale, height: int = 420) -> go.Figure:
    """Both sections with the skin as it would be, a straight-edge laid over a dent, and the depth."""
    titles = _("along the defect"), _("across the defect")
    fig = stacked(locale, height, (0.5, 0.5), 0.12, subplot_titles=titles)
    sections = form.shown()
    for row, section in enumerate(sections, 1):
        lines = [
            (_("skin as it would be"), section.skin, BLUE, "dot", 2),
            (_("surface"), section.surface, INK, "solid", 3),
        ]
        if depth > 0:
            lines.append((_("straight-edge"), 0 * section.t, ORANGE, "solid", 3))
        for name, heights, colour, dash, width in lines:
            fig.add_scatter(
                x=section.t,
                y=np.round(heights, 4),
                mode="lines",
                line={"color": colour, "width": width, "dash": dash},
                name=name,
                legendgroup=name,
                showlegend=row == 1,
                hovertemplate=f"{name} %{{y:+.3f}} mm<extra></extra>",
                row=row,
                col=1,
            )
        skin = float(np.interp(0.0, section.t, section.skin))
        _depth(fig, row, skin, skin - depth, locale.measured(depth, u95, "mm", True))
    shown = np.concatenate([np.concatenate([section.surface, section.skin, [0.0]]) for section in sections])
    low, high = float(shown.min()), float(shown.max())
    air = max(_AIR * (high - low), 0.01)
    fig.update_yaxes(range=[low - air, high + air], tickformat="+.2f", title="mm")
    fig.update_xaxes(title=_("from the deepest point, mm"), row=2, col=1)
    fig.update_layout(margin={"t": 44}, legend={"y": 1.08})
    return fig


def _depth(fig: go.Figure, row: int, start: float, end: float, text: str) -> None:
    """An arrow from the skin as it would be to the deepest point; its own line ends before the place it starts from."""
    x, y = (axis + (str(row) if row > 1 else "") for axis in "xy")
    axes = {"xref": x, "yref": y}
    fig.add_shape(type="line", x0=0, x1=0, y0=start, y1=end, line={"color": RED, "width": 2}, **axes)
    fig.add_annotation(x=0, y=end, ax=0, ay=start, axref=x, ayref=y, arrowhead=2, arrowwidth=2, arrowcolor=RED, **axes)
    middle = 0.5 * (start + end)
    shown = {
        "showarrow": False,
        "xanchor": "left",
        "xshift": 8,
        "font": {"color": "white"},
        "bgcolor": "rgba(0,0,0,0.6)",
    }
    fig.add_annotation(x=0, y=middle, text=f"<b>{text}</b>", **shown, **axes)
