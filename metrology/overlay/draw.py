"""The overlay of one scene: rivets and seam stations through the calibrated projector (paper §5.1, Fig. 9)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from metrology.cloud import Reconstruction
from metrology.errors import UsageError
from metrology.overlay.layout import Layout
from metrology.overlay.marks import COLOURS, WORDS, Label, Stroke, circle_points, shape_marks
from metrology.overlay.paint import paint, paint_svg, text_size
from metrology.results import Rivet, SeamStation, Severity

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OverlaySettings:
    """How the overlay looks.

    Attributes
    ----------
    background : int
        Grey level of the unmarked field, 0 … 255: dim enough for the marks, bright enough to see the skin.
    text_height_mm : float
        Height of a capital letter on the skin; 4 mm reads well at 1 m.
    line_width_px : int
        Base line width in projector pixels.
    label_every_mm : float
        Distance between value labels along a seam whose verdict does not change.
    """

    background: int = 24
    text_height_mm: float = 4.0
    line_width_px: int = 2
    label_every_mm: float = 50.0

    def __post_init__(self) -> None:
        if not 0 <= self.background <= 255:
            raise UsageError(f"overlay background: found {self.background}, expected 0 … 255")
        if self.text_height_mm <= 0 or self.line_width_px < 1 or self.label_every_mm <= 0:
            raise UsageError("overlay: found a size that is not positive, expected positive sizes")


@dataclass(frozen=True)
class Overlay:
    """A finished overlay.

    Attributes
    ----------
    size : (width, height)
        The projector's, pixels.
    background : int
        Grey level.
    strokes, labels
        What is drawn, projector pixels.
    outside : tuple of str
        Ids of the rivets, and of the seams with stations, that the projector's field does not reach.
    """

    size: tuple[int, int]
    background: int
    strokes: tuple[Stroke, ...]
    labels: tuple[Label, ...]
    outside: tuple[str, ...] = field(default=())

    def image(self) -> NDArray[np.uint8]:
        """(h, w, 3) uint8 RGB at the projector's resolution."""
        return paint(self.size, self.background, self.strokes, self.labels)

    def svg(self) -> str:
        """The same as an SVG document."""
        return paint_svg(self.size, self.background, self.strokes, self.labels)


@dataclass(frozen=True)
class _Wish:
    """A label that wants a place beside its feature: the feature's centre and half size, projector pixels."""

    text: str
    anchor: Array
    reach: Array
    severity: Severity | None


def draw_overlay(
    rivets: Sequence[Rivet],
    stations: Sequence[SeamStation],
    reconstruction: Reconstruction,
    title: Sequence[str],
    settings: OverlaySettings | None = None,
) -> Overlay:
    """Draw the verdicts of one scene for the projector.

    Parameters
    ----------
    rivets, stations
        Judged results; what has no position is left out.
    reconstruction : Reconstruction
        Gives the rig, and the skin's direction around each rivet.
    title : sequence of str
        Lines above the legend: station, date.
    """
    settings = settings or OverlaySettings()
    projector = reconstruction.rig.projector
    scale, angle = _operator_frame(reconstruction)
    layout = Layout(projector.width, projector.height, angle)
    text_px = settings.text_height_mm * scale
    strokes: list[Stroke] = []
    labels: list[Label] = []
    outside: list[str] = []

    wanted: list[_Wish] = []
    for rivet in rivets:
        outline = _rim(rivet, reconstruction)
        if outline is None:
            continue
        if not projector.inside(outline).all():
            outside.append(rivet.rivet_id)
            if not projector.inside(outline.mean(0)):
                continue
        marks = shape_marks(outline, rivet.severity, settings.line_width_px)
        strokes += marks
        extent = np.concatenate([mark.points for mark in marks])
        layout.occupy(extent, settings.line_width_px)
        text = "?" if rivet.height_mean_mm is None else f"{rivet.height_mean_mm:+.2f}"
        wanted.append(_Wish(text, outline.mean(0), np.ptp(extent, axis=0) / 2, rivet.severity))

    for seam_id in dict.fromkeys(station.seam_id for station in stations):
        seam = [s for s in stations if s.seam_id == seam_id and s.x_mm is not None]
        if not seam:
            continue
        pixels = projector.project(np.array([(s.x_mm, s.y_mm, s.z_mm) for s in seam], float))
        if not projector.inside(pixels).all():
            outside.append(seam_id)
        for run in _runs(seam):
            severity = seam[run.start].severity
            reach = _BAR_END_MM[severity] * scale
            strokes += _seam_strokes(pixels[run], severity, scale, settings)
            for pixel in pixels[run]:
                layout.occupy(pixel[None], reach)
            for k in _labelled(seam, run, settings.label_every_mm):
                if projector.inside(pixels[k]):
                    wanted.append(_Wish(_seam_text(seam[k]), pixels[k], np.full(2, reach), severity))

    legend = _legend(title, layout, text_px)
    # Grave ones first: they get the best places.
    for wish in sorted(wanted, key=lambda w: _ORDER.index(w.severity)):
        place = layout.place(wish.anchor, wish.reach, text_size(wish.text, text_px))
        labels.append(Label(wish.text, place, text_px, angle, COLOURS[wish.severity]))
    return Overlay(
        (projector.width, projector.height),
        settings.background,
        tuple(strokes),
        (*labels, *legend),
        tuple(outside),
    )


# How far from a seam's middle its marks begin, and end by severity: the graver, the longer.
_BAR_START_MM = 2.5
_BAR_END_MM: dict[Severity | None, float] = {"red": 8.0, "blue": 5.5, None: 4.5, "green": 3.5}
_ORDER: tuple[Severity | None, ...] = ("red", "blue", None, "green")


def _operator_frame(reconstruction: Reconstruction) -> tuple[float, float]:
    """Projector pixels per mm on the skin, and the direction there of the left camera's +u, radians.

    The left camera's image is what the operator knows as upright.
    """
    points = reconstruction.points[reconstruction.valid]
    if len(points) == 0:
        raise UsageError("overlay: found no measured point in the scene, expected a reconstructed skin")
    middle = np.median(points, axis=0).astype(float)
    ahead = middle + np.array([1.0, 0.0, 0.0])
    start, end = reconstruction.rig.projector.project(np.stack([middle, ahead]))
    direction = end - start
    return float(np.linalg.norm(direction)), float(np.arctan2(direction[1], direction[0]))


def _rim(rivet: Rivet, reconstruction: Reconstruction) -> Array | None:
    """Outline of a rivet's head in projector pixels; None where it has no position."""
    if rivet.x_mm is None or rivet.y_mm is None or rivet.z_mm is None or rivet.diameter_mm is None:
        return None
    centre = np.array([rivet.x_mm, rivet.y_mm, rivet.z_mm])
    normal = _skin_normal(rivet, reconstruction)
    return circle_points(centre, normal, rivet.diameter_mm / 2, reconstruction.rig.projector.project)


def _skin_normal(rivet: Rivet, reconstruction: Reconstruction) -> Array:
    """(3,) direction of the skin around a rivet; the viewing direction where too few points are there."""
    reach = int(np.ceil(rivet.major_px))
    v, u = round(rivet.v_px), round(rivet.u_px)
    window = reconstruction.points[max(0, v - reach) : v + reach + 1, max(0, u - reach) : u + reach + 1].reshape(-1, 3)
    window = window[np.isfinite(window[:, 2])].astype(float)
    if len(window) < 50:
        return np.array([0.0, 0.0, -1.0])
    design = np.column_stack([window[:, :2], np.ones(len(window))])
    slope = np.linalg.lstsq(design, window[:, 2], rcond=None)[0]
    normal = np.array([slope[0], slope[1], -1.0])
    return normal / np.linalg.norm(normal)


def _runs(stations: Sequence[SeamStation]) -> list[slice]:
    """Slices of consecutive stations with the same severity."""
    cuts = [k for k in range(1, len(stations)) if stations[k].severity != stations[k - 1].severity]
    edges = [0, *cuts, len(stations)]
    return [slice(a, b) for a, b in pairwise(edges)]


def _labelled(stations: Sequence[SeamStation], run: slice, every_mm: float) -> list[int]:
    """Indices of the stations of a run that get a label: its worst, and others at a distance."""
    members = range(run.start, run.stop)
    worst = max(members, key=lambda k: (abs(stations[k].step_mm or 0.0), stations[k].width_mm or 0.0))
    chosen = [worst]
    for k in members:
        if all(abs(stations[k].s_mm - stations[c].s_mm) >= every_mm for c in chosen):
            chosen.append(k)
    return chosen


def _seam_text(station: SeamStation) -> str:
    step = "?" if station.step_mm is None else f"{station.step_mm:+.2f}"
    width = "?" if station.width_mm is None else f"{station.width_mm:.2f}"
    return f"{step} | {width}"


def _seam_strokes(pixels: Array, severity: Severity | None, scale: float, settings: OverlaySettings) -> list[Stroke]:
    """Marks of one run of stations: lines along both sides where it is in order, bars across where it is not."""
    colour, width = COLOURS[severity], settings.line_width_px
    along = np.gradient(pixels, axis=0) if len(pixels) > 1 else np.array([[0.0, 1.0]])
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    across = np.column_stack([-along[:, 1], along[:, 0]])
    start, end = _BAR_START_MM * scale, _BAR_END_MM[severity] * scale
    if severity == "green" and len(pixels) > 1:
        return [Stroke(pixels + side * start * across, colour, width) for side in (-1, 1)]
    return [
        Stroke(np.stack([p + side * start * n, p + side * end * n]), colour, width)
        for p, n in zip(pixels, across, strict=True)
        for side in (-1, 1)
    ]


def _legend(title: Sequence[str], layout: Layout, text_px: float) -> list[Label]:
    """Title lines and the key of colours, one block in a free corner."""
    height = 0.75 * text_px
    white = COLOURS[None]
    lines = [(line, white) for line in title] + [(WORDS[s], COLOURS[s]) for s in ("green", "blue", "red")]
    sizes = [text_size(text, height) for text, _ in lines]
    block = (max(w for w, _ in sizes), sum(h for _, h in sizes))
    centre = layout.place_in_corner(block, margin=8.0)
    cos, sin = np.cos(layout.angle), np.sin(layout.angle)
    labels, down = [], -block[1] / 2
    for (text, colour), (width, line_height) in zip(lines, sizes, strict=True):
        offset = np.array([(width - block[0]) / 2, down + line_height / 2])
        turned = np.array([cos * offset[0] - sin * offset[1], sin * offset[0] + cos * offset[1]])
        labels.append(Label(text, centre + turned, height, layout.angle, colour))
        down += line_height
    return labels
