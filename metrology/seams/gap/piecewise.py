"""The paper's own edge finding in a section's points: adaptive piecewise straight lines (§4.2, eq 5, Fig. 8).

From each end of the section the pieces are taken in turn; neighbours that meet at less than θ are merged into the skin
line (L1, L2); the piece after it is the chamfer, if the skin line is not met by the gap at once; the chamfer's inner
end
is the inflection point (D, G).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrology.arrays import Array

# A piece of fewer points is a gap between pieces, not a line.
_MIN_PIECE_POINTS = 2
# Pieces belong to one line only where they also meet: this close, in units of ε. A wall may hold no point at all, and
# then skin and floor follow each other in parallel.
_JOINT = 4.0


@dataclass(frozen=True)
class Piece:
    """A straight piece ``y = slope x + intercept`` from index `first` to `end` (exclusive) of the ordered points."""

    first: int
    end: int
    slope: float
    intercept: float

    @property
    def angle(self) -> float:
        """Direction, radians."""
        return float(np.arctan(self.slope))


@dataclass(frozen=True)
class SideFit:
    """What one side of a section shows."""

    slope: float
    intercept: float
    """slope, intercept: the skin line, L1 or L2."""
    inflection: tuple[float, float]
    """(x, y): D or G."""
    n: int
    """Points of the skin line."""


def fit_pieces(x: Array, y: Array, tolerance: float) -> list[Piece]:
    """Eq 5: as few straight pieces as keep every point within `tolerance` of its piece, split where it is missed most.

    Parameters
    ----------
    x, y : (n,) array
        x rising.
    tolerance : float
        ε, mm.
    """
    pieces = []
    waiting = [(0, len(x))]
    while waiting:
        first, end = waiting.pop()
        piece = _line(x, y, first, end)
        if end - first > 2 * _MIN_PIECE_POINTS:
            worst = _worst_corner(x, y, first, end)
            residual = np.abs(y[first:end] - piece.slope * x[first:end] - piece.intercept)
            if residual.max() > tolerance and worst is not None:
                waiting += [(worst, end), (first, worst)]
                continue
        pieces.append(piece)
    return sorted(pieces, key=lambda piece: piece.first)


def _worst_corner(x: Array, y: Array, first: int, end: int) -> int | None:
    """Where two lines instead of one fit the points best, in the sense of least squares."""
    n = end - first
    xs, ys = x[first:end] - x[first:end].mean(), y[first:end] - y[first:end].mean()
    sums = np.cumsum(np.stack([np.ones(n), xs, ys, xs * xs, xs * ys, ys * ys]), axis=1)
    splits = np.arange(_MIN_PIECE_POINTS, n - _MIN_PIECE_POINTS + 1)
    if not len(splits):
        return None
    left = sums[:, splits - 1]
    cost = _scatter(left) + _scatter(sums[:, -1:] - left)
    return first + int(splits[cost.argmin()])


def _scatter(sums: Array) -> Array:
    """Sum of squared residuals of a straight line, from the sums 1, x, y, x², xy, y²."""
    n, sx, sy, sxx, sxy, syy = sums
    xx, xy, yy = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
    return np.asarray(yy - np.where(xx > 1e-12, xy * xy / np.maximum(xx, 1e-12), 0.0))


def _line(x: Array, y: Array, first: int, end: int) -> Piece:
    xs, ys = x[first:end], y[first:end]
    spread = ((xs - xs.mean()) ** 2).sum()
    slope = float(((xs - xs.mean()) * (ys - ys.mean())).sum() / spread) if spread > 0 else 0.0
    return Piece(first, end, slope, float(ys.mean() - slope * xs.mean()))


def merge_skin(x: Array, y: Array, pieces: list[Piece], tolerance: float, angle: float) -> tuple[Piece, list[Piece]]:
    """The skin line of the first side, and the pieces that are left.

    Starting with the first piece, the next one is merged into it by least squares as long as they meet at less than
    `angle` (θ, radians).
    """
    skin, rest = pieces[0], pieces[1:]
    while rest and abs(rest[0].angle - skin.angle) < angle and _meet(x, skin, rest[0]) < _JOINT * tolerance:
        skin = _line(x, y, skin.first, rest[0].end)
        rest = rest[1:]
    return skin, rest


def _meet(x: Array, piece: Piece, following: Piece) -> float:
    """How far apart two neighbouring pieces are where one ends and the other begins."""
    place = 0.5 * (x[piece.end - 1] + x[following.first])
    return float(abs((following.slope - piece.slope) * place + following.intercept - piece.intercept))


def side_of_section(x: Array, y: Array, tolerance: float, angle: float) -> SideFit | None:
    """Skin line and inflection point of the side that begins at the section's left end; None where there is none.

    Parameters
    ----------
    x, y : (n,) array
        The whole section, x rising from the skin into the gap and beyond.
    tolerance, angle : float
        ε (mm) and θ (radians).
    """
    pieces = fit_pieces(x, y, tolerance)
    skin, rest = merge_skin(x, y, pieces, tolerance, angle)
    if not rest:
        return None
    # The chamfer falls away from the skin at a finite angle; a piece that drops into the gap is the wall.
    corner = skin.end - 1
    chamfer = rest[0]
    falls = chamfer.angle < skin.angle - angle
    if falls and _is_chamfer(x, y, chamfer, skin):
        corner = chamfer.end - 1
    return SideFit(skin.slope, skin.intercept, (float(x[corner]), float(y[corner])), skin.end - skin.first)


def _is_chamfer(x: Array, y: Array, piece: Piece, skin: Piece) -> bool:
    """Whether a piece is a chamfer: seen as a run of points, no steeper than a wall may be, and joined to the skin."""
    steep = np.tan(np.deg2rad(75.0))
    joined = abs(y[piece.first] - skin.slope * x[piece.first] - skin.intercept) < abs(
        y[piece.end - 1] - y[skin.end - 1]
    )
    return piece.end - piece.first >= _MIN_PIECE_POINTS and abs(piece.slope) < steep and joined


def project_onto(fit: SideFit) -> tuple[float, float]:
    """The ideal edge: the inflection point's projection onto the skin line."""
    px, py = fit.inflection
    t = (px + fit.slope * (py - fit.intercept)) / (1 + fit.slope**2)
    return t, fit.slope * t + fit.intercept
