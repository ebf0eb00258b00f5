"""A scene's picture with its rivets and seams drawn on it, and its deviation map and 3-D view."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
import plotly.graph_objects as go
from numpy.typing import NDArray

from dashboard.deviation import FieldDeviation
from dashboard.figures.base import escape, figure
from dashboard.findings import feature_parameter
from dashboard.habits import Habits
from dashboard.palette import DIVERGING, MISSING, SEVERITY_COLOURS, SEVERITY_SYMBOLS, SEVERITY_WORDS
from dashboard.pictures import data_uri, shrunk
from metrology.kinds import HOLE, RIVET, SEAM_STATION
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
    habits: Habits,
    height: int = 520,
    values: bool = True,
) -> go.Figure:
    """The picture; a click on a rivet or a station comes back with its URL parameter as customdata.

    Parameters
    ----------
    values : bool
        Whether heights are written beside rivets that do not pass.
    """
    rows, columns = picture.shape
    fig = figure(habits, height, dragmode="pan", clickmode="event+select")
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
        _add_seams(fig, features[SEAM_STATION.name], severity, habits)
        _add_rivets(fig, features[RIVET.name], severity, habits)
        _add_holes(fig, features[HOLE.name], severity, habits)
    if values:
        _add_values(fig, features[RIVET.name], habits)
    _mark_chosen(fig, features, chosen)
    fig.update_xaxes(range=[-0.5, columns - 0.5], visible=False, constrain="domain")
    fig.update_yaxes(range=[rows - 0.5, -0.5], visible=False, scaleanchor="x", constrain="domain")
    return fig


def _with(rows: pd.DataFrame, severity: str | None) -> pd.DataFrame:
    return rows[rows["severity"].isna()] if severity is None else rows[rows["severity"] == severity]


def _add_rivets(fig: go.Figure, rivets: pd.DataFrame, severity: str | None, habits: Habits) -> None:
    part = _with(rivets, severity)
    part = part[part["u_px"].notna() & part["v_px"].notna()]
    if part.empty:
        return
    colour = SEVERITY_COLOURS[severity]
    u, v = _rims(part)
    fig.add_scatter(x=u, y=v, mode="lines", line={"color": colour, "width": 2.5}, hoverinfo="skip", showlegend=False)
    text = [
        f"<b>{escape(r.rivet_id)}</b> {escape(r.decision)}"
        f"<br>height {habits.measured(r.height_mean_mm, r.height_u95_mm, 'mm')}"
        f"<br>tilt {habits.measured(r.tilt_deg, r.tilt_u95_deg, '°', sign=False)}"
        f"<br>head Ø {habits.number(r.diameter_mm, 2)} mm"
        for r in part.itertuples()
    ]
    fig.add_scattergl(
        x=part["u_px"],
        y=part["v_px"],
        mode="markers",
        marker={
            "color": colour,
            "symbol": SEVERITY_SYMBOLS[severity],
            "size": 9,
            "line": {"width": 2 if severity is None else 0.5, "color": colour if severity is None else "white"},
        },
        customdata=[feature_parameter(Feature(RIVET.name, str(name))) for name in part["rivet_id"]],
        text=text,
        hovertemplate="%{text}<extra></extra>",
        name=f"rivet {SEVERITY_WORDS[severity]}",
        selected={"marker": {"opacity": 1}},
        unselected={"marker": {"opacity": 1}},
    )


def _add_holes(fig: go.Figure, holes: pd.DataFrame, severity: str | None, habits: Habits) -> None:
    part = _with(holes, severity)
    if part.empty:
        return
    text = [
        f"<b>{escape(h.hole_id)}</b> {escape(h.kind)}: {escape(h.decision)}"
        f"<br>Ø {habits.measured(h.diameter_mm, h.diameter_u95_mm, 'mm', sign=False)}"
        for h in part.itertuples()
    ]
    colour = SEVERITY_COLOURS[severity]
    fig.add_scattergl(
        x=part["u_px"],
        y=part["v_px"],
        mode="markers",
        marker={"color": colour, "symbol": "circle-x-open", "size": 16, "line": {"width": 2.5, "color": colour}},
        customdata=[feature_parameter(Feature(HOLE.name, str(name))) for name in part["hole_id"]],
        text=text,
        hovertemplate="%{text}<extra></extra>",
        name=f"hole {SEVERITY_WORDS[severity]}",
        selected={"marker": {"opacity": 1}},
        unselected={"marker": {"opacity": 1}},
    )


def _rims(rivets: pd.DataFrame) -> tuple[list[float | None], list[float | None]]:
    """Outlines of the heads, with a gap after each."""
    turn = np.linspace(0, 2 * np.pi, _RIM_POINTS)
    angle = np.radians(rivets["angle_deg"].to_numpy(float))[:, None]
    a, b = (rivets[name].to_numpy(float)[:, None] / 2 * np.ones(_RIM_POINTS) for name in ("major_px", "minor_px"))
    x, y = a * np.cos(turn), b * np.sin(turn)
    u = rivets["u_px"].to_numpy(float)[:, None] + np.cos(angle) * x - np.sin(angle) * y
    v = rivets["v_px"].to_numpy(float)[:, None] + np.sin(angle) * x + np.cos(angle) * y
    gap = np.full((len(rivets), 1), np.nan)
    return tuple(np.round(np.hstack([part, gap]).ravel(), 1) for part in (u, v))  # type: ignore[return-value]


def _add_seams(fig: go.Figure, stations: pd.DataFrame, severity: str | None, habits: Habits) -> None:
    part = _with(stations, severity)
    if part.empty:
        return
    colour = SEVERITY_COLOURS[severity]
    text = [
        f"<b>{escape(s.seam_id)}</b> at {habits.number(s.s_mm, 1)} mm: {escape(s.decision)}"
        f"<br>step {habits.measured(s.step_mm, s.step_u95_mm, 'mm')}"
        f"<br>width {habits.measured(s.width_mm, s.width_u95_mm, 'mm', sign=False)}"
        for s in part.itertuples()
    ]
    fig.add_scattergl(
        x=part["u_px"],
        y=part["v_px"],
        mode="markers",
        marker={
            "color": colour,
            "symbol": SEVERITY_SYMBOLS[severity],
            "size": 6,
            "line": {"width": 1.5 if severity is None else 0, "color": colour},
        },
        customdata=[feature_parameter(Feature(SEAM_STATION.name, str(name))) for name in part["feature_id"]],
        text=text,
        hovertemplate="%{text}<extra></extra>",
        name=f"seam {SEVERITY_WORDS[severity]}",
        selected={"marker": {"opacity": 1}},
        unselected={"marker": {"opacity": 1}},
    )


def _add_values(fig: go.Figure, rivets: pd.DataFrame, habits: Habits) -> None:
    part = rivets[~rivets["decision"].isin(IN_ORDER) & rivets["u_px"].notna()]
    for rivet in part.head(60).itertuples():
        value = "?" if pd.isna(rivet.height_mean_mm) else habits.number(rivet.height_mean_mm, 3, sign=True)
        fig.add_annotation(
            x=rivet.u_px,
            y=rivet.v_px - rivet.minor_px / 2,
            text=f"{escape(rivet.rivet_id)} {value}",
            showarrow=False,
            yshift=10,
            font={"size": 11, "color": "white"},
            bgcolor="rgba(0,0,0,0.6)",
            borderpad=2,
        )


def _mark_chosen(fig: go.Figure, features: SceneFeatures, chosen: Feature | None) -> None:
    if chosen is None:
        return
    rows = features[chosen.kind]
    found = rows[rows["feature_id"] == chosen.id]
    if found.empty:
        return
    place = found.iloc[0]
    fig.add_scatter(
        x=[place["u_px"]],
        y=[place["v_px"]],
        mode="markers",
        marker={"symbol": "circle-open", "size": 34, "color": "#FFFFFF", "line": {"width": 3}},
        hoverinfo="skip",
        showlegend=False,
    )


def deviation_map(field: FieldDeviation, habits: Habits, height: int = 520) -> go.Figure:
    """The whole field's deviation from its smooth skin."""
    fig = figure(habits, height)
    limit = field.scale_mm
    fig.add_heatmap(
        z=np.round(field.deviation, 4),
        x=field.u,
        y=field.v,
        colorscale=DIVERGING,
        zmin=-limit,
        zmax=limit,
        colorbar={"title": {"text": "mm"}, "thickness": 12, "tickformat": "+.2f"},
        hovertemplate="%{z:+.3f} mm<extra>pixel %{x}, %{y}</extra>",
        hoverongaps=False,
    )
    fig.update_xaxes(visible=False, constrain="domain")
    fig.update_yaxes(visible=False, autorange="reversed", scaleanchor="x", constrain="domain")
    fig.update_layout(plot_bgcolor=MISSING)
    return fig


def cloud_figure(field: FieldDeviation, exaggeration: float, habits: Habits, height: int = 520) -> go.Figure:
    """The cloud in 3-D, flattened onto its skin, with the deviation as height and colour."""
    limit = field.scale_mm
    # The ground of a gap lies millimetres below and would squeeze everything else flat.
    present = np.abs(field.deviation) < _MOST_SCALES * limit
    deviation = field.deviation[present]
    fig = figure(habits, height)
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
            "zaxis": {"title": f"deviation × {exaggeration:g}, mm"},
            "aspectmode": "data",
            "camera": {"eye": {"x": 0.0, "y": -0.9, "z": 1.1}},
        }
    )
    return fig
