"""A calibration's report: one HTML file that needs no network."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.offline import get_plotlyjs
from plotly.subplots import make_subplots

from metrology.calibration.calibrate import Calibration
from metrology.calibration.epipolar_residuals import epipolar_residuals
from metrology.calibration.observations import DeviceName
from metrology.calibration.prediction import FieldUncertainty
from metrology.rig import Device, Rig

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1180px; margin: 2em auto; padding: 0 1em; color: #1c2733; }
table { border-collapse: collapse; margin: 1em 0; } td, th { padding: .25em .8em; border-bottom: 1px solid #d7dde3; }
th { text-align: left; } td.n { text-align: right; font-variant-numeric: tabular-nums; }
.warning { background: #fff4d6; border-left: 4px solid #d99a00; padding: .4em 1em; margin: .3em 0; }
"""
_MAP_STEP = 24  # of the distortion map, in places per longer side


def write_report(calibration: Calibration, rig: Rig, path: Path) -> None:
    """Write the report of a calibration."""
    parts = [
        f"<h1>Calibration {html.escape(rig.id)}</h1>",
        f"<p>Calibrated at {html.escape(rig.calibrated_at)}. Pixels of the raw images, uncertainties 95 %.</p>",
        *(f'<div class="warning">{html.escape(text)}</div>' for text in calibration.warnings),
        _board_text(calibration),
        *_section("Reprojection", _reprojection_table(calibration), _residuals(calibration)),
        *_section("Poses", _pose_table(calibration), _rms_by_pose(calibration)),
        *_section("Coverage of the images", _COVERAGE_TEXT, _coverage(calibration)),
        *_section("Lens distortion", _evidence_table(calibration), _distortion(calibration)),
        *_section("Epipolar residuals", _EPIPOLAR_TEXT, _epipolar(calibration)),
    ]
    if (field := calibration.field) is not None:
        parts += _section("What measurements can expect", _field_text(field), _field_maps(field, rig.left))
    parts += _section("Parameters", _parameter_table(calibration))
    document = (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Calibration {html.escape(rig.id)}</title>'
        f"<style>{_STYLE}</style><script>{get_plotlyjs()}</script></head><body>{''.join(parts)}</body></html>"
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.partial")
    partial.write_text(document, encoding="utf-8")
    partial.replace(path)


_COVERAGE_TEXT = (
    "<p>Where each device saw features. Parts of an image without any are extrapolated by the lens model; the "
    "projector's are the dots it showed, or the coordinates decoded at the board's features.</p>"
)
_EPIPOLAR_TEXT = (
    "<p>Distance of each feature in the right image from the epipolar line of its left pixel. A pattern over the "
    "field, rather than noise, would tell of a lens model that does not fit.</p>"
)


def _section(title: str, *content: str | go.Figure) -> list[str]:
    return [f"<h2>{title}</h2>", *(c if isinstance(c, str) else _inline(c) for c in content)]


def _inline(figure: go.Figure) -> str:
    figure.update_layout(template="plotly_white", margin={"l": 50, "r": 20, "t": 50, "b": 40})
    return str(figure.to_html(full_html=False, include_plotlyjs=False))


def _table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    def cell(value: object) -> str:
        number = isinstance(value, float | int)
        text = f"{value:.5g}" if isinstance(value, float) else html.escape(str(value))
        return f'<td class="n">{text}</td>' if number else f"<td>{text}</td>"

    head = "".join(f"<th>{html.escape(name)}</th>" for name in header)
    body = "".join(f"<tr>{''.join(map(cell, row))}</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"


def _devices(calibration: Calibration) -> dict[DeviceName, Device]:
    return calibration.adjusted.state.devices


def _reprojection_table(calibration: Calibration) -> str:
    rows = [(name, value) for name, value in calibration.rms_px.items()]
    return _table(("device", "RMS distance, its own pixels"), rows)


def _residuals(calibration: Calibration) -> go.Figure:
    """Residual vectors of every feature, by device and kind."""
    kinds = [(device, kind) for device in _devices(calibration) for kind in ("board", "dots")]
    pairs = list(zip(calibration.sightings, calibration.adjusted.residuals, strict=True))
    kinds = [key for key in kinds if any((s.device, s.kind) == key for s, _ in pairs)]
    figure = make_subplots(1, len(kinds), subplot_titles=[f"{device}: {kind}" for device, kind in kinds])
    for column, key in enumerate(kinds, start=1):
        for sighting, residual in pairs:
            if (sighting.device, sighting.kind) == key:
                figure.add_trace(
                    go.Scattergl(
                        x=residual[:, 0],
                        y=residual[:, 1],
                        mode="markers",
                        marker={"size": 3, "color": _colour(sighting.pose)},
                        name=f"pose {sighting.pose}",
                        legendgroup=f"pose {sighting.pose}",
                        showlegend=column == 1,
                    ),
                    row=1,
                    col=column,
                )
    figure.update_xaxes(title="Δu, px")
    figure.update_yaxes(title="Δv, px", scaleanchor="x")
    return figure.update_layout(height=420)


def _board_text(calibration: Calibration) -> str:
    if calibration.board_layout is None:
        return ""
    since = {"new": "as OpenCV draws it since 4.6", "old": "as OpenCV drew it before 4.6"}[calibration.board_layout]
    return f"<p>ChArUco board of the {calibration.board_layout} layout, {since}.</p>"


def _colour(pose: int) -> str:
    return f"hsl({(pose * 137) % 360}, 65%, 45%)"


def _pose_table(calibration: Calibration) -> str:
    rows = [
        (
            use.pose,
            ", ".join(use.used) or "refused",
            use.features,
            use.outliers,
            "; ".join(use.reasons),
        )
        for use in calibration.poses
    ]
    return _table(("pose", "used", "features", "outliers", "refused because"), rows)


def _rms_by_pose(calibration: Calibration) -> go.Figure:
    names = sorted({name for use in calibration.poses for name in use.rms_px})
    poses = [use.pose for use in calibration.poses]
    bars = [go.Bar(name=name, x=poses, y=[use.rms_px.get(name) for use in calibration.poses]) for name in names]
    figure = go.Figure(bars)
    return figure.update_layout(height=320, xaxis_title="pose", yaxis_title="RMS distance, px", barmode="group")


def _coverage(calibration: Calibration) -> go.Figure:
    devices = _devices(calibration)
    figure = make_subplots(1, len(devices), subplot_titles=list(devices))
    for column, (name, device) in enumerate(devices.items(), start=1):
        for sighting in calibration.sightings:
            shown = sighting.kind == "dots" and name == "projector"
            if sighting.device != name and not shown:
                continue
            pixels = sighting.known if shown else sighting.pixels
            marker = {"size": 3, "color": _colour(sighting.pose)}
            figure.add_trace(
                go.Scattergl(x=pixels[:, 0], y=pixels[:, 1], mode="markers", marker=marker, showlegend=False),
                row=1,
                col=column,
            )
        _image_axes(figure, device, column)
    return figure.update_layout(height=340)


def _image_axes(figure: go.Figure, device: Device, column: int) -> None:
    figure.update_xaxes(range=[0, device.width], row=1, col=column)
    figure.update_yaxes(range=[device.height, 0], scaleanchor=f"x{column if column > 1 else ''}", row=1, col=column)


def _evidence_table(calibration: Calibration) -> str:
    text = (
        "<p>Each lens model is a whole adjustment. BIC is what it explains less what its terms cost, relative to the "
        "chosen one; p is how likely noise alone would explain as much as the terms it adds.</p>"
    )
    rows = [
        (
            e.device,
            ", ".join(e.terms) or "none",
            round(e.bic, 1),
            "" if e.p_value is None else f"{e.p_value:.2g}",
            "chosen" if e.chosen else "",
        )
        for e in calibration.evidence
    ]
    return text + _table(("device", "distortion terms", "ΔBIC", "p", ""), rows)


def _distortion(calibration: Calibration) -> go.Figure:
    devices = _devices(calibration)
    figure = make_subplots(1, len(devices), subplot_titles=[f"{name}: displacement, px" for name in devices])
    for column, (_, device) in enumerate(devices.items(), start=1):
        u = np.linspace(0, device.width - 1, _MAP_STEP)
        v = np.linspace(0, device.height - 1, max(2, round(_MAP_STEP * device.height / device.width)))
        size = np.linalg.norm(_displacement(device, np.stack(np.meshgrid(u, v), -1)), axis=-1)
        shape = {"coloring": "heatmap", "showlabels": True}
        figure.add_trace(
            go.Contour(x=u, y=v, z=size, contours=shape, showscale=False, colorscale="Viridis"), row=1, col=column
        )
        _image_axes(figure, device, column)
    return figure.update_layout(height=340)


def _displacement(device: Device, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Raw pixels minus those of the same rays without distortion."""
    ideal = device.normalized(pixels) @ device.K[:2, :2].T + device.K[:2, 2]
    return np.asarray(pixels - ideal)


def _epipolar(calibration: Calibration) -> go.Figure | str:
    if "right" not in _devices(calibration):
        return "<p>There is but one camera.</p>"
    pixels, across = epipolar_residuals(calibration)
    limit = float(np.quantile(np.abs(across), 0.98))
    marker = {"size": 4, "color": across, "colorscale": "RdBu", "cmin": -limit, "cmax": limit, "showscale": True}
    figure = go.Figure(go.Scattergl(x=pixels[:, 0], y=pixels[:, 1], mode="markers", marker=marker))
    rms = float(np.sqrt(np.mean(across**2)))
    device = _devices(calibration)["left"]
    figure.update_yaxes(range=[device.height, 0], scaleanchor="x")
    return figure.update_layout(height=460, title=f"RMS {rms:.4f} px, right pixels, over the left image")


def _field_text(field: FieldUncertainty) -> str:
    return (
        f"<p>What the calibration's covariance alone makes uncertain, on a plane {field.distance_mm:.0f} mm away; "
        "the scan's own noise comes on top. Height: of a head of 8 mm diameter standing 0.5 mm proud over the "
        "skin around. Overlay: where a mark falls on the skin.</p>"
    )


def _field_maps(field: FieldUncertainty, left: Device) -> go.Figure:
    maps = {"height": field.height_u95_mm, "depth": field.depth_u95_mm, "overlay": field.overlay_u95_mm}
    figure = make_subplots(1, len(maps), subplot_titles=[f"U95 of {name}, µm" for name in maps])
    for column, values in enumerate(maps.values(), start=1):
        heat = go.Heatmap(
            x=field.left_px[0, :, 0],
            y=field.left_px[:, 0, 1],
            z=1000 * values,
            colorscale="Viridis",
            showscale=False,
            texttemplate="%{z:.3g}",
        )
        figure.add_trace(heat, row=1, col=column)
        _image_axes(figure, left, column)
    return figure.update_layout(height=340)


def _parameter_table(calibration: Calibration) -> str:
    adjusted = calibration.adjusted
    sigma = dict(zip(adjusted.names, np.sqrt(np.diag(adjusted.covariance)), strict=True))
    rows = []
    for name, device in _devices(calibration).items():
        lens = (device.K[0, 0], device.K[1, 1], device.K[0, 2], device.K[1, 2], *device.distortion8[:5])
        for term, value in zip(("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"), lens, strict=True):
            u95 = sigma.get(f"{name}.{term}")
            rows.append((f"{name} {term}", f"{value:.6g}", "not estimated" if u95 is None else f"± {2 * u95:.2g}"))
        if name != "left":
            for axis, value in zip(("tx", "ty", "tz"), device.t, strict=True):
                rows.append((f"{name} {axis} (mm)", f"{value:.4f}", f"± {2 * sigma[f'{name}.{axis}']:.2g}"))
    return _table(("parameter", "value", "95 %"), rows)
