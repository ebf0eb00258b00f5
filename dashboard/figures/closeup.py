"""Close-ups of a rivet and of a section across a seam, and how a value stands against its limits."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from dashboard.closeup import RivetCloseUp, SeamSection
from dashboard.figures.base import BARE, add_shapes, adds_points, figure, limit_lines
from dashboard.figures.limits import with_air
from dashboard.locale import Locale
from dashboard.palette import BLUE, DIVERGING, GREEN, INK, MISSING, ORANGE, PURPLE, RED
from dashboard.words import _
from metrology.tolerance import Limit

_MOST_POINTS = 3000


def rivet_map(closeup: RivetCloseUp, locale: Locale, height: int = 300) -> go.Figure:
    """The head and the skin around it from above, coloured by deviation, with both point sets' borders."""
    fig = figure(locale, height, margin=BARE)
    u0, v0 = closeup.u.min(), closeup.v.min()
    image = np.full((closeup.v.max() - v0 + 1, closeup.u.max() - u0 + 1), np.nan, np.float32)
    image[closeup.v - v0, closeup.u - u0] = closeup.deviation
    scale = float(np.ptp(closeup.x)) / max(1.0, float(np.ptp(closeup.u)))
    centre = np.hypot(closeup.x, closeup.y).argmin()
    middle_u, middle_v = float(closeup.u[centre] - u0), float(closeup.v[centre] - v0)
    used = closeup.inner | closeup.outer
    limit = max(0.02, float(np.percentile(np.abs(closeup.deviation[used]), 99))) if used.any() else 0.02
    fig.add_heatmap(
        z=np.round(image, 4),
        x=(np.arange(image.shape[1]) - middle_u) * scale,
        y=(np.arange(image.shape[0]) - middle_v) * scale,
        colorscale=DIVERGING,
        zmin=-limit,
        zmax=limit,
        colorbar={"title": {"text": "mm"}, "thickness": 10, "tickformat": "+.2f"},
        hovertemplate="%{z:+.3f} mm<extra>%{x:.1f}, %{y:.1f} mm</extra>",
        hoverongaps=False,
    )
    fit = closeup.fit
    rings = [(fit.inner_mm, GREEN, "solid"), (fit.radius, INK, "dot")]
    rings += [(radius, PURPLE, "solid") for radius in fit.outer_mm]
    turn = np.linspace(0, 2 * np.pi, 90)
    names = {0: _("head points"), 1: _("rim"), 2: _("skin points")}
    for i, (radius, colour, dash) in enumerate(rings):
        fig.add_scatter(
            x=radius * np.cos(turn),
            y=radius * np.sin(turn),
            mode="lines",
            line={"color": colour, "width": 2, "dash": dash},
            hoverinfo="skip",
            name=names.get(i, ""),
            showlegend=i in names,
        )
    fig.update_xaxes(visible=False, constrain="domain")
    fig.update_yaxes(visible=False, autorange="reversed", scaleanchor="x", constrain="domain")
    fig.update_layout(plot_bgcolor=MISSING)
    return fig


def rivet_section(closeup: RivetCloseUp, limit: Limit | None, locale: Locale, height: int = 280) -> go.Figure:
    """A cut through the head along its steepest rise: points, fitted surfaces, limits."""
    fig = figure(locale, height)
    position, deviation, inner, outer = closeup.section(half_width=max(0.6, 0.25 * closeup.fit.radius))
    other = ~(inner | outer)
    for members, colour, name, symbol in (
        (other, INK, _("not used"), "circle-open"),
        (outer, PURPLE, _("skin"), "circle"),
        (inner, GREEN, _("head"), "square"),
    ):
        adds_points(fig, len(position))(
            x=np.round(position[members][:_MOST_POINTS], 3),
            y=np.round(deviation[members][:_MOST_POINTS], 4),
            mode="markers",
            marker={"size": 4, "color": colour, "symbol": symbol, "opacity": 0.55},
            name=name,
            hovertemplate="%{y:+.3f} mm<extra></extra>",
        )
    r = closeup.fit.radius
    ends = np.linspace(-r, r, 41)
    head = closeup.head(ends)
    reach = float(np.abs(position).max()) if position.size else 2 * r
    fig.add_scatter(
        x=ends, y=head, mode="lines", line={"color": ORANGE, "width": 3}, name=_("head as fitted"), hoverinfo="skip"
    )
    fig.add_scatter(
        x=[-reach, reach],
        y=[0, 0],
        mode="lines",
        line={"color": BLUE, "width": 3},
        name=_("skin as fitted"),
        hoverinfo="skip",
    )
    add_shapes(fig, limit_lines(limit))
    _arrow(fig, 0.0, 0.0, closeup.height, f"{locale.number(closeup.height, sign=True)} mm")
    used = deviation[inner | outer]
    marks = [value for value in (limit.bounds if limit else ()) if value is not None and abs(value) < 0.5]
    low, high = with_air([*(used if used.size else [0.0]), *head, *marks])
    fig.update_yaxes(range=[low, high], title=_("above the skin, mm"), tickformat="+.2f")
    fig.update_xaxes(title=_("along the steepest rise of the head, mm"))
    return fig


def seam_figure(section: SeamSection, locale: Locale, height: int = 330) -> go.Figure:
    """The section across a seam as the paper's Fig. 8: points, L1, L2, D, G, D′, G′, step and width."""
    fig = figure(locale, height)
    add = adds_points(fig, len(section.x))
    for members, colour, name, symbol in (
        (~section.used, INK, _("not used"), "circle-open"),
        (section.used, PURPLE, _("skin points"), "circle"),
    ):
        x, h = section.x[members], section.h[members]
        every = max(1, len(x) // _MOST_POINTS)
        add(
            x=np.round(x[::every], 3),
            y=np.round(h[::every], 4),
            mode="markers",
            marker={"size": 4, "color": colour, "symbol": symbol, "opacity": 0.5},
            name=name,
            hovertemplate="%{y:+.3f} mm<extra></extra>",
        )
    reach = float(np.abs(section.x).max())
    (start, __), (end, __) = section.edge_a, section.edge_b
    for line, span, colour, name in (
        (section.line_a, np.linspace(-reach, end, 40), BLUE, "L1"),
        (section.line_b, np.linspace(start, reach, 40), ORANGE, "L2"),
    ):
        inside = (span >= start) & (span <= end)
        # On the same canvas as the points, which would hide them otherwise.
        skin = np.polyval(line[::-1], span)
        add(
            x=span[~inside],
            y=skin[~inside],
            mode="lines",
            line={"color": colour, "width": 3},
            name=name,
            hoverinfo="skip",
        )
        add(
            x=span[inside],
            y=skin[inside],
            mode="lines",
            line={"color": colour, "width": 1.5, "dash": "dot"},
            showlegend=False,
            hoverinfo="skip",
        )
    _letters(fig, section)
    low, high = _section_range(section)
    _dimensions(fig, section, locale, low)
    fig.update_xaxes(title=_("across the seam from side A to side B, mm"))
    fig.update_yaxes(title=_("along the skin's normal, mm"), range=[low, high], tickformat="+.2f")
    return fig


def _letters(fig: go.Figure, section: SeamSection) -> None:
    """D, G, D′, G′ as in Fig. 8."""
    for place, letter, symbol, colour, position in (
        (section.inflection_a, "D", "circle", RED, "bottom left"),
        (section.inflection_b, "G", "circle", RED, "bottom right"),
        (section.edge_a, "D′", "x", GREEN, "top left"),
        (section.edge_b, "G′", "x", GREEN, "top right"),
    ):
        if place is not None and section.inflection_a is not None:
            fig.add_scatter(
                x=[place[0]],
                y=[place[1]],
                mode="markers+text",
                marker={"symbol": symbol, "size": 10, "color": colour, "line": {"width": 1, "color": "white"}},
                text=[f"<b>{letter}</b>"],
                textposition=position,
                textfont={"size": 14},
                hovertemplate=f"{letter}: %{{x:.2f}}, %{{y:+.3f}} mm<extra></extra>",
                showlegend=False,
            )


def _dimensions(fig: go.Figure, section: SeamSection, locale: Locale, low: float) -> None:
    """Arrows for step (eq 6) and width (eq 9)."""
    (xa, ha), (xb, hb) = section.edge_a, section.edge_b
    base = float(np.polyval(section.line_a[::-1], xb))
    _arrow(fig, xb, base, hb, "")
    fig.add_annotation(
        x=xb, y=(base + hb) / 2, text=f"<b>H {locale.number(section.step, sign=True)} mm</b>", showarrow=False,
        xanchor="left", xshift=8, font={"size": 12},
    )  # fmt: skip
    if section.width is not None:
        level = low + 0.12 * (max(ha, hb) - low)
        for x, h in ((xa, ha), (xb, hb)):
            fig.add_scatter(
                x=[x, x],
                y=[h, level],
                mode="lines",
                line={"color": INK, "width": 1},
                showlegend=False,
                hoverinfo="skip",
            )
        for start, end in ((xa, xb), (xb, xa)):
            fig.add_annotation(
                x=end,
                y=level,
                ax=start,
                ay=level,
                xref="x",
                yref="y",
                axref="x",
                ayref="y",
                arrowhead=2,
                arrowcolor=INK,
            )
        fig.add_annotation(
            x=(xa + xb) / 2,
            y=level,
            text=f"W {locale.number(section.width)} mm",
            showarrow=False,
            yshift=-12,
            font={"size": 12},
        )


def _arrow(fig: go.Figure, x: float, start: float, end: float, text: str) -> None:
    fig.add_annotation(
        x=x, y=end, ax=x, ay=start, xref="x", yref="y", axref="x", ayref="y", arrowhead=2, arrowwidth=2, arrowcolor=RED
    )
    if text:
        fig.add_annotation(
            x=x, y=end, text=f"<b>{text}</b>", showarrow=False, yshift=12 if end >= start else -12, font={"size": 12}
        )


def _section_range(section: SeamSection) -> tuple[float, float]:
    """Heights that show both skins and the beginning of the gap, not its ground."""
    used = section.h[section.used]
    lips = [place[1] for place in (section.inflection_a, section.inflection_b, section.edge_a, section.edge_b) if place]
    low, high = with_air([*(used if used.size else [0.0]), *lips])
    return low - 0.3 * (high - low), high + 0.25 * (high - low)
