"""A scene's picture with its features drawn on it, and its deviation map and 3-D view."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from numpy.typing import NDArray

from dashboard.deviation import FieldDeviation
from dashboard.figures.base import BARE, adds_points, escape, figure
from dashboard.findings import feature_parameter, feature_words
from dashboard.locale import Locale
from dashboard.palette import DIVERGING, MISSING, SEVERITY_COLOURS, SEVERITY_SYMBOLS, SEVERITY_WORDS
from dashboard.pictures import data_uri, shrunk
from dashboard.words import _
from metrology.kinds import KINDS, Kind
from metrology.verdicts import IN_ORDER, SEVERITIES
from storage.review import Feature

_PICTURE_PX = 1100
_RIM_POINTS = 40
_MOST_SCALES = 6.0


SceneFeatures = Mapping[str, pd.DataFrame]
"""Rows of a scene by the names of the kinds, with `feature_id`."""


def scene_figure(
    picture: NDArray[np.uint8],
    features: SceneFeatures,
    chosen: Feature | None,
    locale: Locale,
    height: int = 520,
    values: bool = True,
) -> go.Figure:
    """The picture; a click on a feature comes back with its URL parameter as customdata.

    Parameters
    ----------
    values : bool
        Whether values are written beside features that do not pass.
    """
    rows, columns = picture.shape
    fig = figure(locale, height, margin=BARE, dragmode="pan", clickmode="event+select")
    fig.add_layout_image(
        source=data_uri(shrunk(picture, _PICTURE_PX)),
        xref="x",
        yref="y",
        x=-0.5,
        y=-0.5,
        sizex=columns,
        sizey=rows,
        sizing="stretch",
        layer="below",
    )
    for severity in reversed(SEVERITIES):
        for kind in reversed(KINDS):
            add_features(fig, kind, features[kind.name], severity, locale)
    for kind in KINDS if values else ():
        _add_values(fig, kind, features[kind.name], locale)
    mark_chosen(fig, features, chosen)
    fig.update_xaxes(range=[-0.5, columns - 0.5], visible=False, constrain="domain")
    fig.update_yaxes(range=[rows - 0.5, -0.5], visible=False, scaleanchor="x", constrain="domain")
    return fig


def add_features(fig: go.Figure, kind: Kind, rows: pd.DataFrame, severity: str | None, locale: Locale) -> None:
    """Symbols of a kind's features of one severity, with the rims of heads."""
    if rows.empty:
        return
    of_it = rows["severity"].isna() if severity is None else rows["severity"] == severity
    part = rows[of_it & rows["u_px"].notna() & rows["v_px"].notna()]
    if part.empty:
        return
    colour = SEVERITY_COLOURS[severity]
    if "major_px" in part:
        u, v = _rims(part, kind.along or "angle_deg")
        fig.add_scatter(
            x=u, y=v, mode="lines", line={"color": colour, "width": 2.5}, hoverinfo="skip", showlegend=False
        )
    empty, filled, size = (1.5, 0.0, 6) if kind.is_course else (2.0, 0.5, 9)
    adds_points(fig, len(rows))(
        x=part["u_px"].tolist(),  # Plotly looks at columns and arrays much longer than at lists
        y=part["v_px"].tolist(),
        mode="markers",
        marker={
            "color": colour,
            "symbol": SEVERITY_SYMBOLS[severity],
            "size": size,
            "line": {
                "width": empty if severity is None else filled,
                "color": colour if severity is None or kind.is_course else "white",
            },
        },
        customdata=[feature_parameter(Feature(kind.name, str(name))) for name in part["feature_id"]],
        text=[_said(kind, row, locale) for row in part[_columns_said(kind, part)].itertuples()],
        hovertemplate="%{text}<extra></extra>",
        name=f"{_(kind.subject)} {_(SEVERITY_WORDS[severity])}",
        selected={"marker": {"opacity": 1}},
        unselected={"marker": {"opacity": 1}},
    )


def _columns_said(kind: Kind, rows: pd.DataFrame) -> list[str]:
    """The columns that `_said` needs: whole rows of a table take much longer."""
    values = [name for quantity in kind.quantities for name in (quantity.column, quantity.u95_column)]
    named = ["feature_id", "decision", *values, *(["diameter_mm"] if "diameter_mm" in rows else [])]
    return list(dict.fromkeys(named))


def _said(kind: Kind, row: Any, locale: Locale) -> str:
    """A feature's name, verdict and values."""
    lines = [f"<b>{escape(feature_words(row.feature_id, locale))}</b>: {escape(_(row.decision))}"]
    for quantity in kind.quantities:
        value, u95 = getattr(row, quantity.column), getattr(row, quantity.u95_column)
        lines.append(f"{_(quantity.name)} {locale.measured(value, u95, quantity.unit, sign=quantity.signed)}")
    if hasattr(row, "diameter_mm"):
        lines.append(f"Ø {locale.number(row.diameter_mm, 2)} mm")
    return "<br>".join(lines)


def _rims(rivets: pd.DataFrame, direction: str) -> tuple[list[float | None], list[float | None]]:
    """Outlines of the heads (or defects), with a gap after each; `direction` is the column of their major axes'."""
    turn = np.linspace(0, 2 * np.pi, _RIM_POINTS)
    angle = np.radians(rivets[direction].to_numpy(float))[:, None]
    a, b = (rivets[name].to_numpy(float)[:, None] / 2 * np.ones(_RIM_POINTS) for name in ("major_px", "minor_px"))
    x, y = a * np.cos(turn), b * np.sin(turn)
    u = rivets["u_px"].to_numpy(float)[:, None] + np.cos(angle) * x - np.sin(angle) * y
    v = rivets["v_px"].to_numpy(float)[:, None] + np.sin(angle) * x + np.cos(angle) * y
    gap = np.full((len(rivets), 1), np.nan)
    return tuple(np.round(np.hstack([part, gap]).ravel(), 1) for part in (u, v))  # type: ignore[return-value]


def _add_values(fig: go.Figure, kind: Kind, rows: pd.DataFrame, locale: Locale) -> None:
    """First values of what does not pass, beside it; positions along a course would cover each other."""
    if kind.is_course:
        return
    first = kind.quantities[0]
    part = rows[~rows["decision"].isin(IN_ORDER) & rows["u_px"].notna()]
    for row in part.head(60).itertuples():
        value = getattr(row, first.column)
        said = "?" if pd.isna(value) else locale.number(value, 3, sign=first.signed)
        fig.add_annotation(
            x=row.u_px,
            y=row.v_px - np.nan_to_num(float(getattr(row, "minor_px", 0.0))) / 2,
            text=f"{escape(row.feature_id)} {said}",
            showarrow=False,
            yshift=10,
            font={"size": 11, "color": "white"},
            bgcolor="rgba(0,0,0,0.6)",
            borderpad=2,
        )


def mark_chosen(fig: go.Figure, features: SceneFeatures, chosen: Feature | None, colour: str = "#FFFFFF") -> None:
    """A ring around the feature that is looked at."""
    if chosen is None:
        return
    rows = features[chosen.kind]
    found = rows[rows["stretch" if chosen.is_stretch else "feature_id"] == chosen.id]
    if found.empty:
        return
    place = found.iloc[len(found) // 2]
    # Between lines of the other brightness: seen on bright skin and on dark.
    for line, width in (("#000000" if colour == "#FFFFFF" else "#FFFFFF", 7), (colour, 3)):
        fig.add_scatter(
            x=[place["u_px"]],
            y=[place["v_px"]],
            mode="markers",
            marker={"symbol": "circle-open", "size": 34, "color": line, "line": {"width": width}},
            hoverinfo="skip",
            showlegend=False,
        )


def deviation_map(field: FieldDeviation, locale: Locale, height: int = 520) -> go.Figure:
    """The whole field's deviation from its smooth skin."""
    fig = figure(locale, height, margin=BARE)
    limit = field.scale_mm
    fig.add_heatmap(
        z=np.round(field.deviation, 4),
        x=field.u,
        y=field.v,
        colorscale=DIVERGING,
        zmin=-limit,
        zmax=limit,
        colorbar={"title": {"text": "mm"}, "thickness": 12, "tickformat": "+.2f"},
        hovertemplate="%{z:+.3f} mm<extra>%{x}, %{y} px</extra>",
        hoverongaps=False,
    )
    fig.update_xaxes(visible=False, constrain="domain")
    fig.update_yaxes(visible=False, autorange="reversed", scaleanchor="x", constrain="domain")
    fig.update_layout(plot_bgcolor=MISSING)
    return fig


def cloud_figure(field: FieldDeviation, exaggeration: float, locale: Locale, height: int = 520) -> go.Figure:
    """The cloud in 3-D, flattened onto its skin, with the deviation as height and colour."""
    limit = field.scale_mm
    # The ground of a gap lies millimetres below and would squeeze everything else flat.
    present = np.abs(field.deviation) < _MOST_SCALES * limit
    deviation = field.deviation[present]
    fig = figure(locale, height, margin=BARE)
    fig.add_scatter3d(
        x=field.x[present],
        y=-field.y[present],
        z=deviation * np.float32(exaggeration),
        mode="markers",
        marker={
            "size": 1.6,
            "color": deviation,
            "colorscale": DIVERGING,
            "cmin": -limit,
            "cmax": limit,
            "colorbar": {"title": {"text": "mm"}, "thickness": 12, "tickformat": "+.2f"},
        },
        hovertemplate="x %{x:.1f} mm, y %{y:.1f} mm<br>%{marker.color:+.3f} mm<extra></extra>",
    )
    fig.update_layout(
        scene={
            "xaxis": {"title": "x, mm"},
            "yaxis": {"title": "y, mm"},
            "zaxis": {"title": _("deviation × {n}, mm", n=locale.number(exaggeration, 0))},
            "aspectmode": "data",
            "camera": {"eye": {"x": 0.0, "y": -0.9, "z": 1.1}},
        }
    )
    return fig
