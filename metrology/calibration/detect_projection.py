"""Projected dots on the printed board (paper §5.2, steps 1 and 3).

The ratio (dots − dark) / (white − dark) removes the print, the board's shading and the room's light: what is left is
the projected image alone. The larger markers tell which dot is which where only a part of the grid falls on the board.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array
from metrology.calibration.blobs import Contour, elliptic_outlines
from metrology.calibration.dot_edge import DotFit, fit_dot
from metrology.calibration.frames import BoardFrames
from metrology.calibration.homography import fit_homography, inside_gate, unit_area
from metrology.calibration.lattice import Labels, diagonal_to_grid, label_lattice, turned
from metrology.calibration.projected_dots import ProjectedDots
from metrology.errors import CalibrationError

_LIT = 0.3  # of the brightest level: darker is print, or not the board
_GUARD_PX = 3  # kept off the edge of the print, where the blur of the two frames differs
_SMOOTH_PX = 1.5
_LEAST_RIM = 0.7
_LARGEST_SIGMA_PX = 0.06
_LEAST_DOTS = 12
_CONTRADICTIONS = 2  # blobs that are no dots, or a dot half hidden
_SIZE_TOLERANCE = 0.15


@dataclass(frozen=True)
class ProjectionView:
    """Projected dots that one camera found."""

    index: NDArray[np.intp]
    """(n,) int array: which dots (rows of `ProjectedDots.centres`)."""
    pixels: Array
    sigma_px: Array
    """pixels, sigma_px: (n, 2) and (n,): ellipse centres in raw camera pixels (perspective eccentricity still in them)
    and their standard deviations."""


def detect_projected_dots(frames: BoardFrames, pattern: ProjectedDots) -> ProjectionView:
    """Find and identify the projected dots; CalibrationError says why they cannot be told."""
    if frames.dots is None:
        raise CalibrationError("there is no frame with projected dots")
    outlines = _outlines(frames)
    if len(outlines) < _LEAST_DOTS:
        raise CalibrationError(f"found {len(outlines)} projected dots on the board, expected at least {_LEAST_DOTS}")
    ellipses = [cv2.fitEllipse(outline) for outline in outlines]
    centres = np.array([centre for centre, _, _ in ellipses])
    found, labels = label_lattice(centres)
    if len(found) < _LEAST_DOTS:
        raise CalibrationError(
            f"found {len(outlines)} projected dots of which {len(found)} lie on a grid, expected at least {_LEAST_DOTS}"
        )
    places = diagonal_to_grid(labels)
    areas = np.array([np.pi / 4 * axes[0] * axes[1] for _, axes, _ in ellipses])
    index = _identify(places, _relative_areas(places, centres[found], areas[found]), pattern)
    return _measure(frames, [outlines[k] for k in found], index, pattern)


def _outlines(frames: BoardFrames) -> list[Contour]:
    lit, light = frames.lit, _light(frames)
    blurred_lit = cv2.GaussianBlur(lit, (0, 0), _SMOOTH_PX)
    blurred_light = cv2.GaussianBlur(light, (0, 0), _SMOOTH_PX)
    # Print reflects some light, too: enough to see where a dot is, not enough to see where its edge is.
    on_board = blurred_lit > max(0.02 * np.quantile(lit, 0.99), 2.0)
    return elliptic_outlines((blurred_light > 0.5 * blurred_lit) & on_board)


def _light(frames: BoardFrames) -> Array:
    """The projected dots' light alone: dots minus dark."""
    dots = np.asarray(frames.dots, float)
    return dots if frames.dark is None else dots - frames.dark


def _measure(
    frames: BoardFrames, outlines: list[Contour], index: NDArray[np.intp], pattern: ProjectedDots
) -> ProjectionView:
    """Fit the edges of the dots that fall on paper, and keep those of the right size in the right place."""
    lit = frames.lit
    brightest = np.quantile(lit, 0.99)
    paper = (lit > _LIT * brightest) & ~frames.saturated
    guarded = cv2.erode(paper.astype(np.uint8), np.ones((2 * _GUARD_PX + 1,) * 2, np.uint8)) > 0
    ratio = _light(frames) / np.maximum(lit, 1.0)
    # The ratio's noise is the camera's divided by the light that fell on the pixel.
    weight = np.where(guarded, np.square(lit / brightest), 0.0)
    fits, dots = [], []
    for outline, dot in zip(outlines, index, strict=True):
        fit = fit_dot(ratio, weight, outline)
        if fit is not None and fit.rim_fraction > _LEAST_RIM and fit.sigma_px < _LARGEST_SIGMA_PX:
            fits.append(fit)
            dots.append(dot)
    if len(fits) < _LEAST_DOTS:
        raise CalibrationError(
            f"found {len(outlines)} projected dots of which {len(fits)} fall clear of the print, "
            f"expected at least {_LEAST_DOTS}"
        )
    return _consistent(np.array(dots, np.intp), fits, pattern)


def _relative_areas(places: Labels, centres: Array, areas: Array) -> Array:
    """Areas of dots over the square of the grid's spacing, both as seen at the dot's place."""
    return np.asarray(areas / unit_area(fit_homography(places, centres), places))


def _identify(places: Labels, sizes: Array, pattern: ProjectedDots) -> NDArray[np.intp]:
    """(n,) dot of the pattern for every place, from the markers among them.

    A numbering contradicts a dot that is large where the pattern has none, small where it has a marker, or off the
    pattern. The numbering with the fewest contradictions is taken if it is the only one and has few.
    """
    relative = np.pi * np.square(np.array([pattern.diameter_px, pattern.marker_diameter_px]) / 2 / pattern.spacing_px)
    large = sizes > np.sqrt(relative[0] * relative[1])
    if not large.any():
        raise CalibrationError("none of the pattern's larger markers is on the board: no telling which dot is which")
    dot = {(int(x), int(y)): k for k, (x, y) in enumerate(pattern.grid)}
    is_marker, markers = pattern.is_marker, pattern.grid[pattern.is_marker]
    answers: dict[tuple[int, ...], int] = {}
    for turn in range(4):
        candidate = turned(places, turn)
        for seen in candidate[large]:
            for marker in markers:
                index = np.array([dot.get((int(x), int(y)), -1) for x, y in candidate - seen + marker])
                contradictions = int(np.count_nonzero((index < 0) | (is_marker[index] != large)))
                answers[tuple(int(k) for k in index)] = contradictions
    fewest = min(answers.values())
    best = [answer for answer, count in answers.items() if count == fewest]
    if fewest > _CONTRADICTIONS or len(best) > 1:
        what = "do not stand as in the pattern" if len(best) == 1 else "leave more than one way to number the dots"
        raise CalibrationError(
            f"the {large.sum()} larger markers found {what}, expected {len(markers)} in their places"
        )
    return np.array(best[0], np.intp)


def _consistent(index: NDArray[np.intp], fits: list[DotFit], pattern: ProjectedDots) -> ProjectionView:
    """Keep the dots whose place and size are those of a plane's image of the pattern."""
    fits, index = [fit for fit, k in zip(fits, index, strict=True) if k >= 0], index[index >= 0]
    pixels = np.array([fit.centre for fit in fits])
    in_place = inside_gate(fit_homography(pattern.centres[index], pixels), pattern.centres[index], pixels)
    sizes = _relative_areas(pattern.grid[index], pixels, np.array([fit.area for fit in fits]))
    expected = np.pi * np.square(pattern.radii[index] / pattern.spacing_px)
    # All discs may look a little wider or narrower than drawn (blur, the projector's response), all alike.
    scale = np.median(sizes / expected)
    keep = in_place & (np.abs(sizes / (scale * expected) - 1) < _SIZE_TOLERANCE)
    if keep.sum() < _LEAST_DOTS:
        raise CalibrationError(f"found {keep.sum()} projected dots in place, expected at least {_LEAST_DOTS}")
    return ProjectionView(index[keep], pixels[keep], np.array([fit.sigma_px for fit in fits])[keep])
