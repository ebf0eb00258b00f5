"""Results of a made-up inspection: a curved skin with heads and a seam as a cloud, without frames or reconstruction.

Enough to fill a store that looks real: the cloud, the picture and the tables agree with each other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.cloud import DecodedView, PixelFlag, Reconstruction
from metrology.fits import FittedRivet, FittedStation, HeadFit, SectionFit, SkinLine
from metrology.inspection import InspectionResult
from metrology.kinds import RIVET, SEAM_STATION
from metrology.overlay import draw_overlay
from metrology.results import Rivet, SceneKey, SeamStation
from metrology.rig import Device, Rig
from metrology.rivets.flushness import mean_height
from metrology.seams.gap.width import GapEdge, gap_width
from metrology.seams.skins.step import step_height
from metrology.surfaces import Frame, monomials
from metrology.tolerance import judge
from storage.panel_spec import load_panel_spec
from storage.rig import rig_document

DISTANCE_MM = 700.0
FIELD_MM = 300.0
SKIN_RADIUS_MM = 1800.0
SIGMA_Z_MM = 0.004
SEAM_X_MM, SEAM_DEPTH_MM, CHAMFER_MM = 62.0, 2.5, 0.3
STATION_STEP_MM = 4.0


@dataclass(frozen=True)
class Recipe:
    """What the made-up scene is like.

    Attributes
    ----------
    key : SceneKey
    heights_mm : tuple of float
        Of the heads, row by row; six heads to a row.
    tilt_deg : float
        Of every head, about the vertical.
    step_mm, width_mm : float
        Of the seam in its middle; both change along it.
    unmeasured : tuple of int
        Heads that could not be measured.
    rig_id, calibrated_at : str
    version : str
        Of Flushline.
    size : (width, height)
        Of the left image, pixels.
    seed : int
    warnings : tuple of str
    """

    key: SceneKey
    heights_mm: tuple[float, ...] = (0.02, -0.03, 0.01, 0.0, 0.04, -0.02, 0.0, 0.01, 0.13, 0.03, -0.01, 0.02)
    tilt_deg: float = 0.2
    step_mm: float = 0.08
    width_mm: float = 2.4
    unmeasured: tuple[int, ...] = ()
    rig_id: str = "rig-2026-11-02"
    calibrated_at: str = "2026-11-02T07:30:00Z"
    version: str = "0.1.0"
    size: tuple[int, int] = (406, 308)
    seed: int = 1
    warnings: tuple[str, ...] = ()
    seconds: Mapping[str, float] = field(
        default_factory=lambda: {
            "load": 0.31,
            "reconstruct": 0.12,
            "detect_rivets": 0.09,
            "detect_seams": 0.07,
            "measure_rivets": 0.05,
            "measure_seams": 0.11,
            "judge": 0.01,
            "overlay": 0.06,
            "total": 0.9,
        }
    )


@dataclass(frozen=True)
class _Head:
    x: float
    y: float
    radius: float
    height: float


def synthetic_result(recipe: Recipe) -> InspectionResult:
    """The inspection's result for a recipe."""
    rng = np.random.default_rng(recipe.seed)
    rig = _rig(recipe)
    heads = _heads(recipe)
    reconstruction, preview = _cloud(rig, recipe, heads, rng)
    spec = load_panel_spec()
    features = {
        RIVET.name: tuple(judge(RIVET, _rivets(rig, recipe, heads, rng), spec.limits)),
        SEAM_STATION.name: tuple(judge(SEAM_STATION, _stations(rig, recipe, rng), spec.limits)),
    }
    title = (f"{recipe.key.panel} {recipe.key.station}", f"{recipe.key.captured_at:%Y-%m-%d %H:%M}")
    return InspectionResult(
        key=recipe.key,
        reconstruction=reconstruction,
        features=features,
        overlay=draw_overlay(features, reconstruction, title),
        preview=preview,
        rig_document=rig_document(rig),
        settings={"rivets": {"reference": "quadric"}},
        config_hash=f"synthetic-{recipe.version}",
        panel_spec=dict(spec.document),
        seconds=recipe.seconds,
        warnings=recipe.warnings,
        versions={"flushline": recipe.version, "numpy": np.__version__},
        operator="M. Weber",
        epipolar_rms_px=float(rng.uniform(0.03, 0.05)),
        projector_rms_px=float(rng.uniform(0.001, 0.003)),
    )


def _rig(recipe: Recipe) -> Rig:
    width, height = recipe.size
    focal = width * DISTANCE_MM / FIELD_MM

    def device(w: int, h: int, f: float, x_mm: float) -> Device:
        K = np.array([[f, 0, (w - 1) / 2], [0, f, (h - 1) / 2], [0, 0, 1]])
        return Device(w, h, K, np.zeros(5), np.eye(3), np.array([-x_mm, 0.0, 0.0]))

    return Rig(
        recipe.rig_id,
        recipe.calibrated_at,
        device(width, height, focal, 0.0),
        device(width, height, focal, 150.0),
        device(1280, 800, 1280 * DISTANCE_MM / FIELD_MM, 75.0),
    )


def _heads(recipe: Recipe) -> list[_Head]:
    sizes = (4.5, 4.5, 3.5)
    return [
        _Head(-110.0 + 26.0 * (i % 6), -70.0 + 36.0 * (i // 6), sizes[(i // 6) % 3], h)
        for i, h in enumerate(recipe.heights_mm)
    ]


def _skin(x: Array, y: Array) -> Array:
    return np.asarray(DISTANCE_MM + x**2 / (2 * SKIN_RADIUS_MM) + 0.05 * y)


def _step(recipe: Recipe, y: Array | float) -> Array:
    return np.asarray(recipe.step_mm * (1 + 0.5 * np.sin(np.asarray(y, float) / 40)))


def _width(recipe: Recipe, y: Array | float) -> Array:
    return np.asarray(recipe.width_mm * (1 + 0.04 * np.cos(np.asarray(y, float) / 30)))


def _relief(x: Array, y: Array, recipe: Recipe, heads: list[_Head]) -> Array:
    """Height above the skin, mm."""
    half = _width(recipe, y) / 2
    across = np.abs(x - SEAM_X_MM)
    relief = np.where(x > SEAM_X_MM, _step(recipe, y), 0.0)
    relief = relief - np.clip((half + CHAMFER_MM - across) / CHAMFER_MM, 0, 1) * CHAMFER_MM
    relief = np.where(across < half, -SEAM_DEPTH_MM, relief)
    for head in heads:
        inside = (x - head.x) ** 2 + (y - head.y) ** 2 < head.radius**2
        tilted = head.height + np.tan(np.radians(recipe.tilt_deg)) * (x - head.x)
        relief = np.where(inside, tilted, relief)
    return np.asarray(relief)


def _cloud(
    rig: Rig, recipe: Recipe, heads: list[_Head], rng: np.random.Generator
) -> tuple[Reconstruction, NDArray[np.uint8]]:
    width, height = recipe.size
    v, u = np.mgrid[:height, :width].astype(float)
    K = rig.left.K
    a, b = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]
    z = np.full((height, width), DISTANCE_MM)
    for _ in range(4):
        z = _skin(a * z, b * z)
    x, y = a * z, b * z
    z = z - _relief(x, y, recipe, heads)
    z = z + rng.normal(0, SIGMA_Z_MM, z.shape)
    in_groove = np.abs(x - SEAM_X_MM) < _width(recipe, y) / 2
    rim = np.zeros_like(in_groove)
    for head in heads:
        rim |= np.abs(np.hypot(x - head.x, y - head.y) - head.radius) < 0.4
    missing = (in_groove & (rng.random(z.shape) < 0.7)) | (rng.random(z.shape) < 0.002) | (u < width * 0.02)
    flags = np.where(missing, PixelFlag.UNMATCHED, 0) | np.where(rim | in_groove, PixelFlag.EDGE, 0)
    points = np.stack([a * z, b * z, z], axis=-1).astype(np.float32)
    points[missing] = np.nan
    sigma = np.where(missing, np.float32(np.nan), np.float32(SIGMA_Z_MM))
    blank = np.zeros((height, width), np.float32)
    view = DecodedView(blank, blank, blank, blank, flags.astype(np.uint16))
    grain = rng.normal(0, 1, (height, 1)) + rng.normal(0, 1.5, (height, width))
    texture = 150 - 35 * (a**2 + b**2) / (a**2 + b**2).max() + 3 * grain
    texture = np.where(rim, texture - 55, np.where(in_groove, 40 + 2 * grain, texture))
    preview = np.clip(texture, 0, 255).astype(np.uint8)
    return Reconstruction(rig, view, view, points, sigma, flags.astype(np.uint16)), preview


def _place(point: Array) -> dict[str, float]:
    return dict(zip(("x_mm", "y_mm", "z_mm"), point.tolist(), strict=True))


def _rivets(rig: Rig, recipe: Recipe, heads: list[_Head], rng: np.random.Generator) -> list[Rivet]:
    rivets = []
    for i, head in enumerate(heads):
        centre = np.array([head.x, head.y, float(_skin(np.array(head.x), np.array(head.y))) - head.height])
        turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        rim = centre + np.stack([head.radius * np.cos(turn), head.radius * np.sin(turn), 0 * turn], axis=-1)
        pixels = rig.left.project(rim)
        (u, v), (major, minor) = rig.left.project(centre), np.ptp(pixels, axis=0)
        right = rig.right.project(centre)
        rivet = FittedRivet(
            f"R{i + 1:02d}",
            **_place(centre),
            u_px=float(u),
            v_px=float(v),
            u_right_px=float(right[0]),
            v_right_px=float(right[1]),
            diameter_mm=2 * head.radius + float(rng.normal(0, 0.02)),
            major_px=float(max(major, minor)),
            minor_px=float(min(major, minor)),
            angle_deg=0.0,
            confidence=0.97,
        )
        if i in recipe.unmeasured:
            rivets.append(replace(rivet, reason="skin: points in 5 of 12 directions, at least 7 needed"))
            continue
        fit = _head_fit(head, head.height + float(rng.normal(0, 0.001)), recipe)
        height = mean_height(fit.head, fit.skin, fit.x, fit.y, fit.radius)
        rise = head.radius * np.tan(np.radians(recipe.tilt_deg))
        rivets.append(
            replace(
                rivet,
                height_mean_mm=height,
                height_min_mm=height - rise,
                height_max_mm=height + rise,
                height_u95_mm=0.003,
                tilt_deg=recipe.tilt_deg + float(rng.normal(0, 0.02)),
                tilt_u95_deg=0.06,
                crown_mm=0.001,
                n_inner=420,
                n_outer=980,
                rms_inner_mm=0.0041,
                rms_outer_mm=0.0042,
                zone="default",
                fit=fit,
            )
        )
    return rivets


def _skin_at(x: float, y: float, reach: float) -> tuple[Frame, Array]:
    """A frame on the skin with h along its normal, and the skin's coefficients in it."""
    slope = np.array([x / SKIN_RADIUS_MM, 0.05, -1.0])
    frame = Frame.on_plane([x, y, float(_skin(np.array(x), np.array(y)))], slope)
    near = np.mgrid[-1:1:9j, -1:1:9j].reshape(2, -1) * reach + np.array([[x], [y]])
    local = frame.local(np.stack([*near, _skin(*near)], axis=-1))
    return frame, np.linalg.lstsq(monomials(local[:, 0], local[:, 1], 2), local[:, 2], rcond=None)[0]


def _head_fit(head: _Head, height: float, recipe: Recipe) -> HeadFit:
    """The made-up head's plane over the skin."""
    frame, skin = _skin_at(head.x, head.y, 3 * head.radius)
    above = height * float(np.hypot(1, np.hypot(*skin[1:3])))
    plane = skin[:3] + np.array([above, np.tan(np.radians(recipe.tilt_deg)), 0.0])
    r = head.radius
    return HeadFit(frame, skin, plane, 0.0, 0.0, r, 0.8 * r, (1.2 * r, max(3 * r, r + 4)))


def _section_fit(y: float, step: float, width: float) -> SectionFit:
    """The made-up seam's skin lines and edges."""
    surface, skin = _skin_at(SEAM_X_MM, y, 14.0)
    across, h = surface.axes[0], surface.axes[2]
    frame = Frame(surface.origin, np.stack([across, np.cross(h, across), h]))
    a = skin[[0, 1, 3]]
    lines = SkinLine(a, 640), SkinLine(a + np.array([step, 0.0, 0.0]), 655)
    half, depths = width / 2, (CHAMFER_MM, CHAMFER_MM)
    return SectionFit(frame, *lines, (-half, half), depths, half + 0.8, half + 14.8, 2.0)


def _stations(rig: Rig, recipe: Recipe, rng: np.random.Generator) -> list[SeamStation]:
    stations = []
    reach = FIELD_MM * recipe.size[1] / recipe.size[0] / 2 - 8
    for y in np.arange(-reach, reach, STATION_STEP_MM):
        step, width = float(_step(recipe, y)), float(_width(recipe, y))
        fit = _section_fit(y, step + float(rng.normal(0, 0.002)), width + float(rng.normal(0, 0.006)))
        edges = (GapEdge(x, CHAMFER_MM) for x in fit.edges_mm)
        middle = np.array([SEAM_X_MM, y, float(_skin(np.array(SEAM_X_MM), np.array(y))) - step / 2])
        u, v = rig.left.project(middle)
        stations.append(
            FittedStation(
                "M1",
                float(y + reach),
                **_place(middle),
                u_px=float(u),
                v_px=float(v),
                step_mm=step_height(fit, *fit.edges_mm),
                step_u95_mm=0.005,
                width_mm=gap_width(fit, *edges),
                width_u95_mm=0.02,
                n_left=640,
                n_right=655,
                zone="default",
                fit=fit,
            )
        )
    return stations
