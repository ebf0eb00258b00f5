"""Lap joints in the relief: edges where one sheet ends on another, however faint they are in the picture.

Over a plane 1/z is affine in the pixel, and over a bent skin nearly so. The gradient of a narrow Gaussian's mean less
that of a wide one's is nothing there, and a ridge along a step. Line points on that ridge are linked and joined as
those of the image are (`candidates`); where the step lies is found in cross-sections of 1/z.
"""

from __future__ import annotations

import cv2
import numpy as np

from metrology.arrays import Array, Float32, Mask
from metrology.cloud import Reconstruction
from metrology.ridges import ridge_points
from metrology.seams.finding.candidates import Candidate
from metrology.seams.finding.linking import link
from metrology.seams.finding.segments import join_pieces, straight_pieces
from metrology.seams.finding.strip import Strip
from metrology.seams.polyline import arc_length, interpolated, normals, polyline_length, resample, smoothest
from metrology.seams.settings import LineSettings

# The thinnest sheets are 0.3 mm; tape and paint are below this, and the skin's waves and dents climb less over a few
# pixels.
LEAST_STEP_MM = 0.2
# Every other pixel both ways tells enough. Points are averaged over cells of so many pixels each way, and only such a
# share of a cell's must be there.
_EVERY_PX, _CELL_PX = 2, 4
_LEAST_SHARE = 0.25
# Standard deviations of both Gaussians, and of the line detector on what they give, cells.
_NARROW, _WIDE, _LINE = 1.5, 3.5, 1.0
# A step of one becomes a ridge this sharp (second derivative across it): a Gaussian of the narrow mean's width.
_SHARPNESS = _NARROW / (_NARROW**2 + _LINE**2) ** 1.5
_HYSTERESIS = 0.4
_MIN_CHAIN = 6
# Cross-sections stand so far apart and reach so far; nearer to the step than the guard, points are mixed, px.
_NODE_PX, _REACH_PX, _GUARD_PX = 12.0, 20.0, 7.0
# The mean of so many rows is one cross-section.
_ROWS = 4
_FEWEST_NODES = 5


def find_step_edges(reconstruction: Reconstruction, usable: Mask, settings: LineSettings) -> list[Candidate]:
    """Where the skin may have a step, the longest and highest first.

    Parameters
    ----------
    usable : (h, w) ndarray of bool
        Pixels with a point, off the rivets.
    """
    steps, known = _step_map(reconstruction.points[..., 2], usable)
    ridges = ridge_points(steps, _LINE, _HYSTERESIS * _SHARPNESS * LEAST_STEP_MM, "bright")
    # At the border of what is known the wide mean is not.
    ridges.strength[~known] = 0.0
    generator = np.random.default_rng(settings.seed)
    tolerance = settings.straightness_px / _CELL_PX + 0.3
    pieces = [
        piece
        for chain in link(ridges, _SHARPNESS * LEAST_STEP_MM, _MIN_CHAIN)
        for piece in straight_pieces(chain, tolerance, settings.min_segment_px / _CELL_PX, generator)
    ]
    joined = join_pieces(
        pieces, settings.max_gap_px / _CELL_PX, 2.0 + tolerance, float(np.deg2rad(settings.max_bend_deg))
    )
    found = []
    for line in joined:
        points = (line[:, :2] + 0.5) * _CELL_PX - 0.5 * _EVERY_PX
        if polyline_length(points) >= settings.min_length_px:
            found.append(Candidate(points, 2.0 * _CELL_PX, float(np.median(np.abs(line[:, 2]))), dark=False))
    return sorted(found, key=lambda c: -c.response * polyline_length(c.points))


def _step_map(z: Float32, usable: Mask) -> tuple[Float32, Mask]:
    """(h/4, w/4) height of the step through each cell, mm, and where it is known."""
    size = (z.shape[1] // _CELL_PX, z.shape[0] // _CELL_PX)
    some = tuple(slice(0, n * _CELL_PX, _EVERY_PX) for n in size[::-1])
    inverse = np.zeros(usable[some].shape, np.float32)
    np.divide(1.0, z[some], out=inverse, where=usable[some])
    share = cv2.resize(usable[some].astype(np.float32), size, interpolation=cv2.INTER_AREA)
    mean = np.asarray(cv2.resize(inverse, size, interpolation=cv2.INTER_AREA), np.float32)
    known = share >= _LEAST_SHARE
    if not known.any():
        return np.zeros(known.shape, np.float32), known
    mean[known] /= share[known]
    rest = _without_plane(mean, known)
    smooth = cv2.GaussianBlur(rest, (0, 0), _NARROW) - cv2.GaussianBlur(rest, (0, 0), _WIDE)
    gain = (1.0 / _NARROW - 1.0 / _WIDE) / np.sqrt(2.0 * np.pi) * float(np.median(mean[known])) ** 2
    return np.asarray(np.hypot(*np.gradient(smooth)) / gain, np.float32), known


def _without_plane(mean: Float32, known: Mask) -> Float32:
    """What 1/z has beyond its plane; places without points get the nearest one's."""
    v, u = np.mgrid[: mean.shape[0], : mean.shape[1]].astype(np.float32)
    design = np.stack([np.ones(int(known.sum()), np.float32), u[known], v[known]], axis=1)
    plane = np.linalg.solve(design.T @ design.astype(float), design.T @ mean[known].astype(float))
    rest = mean - np.asarray(plane[0] + plane[1] * u + plane[2] * v, np.float32)
    unknown = np.asarray(~known, np.uint8)
    _, labels = cv2.distanceTransformWithLabels(unknown, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)
    values = np.zeros(int(labels.max()) + 1, np.float32)
    values[labels[known]] = rest[known]
    return np.asarray(values[labels], np.float32)


def step_course(points: Array, reconstruction: Reconstruction, usable: Mask) -> Array | None:
    """(n, 2) where the step lies along a candidate, about every pixel, as far as both sides have points; None if
    nowhere.

    In a cross-section 1/z is a straight line on each side; with x_0 where it steps from one to the other, the sum of
    what it is beyond the first line is the step times what lies beyond x_0, whatever blur makes of it in between.
    """
    strip = Strip.along(resample(points, _NODE_PX), _REACH_PX, _NODE_PX / _ROWS)
    count = len(strip.line) // _ROWS
    if count < _FEWEST_NODES:
        return None
    strip = strip.rows(np.arange(count * _ROWS))
    rows, columns, inside = strip.pixels(usable.shape)
    there = inside & usable[rows, columns]
    inverse = np.zeros(there.shape)
    np.divide(1.0, reconstruction.points[rows, columns, 2], out=inverse, where=there)
    weights = there.reshape(count, _ROWS, -1).sum(axis=1).astype(float)
    sections = inverse.reshape(count, _ROWS, -1).sum(axis=1) / np.maximum(weights, 1.0)
    place = np.array([_place(strip.x, *section) for section in zip(sections, weights, strict=True)])
    good = np.isfinite(place)
    if good.sum() < _FEWEST_NODES:
        return None
    nodes = strip.line.reshape(count, _ROWS, 2).mean(axis=1)
    inner = slice(int(good.argmax()), len(good) - int(good[::-1].argmax()))
    nodes, good, place = nodes[inner], good[inner], place[inner]
    stops = arc_length(nodes)
    nodes = nodes + np.interp(stops, stops[good], place[good])[:, None] * normals(nodes)
    return interpolated(smoothest(nodes, good.astype(float)), 1.0)


def _place(x: Array, inverse: Array, weights: Array) -> float:
    """Where one cross-section of 1/z steps, px; NaN where a side is missing."""
    known, a, b = weights > 0, x < -_GUARD_PX, x > _GUARD_PX
    if min((known & a).sum(), (known & b).sum()) < (_REACH_PX - _GUARD_PX) / 2:
        return np.nan
    # Both sides slope alike.
    beside = known & (a | b)
    design = np.stack([a, b, x], axis=1)[beside].astype(float)
    root = np.sqrt(weights[beside])
    at_a, at_b, slope = np.linalg.lstsq(design * root[:, None], inverse[beside] * root)[0]
    between = known & ~a & ~b
    if not between.any() or at_a == at_b:
        return np.nan
    share = float(np.mean((inverse - slope * x - at_a)[between] / (at_b - at_a)))
    half = _GUARD_PX + 0.5
    return half - 2.0 * half * share if 0.0 < share < 1.0 else np.nan
