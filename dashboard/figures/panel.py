"""Map of an assembled panel in its own frame: its picture, features, stretches, and what is not covered."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from dashboard.figures.base import escape, figure
from dashboard.figures.scene import add_features, mark_chosen
from dashboard.locale import Locale
from dashboard.palette import BLUE, DIVERGING, INK, ORANGE, SEVERITY_COLOURS, quantity_words
from dashboard.panels import PanelPicture, PanelView
from dashboard.words import _
from metrology.assembly.picture import FINER, Stitched
from metrology.kinds import BY_NAME, KINDS, SEAM_STATION
from metrology.verdicts import SEVERITIES
from storage.review import Feature

_MOST_NAMES = 150
_WIDTH, _LOWEST, _TALLEST = 640, 250, 440  # px
_ARROW_PX = 46
_SHADOW = "0 0 3px #000, 0 0 2px #000"
_LABELLED = 0.03  # of the map's width: shorter stretches have no label
_SCALE_PERCENT = 95  # of the deviations lie within the colours' range
_MOST_CELLS = 150_000  # of the map of deviations: a browser draws them at once


def panel_figure(
    view: PanelView, chosen: Feature | None, locale: Locale, picture: PanelPicture | None = None,
    deviation: bool = False, airflows: Mapping[str, tuple[float, float]] | None = None,
) -> go.Figure:  # fmt: skip
    """A click on a feature comes back with its URL parameter as customdata; axes are mm of the panel, y upwards.

    Parameters
    ----------
    picture : PanelPicture, optional
        What lies under the features.
    deviation : bool
        Whether that is the map of deviations rather than the picture.
    airflows : mapping of str to (x, y), optional
        Where the air flows over a seam: an arrow at its middle.
    """
    x, y = _extent(view, picture.stitched if picture else None)
    fig = figure(locale, _height(x, y), dragmode="pan", clickmode="event+select")
    if picture is not None and deviation:
        _add_deviation(fig, picture.stitched)
    elif picture is not None:
        _add_picture(fig, picture)
    fig.update_xaxes(title="x, mm", constrain="domain", range=x, showgrid=picture is None)
    _add_stretches(fig, view, locale, _LABELLED * (x[1] - x[0]))
    for severity in reversed(SEVERITIES):
        for kind in reversed(KINDS):
            add_features(fig, kind, view.features[kind.name], severity, locale)
    _add_uncovered(fig, view.coverage, locale)
    _add_names(fig, view, INK if picture is None else "black" if deviation else "white")
    _add_airflows(fig, view, airflows or {})
    mark_chosen(fig, view.features, chosen, INK)
    ticks = _ticks(*y)
    fig.update_yaxes(
        title="y, mm", scaleanchor="x", constrain="domain", range=y[::-1], tickvals=ticks,
        ticktext=[locale.whole(-tick) for tick in ticks], showgrid=picture is None,
    )  # fmt: skip
    return fig


def _extent(view: PanelView, picture: Stitched | None) -> tuple[tuple[float, float], tuple[float, float]]:
    """Least and most of x and of y downwards over all features, what is not covered and the picture, mm."""
    x = pd.concat([*(rows["u_px"] for rows in view.features.values()), view.coverage["x_mm"]]).astype(float)
    y = pd.concat([*(rows["v_px"] for rows in view.features.values()), -view.coverage["y_mm"].astype(float)])
    corners = []
    if picture is not None:
        width, height = picture.size_mm
        corners = [(picture.left_mm, -picture.top_mm), (picture.left_mm + width, height - picture.top_mm)]
    elif not (x.notna() & y.notna()).any():
        return (0.0, 1.0), (0.0, 1.0)
    ends = [(px, -py) for course in view.coverage.get("course", pd.Series()).dropna() for px, py, _ in course]
    places = np.array([*corners, *ends, (x.min(), y.min()), (x.max(), y.max())], float)
    (left, upper), (right, lower) = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
    air = 0.02 * max(right - left, lower - upper)
    return (left - air, right + air), (upper - air, lower + air)


def _add_picture(fig: go.Figure, picture: PanelPicture) -> None:
    width, height = picture.stitched.size_mm
    fig.add_layout_image(
        source=picture.uri, xref="x", yref="y", x=picture.stitched.left_mm, y=-picture.stitched.top_mm, sizex=width,
        sizey=height, sizing="stretch", layer="below",
    )  # fmt: skip


def _add_deviation(fig: go.Figure, picture: Stitched) -> None:
    shown = picture.deviation
    every = int(np.ceil(np.sqrt(shown.size / _MOST_CELLS)))
    shown = shown[every // 2 :: every, every // 2 :: every]
    step = picture.mm_per_px * FINER * every
    limit = max(0.02, float(np.nanpercentile(np.abs(shown), _SCALE_PERCENT))) if np.isfinite(shown).any() else 0.02
    fig.add_heatmap(
        z=np.round(shown, 4), x0=picture.left_mm + step / 2, dx=step, y0=-picture.top_mm + step / 2, dy=step,
        colorscale=DIVERGING, zmin=-limit, zmax=limit, hoverongaps=False,
        colorbar={"title": {"text": "mm"}, "thickness": 12, "tickformat": "+.2f"},
        hovertemplate="%{z:+.3f} mm<extra></extra>",
    )  # fmt: skip


def _height(x: tuple[float, float], y: tuple[float, float]) -> int:
    """As much of the page as the panel's shape needs."""
    ratio = (y[1] - y[0]) / max(x[1] - x[0], 1.0)
    return int(min(_TALLEST, max(_LOWEST, 130 + _WIDTH * ratio)))


def _ticks(low: float, high: float) -> list[int]:
    """Where y is written, so that it can be written as the panel has it: upwards."""
    step = max(10, round((high - low) / 4 / 10) * 10)
    return [k * step for k in range(int(low // step), int(high // step) + 2)]


def _add_stretches(fig: go.Figure, view: PanelView, locale: Locale, labelled_mm: float) -> None:
    """A broad line behind the positions of each stretch and, where it is long enough, what is beyond."""
    labelled = 0
    for row in view.findings[view.findings["from_mm"].notna()].itertuples():
        name, position = BY_NAME[str(row.feature_kind)].id_columns
        course = view.features[str(row.feature_kind)][[name, position, "u_px", "v_px"]]
        within = course[
            (course[name] == str(row.feature_id).split("@")[0]) & course[position].between(row.from_mm, row.to_mm)
        ].sort_values(position)
        if within.empty:
            continue
        fig.add_scatter(
            x=within["u_px"].tolist(), y=within["v_px"].tolist(), mode="lines", opacity=0.45, showlegend=False,
            hoverinfo="skip", line={"color": SEVERITY_COLOURS.get(row.severity, INK), "width": 14},
        )  # fmt: skip
        if row.length_mm < labelled_mm:
            continue  # a name would cover its neighbours'
        labelled += 1
        middle = within.iloc[len(within) // 2]
        worst = locale.number(row.value, sign=True)
        fig.add_annotation(
            x=middle["u_px"], y=middle["v_px"], showarrow=False, yshift=18 if labelled % 2 else -18,
            text=escape(f"{quantity_words(row.quantity)} {worst}, {locale.number(row.length_mm, 0)} mm"),
            font={"size": 11, "color": "white"}, bgcolor="rgba(0,0,0,0.6)", borderpad=2,
        )  # fmt: skip


def _add_airflows(fig: go.Figure, view: PanelView, airflows: Mapping[str, tuple[float, float]]) -> None:
    """An arrow over each seam: where the air flows."""
    rows = view.features[SEAM_STATION.name]
    for name, (x, y) in airflows.items():
        course = rows[(rows["seam_id"] == name) & rows["u_px"].notna()]
        length = float(np.hypot(x, y))
        if course.empty or length == 0:
            continue
        middle = course.iloc[len(course) // 2]
        # Plotly's arrow begins ax, ay pixels from its tip, y downwards.
        fig.add_annotation(
            x=middle["u_px"], y=middle["v_px"], ax=-_ARROW_PX * x / length, ay=_ARROW_PX * y / length, showarrow=True,
            arrowhead=2, arrowwidth=2.5, arrowcolor=BLUE, text=_("air"), font={"size": 11, "color": "white"},
            bgcolor="rgba(0,0,0,0.6)", borderpad=1,
        )  # fmt: skip


def _add_uncovered(fig: go.Figure, coverage: pd.DataFrame, locale: Locale) -> None:
    for state, symbol in (("not measured", "square-open"), ("not seen", "square-x-open")):
        part = coverage[coverage["state"] == state]
        for course in part["course"].dropna() if "course" in part else ():
            fig.add_scatter(
                x=course[:, 0], y=-course[:, 1], mode="lines", showlegend=False, hoverinfo="skip",
                line={"color": ORANGE, "width": 5, "dash": "dot"},
            )  # fmt: skip
        if len(part):
            fig.add_scatter(
                x=part["x_mm"], y=-part["y_mm"].astype(float), mode="markers", name=_(state),
                marker={"symbol": symbol, "size": 13, "color": INK, "line": {"width": 2}},
                text=[
                    f"<b>{escape(r.feature_id)}</b> {_(state)}<br>{escape(locale.reason(r.reason or ''))}"
                    for r in part.itertuples()
                ],
                hovertemplate="%{text}<extra></extra>",
            )  # fmt: skip


def _add_names(fig: go.Figure, view: PanelView, colour: str) -> None:
    """Names of single features, a line above their marks; of courses beside their beginnings."""
    font = {"size": 10, "color": colour, **({"shadow": _SHADOW} if colour == "white" else {})}
    for kind in KINDS:
        rows = view.features[kind.name][[kind.id_columns[0], "u_px", "v_px"]].dropna(subset="u_px")
        if rows.empty:
            continue
        if kind.is_course:
            rows = rows.groupby(kind.id_columns[0], as_index=False).first()
        rows = rows.head(_MOST_NAMES)
        names = rows[kind.id_columns[0]]
        fig.add_scatter(
            x=rows["u_px"].tolist(), y=rows["v_px"].tolist(), mode="text",
            text=[f"  {escape(name)}" if kind.is_course else f"{escape(name)}<br> " for name in names],
            textposition="middle right" if kind.is_course else "top center", textfont=font, hoverinfo="skip",
            showlegend=False,
        )  # fmt: skip
