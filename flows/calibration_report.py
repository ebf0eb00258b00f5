"""A calibration's report: one HTML file that needs no network."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from markupsafe import Markup
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from flows import plotly_page
from flows.plotly_page import inline
from metrology.calibration.calibrate import Calibration
from metrology.calibration.epipolar_residuals import epipolar_residuals
from metrology.calibration.observations import DeviceName
from metrology.calibration.prediction import FieldUncertainty
from metrology.rig import Device, Rig
from storage.archive.files import replacing
from storage.evidence.rig_facts import rig_facts
from storage.report.markup import table
from storage.templates import rendered

_MAP_STEP = 24  # of the distortion map, in places per longer side


_BOARDS = {None: "", "new": "as OpenCV draws it since 4.6", "old": "as OpenCV drew it before 4.6"}


def write_report(calibration: Calibration, rig: Rig, path: Path) -> None:
    """Write the report of a calibration."""
    document = rendered(
        "flows",
        "calibration.html",
        rig=rig,
        calibration=calibration,
        plotly=plotly_page.script(),
        board=_board(rig),
        board_drawn=_BOARDS[calibration.board_layout],
        reprojection=_reprojection_table(calibration),
        residuals=inline(_residuals(calibration)),
        poses=_pose_table(calibration),
        rms_by_pose=inline(_rms_by_pose(calibration)),
        coverage=inline(_coverage(calibration)),
        evidence=_evidence_table(calibration),
        distortion=inline(_distortion(calibration)),
        epipolar=inline(_epipolar(calibration)) if "right" in _devices(calibration) else "",
        field_maps=inline(_field_maps(calibration.field, rig.left)) if calibration.field else "",
        parameters=_parameter_table(calibration),
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as partial:
        partial.write_text(document, encoding="utf-8")


def _board(rig: Rig) -> str:
    facts = rig_facts(rig.extra)
    certificate = f"certificate {facts.certificate}" if facts.certificate else "no certificate stated"
    return f"{facts.board or 'not stated'}; {certificate}"


def _devices(calibration: Calibration) -> dict[DeviceName, Device]:
    return calibration.adjusted.state.devices


def _reprojection_table(calibration: Calibration) -> Markup:
    rows = [(name, f"{value:.5g}") for name, value in calibration.rms_px.items()]
    return table(("device", "RMS distance, its own pixels"), rows, [1])


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


def _colour(pose: int) -> str:
    return f"hsl({(pose * 137) % 360}, 65%, 45%)"


def _pose_table(calibration: Calibration) -> Markup:
    rows = [
        (str(use.pose), ", ".join(use.used) or "refused", str(use.features), str(use.outliers), "; ".join(use.reasons))
        for use in calibration.poses
    ]
    return table(("pose", "used", "features", "outliers", "refused because"), rows, [0, 2, 3])


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


def _evidence_table(calibration: Calibration) -> Markup:
    rows = [
        (
            e.device,
            ", ".join(e.terms) or "none",
            f"{round(e.bic, 1):.5g}",
            "" if e.p_value is None else f"{e.p_value:.2g}",
            "chosen" if e.chosen else "",
        )
        for e in calibration.evidence
    ]
    return table(("device", "distortion terms", "ΔBIC", "p", ""), rows, [2])


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


def _epipolar(calibration: Calibration) -> go.Figure:
    pixels, across = epipolar_residuals(calibration)
    limit = float(np.quantile(np.abs(across), 0.98))
    marker = {"size": 4, "color": across, "colorscale": "RdBu", "cmin": -limit, "cmax": limit, "showscale": True}
    figure = go.Figure(go.Scattergl(x=pixels[:, 0], y=pixels[:, 1], mode="markers", marker=marker))
    rms = float(np.sqrt(np.mean(across**2)))
    device = _devices(calibration)["left"]
    figure.update_yaxes(range=[device.height, 0], scaleanchor="x")
    return figure.update_layout(height=460, title=f"RMS {rms:.4f} px, right pixels, over the left image")


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


def _parameter_table(calibration: Calibration) -> Markup:
    adjusted = calibration.adjusted
    sigma = dict(zip(adjusted.names, np.sqrt(np.diag(adjusted.covariance)), strict=True))
    rows = []
    for name, device in _devices(calibration).items():
        lens = (device.K[0, 0], device.K[1, 1], device.K[0, 2], device.K[1, 2], *device.lens[:5])
        for term, value in zip(("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"), lens, strict=True):
            u95 = sigma.get(f"{name}.{term}")
            rows.append((f"{name} {term}", f"{value:.6g}", "not estimated" if u95 is None else f"± {2 * u95:.2g}"))
        if name != "left":
            for axis, value in zip(("tx", "ty", "tz"), device.t, strict=True):
                rows.append((f"{name} {axis} (mm)", f"{value:.4f}", f"± {2 * sigma[f'{name}.{axis}']:.2g}"))
    return table(("parameter", "value", "95 %"), rows)
