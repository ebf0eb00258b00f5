"""Ridge points, the arcs they link to, and the votes arcs cast for circle centres (paper §3.1).

An arc is a chain of ridge points followed from neighbour to neighbour. Its local curvature, with its uncertainty,
says how far away and on which side the centre may lie; straight chains (seams, long scratches) have none in range
and cast no votes, so only the neighbourhoods of suspects are voted in and the image is never traversed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Array, Float32
from metrology.jit import kernel
from metrology.ridges import Derivatives, gaussian_derivatives
from metrology.robust import MAD


@dataclass(frozen=True)
class Arcs:
    """Ridge points in the order of their chains."""

    u: Array
    v: Array
    """u, v: (n,) float64: sub-pixel position."""
    nu: Array
    nv: Array
    """nu, nv: (n,) float64: unit normal, from the chain where it is long enough, else from the image."""
    curvature: Array
    curvature_sd: Array
    """curvature, curvature_sd: (n,) float64: 1/px towards (nu, nv), and its standard deviation."""
    chain: NDArray[np.int64]
    """(n,) int64: number of the chain, ascending."""
    strength: Array
    """(n,) float64: ridge response in units of its noise."""

    def stronger(self, least: float) -> Arcs:
        """The points of at least this strength."""
        keep = self.strength >= least
        return Arcs(**{name: values[keep] for name, values in vars(self).items()})


def curvature_noise(guu: Float32, gvv: Float32, blocks: int = 14) -> Float32:
    """Local standard deviation of the second derivatives, (h, w) float32.

    The median of |guu| and |gvv| in blocks, `blocks` along the longer side: sensor noise and grain of the metal
    count, rings, seams and scratches are too thin to move it. Blocks without contrast (clipped) get a share of the
    typical noise instead of 0.
    """
    height, width = guu.shape
    side = max(1, max(height, width) // blocks)
    rows, columns = max(1, height // side), max(1, width // side)
    down, across = height // rows, width // columns

    def medians(values: Float32) -> Float32:
        cells = values[: rows * down, : columns * across].reshape(rows, down, columns, across)[:, ::3, :, ::3]
        return np.median(np.abs(cells).transpose(0, 2, 1, 3).reshape(rows, columns, -1), axis=2)

    grid = (MAD * np.sqrt(0.5 * (medians(guu) ** 2 + medians(gvv) ** 2))).astype(np.float32)
    floor = 0.2 * float(np.median(grid[grid > 0])) if (grid > 0).any() else 1.0
    return cv2.resize(np.maximum(grid, floor), (width, height), interpolation=cv2.INTER_LINEAR)


@kernel
def _ridge_points(gu, gv, guu, guv, gvv, noise, polarity, threshold, index, out):  # type: ignore[no-untyped-def]
    """Steger's ridge points: where the profile across the ridge has its extremum within the pixel."""
    height, width = guu.shape
    n = 0
    for y in range(1, height - 1):
        for x in range(1, width - 1):
            index[y, x] = -1
            a = guu[y, x] * polarity
            b = guv[y, x] * polarity
            c = gvv[y, x] * polarity
            half = math.sqrt(0.25 * (a - c) ** 2 + b * b)
            value = 0.5 * (a + c) + half
            if value < threshold * noise[y, x] or n >= len(out):
                continue
            nx = b
            ny = value - a
            if abs(a - value) < abs(c - value):
                nx = value - c
                ny = b
            norm = math.sqrt(nx * nx + ny * ny)
            if norm < 1e-12:
                nx = 1.0
                ny = 0.0
            else:
                nx /= norm
                ny /= norm
            offset = -polarity * (gu[y, x] * nx + gv[y, x] * ny) / value
            if abs(offset * nx) <= 0.6 and abs(offset * ny) <= 0.6:
                out[n, 0] = x + offset * nx
                out[n, 1] = y + offset * ny
                out[n, 2] = nx
                out[n, 3] = ny
                out[n, 4] = value / noise[y, x]
                index[y, x] = n
                n += 1
    return n


@kernel
def _follow(points, index, taken, start, direction, path):  # type: ignore[no-untyped-def]
    """Walk from a point along its tangent; returns how many points were written to `path`."""
    height, width = index.shape
    count = 0
    at = start
    tx = -points[at, 3] * direction
    ty = points[at, 2] * direction
    while True:
        cx = round(points[at, 0])
        cy = round(points[at, 1])
        best = -1
        cost = 1e9
        for y in range(max(cy - 2, 0), min(cy + 3, height)):
            for x in range(max(cx - 2, 0), min(cx + 3, width)):
                k = index[y, x]
                if k < 0 or taken[k]:
                    continue
                dx = points[k, 0] - points[at, 0]
                dy = points[k, 1] - points[at, 1]
                along = dx * tx + dy * ty
                if along < 0.3:
                    continue
                across = abs(dx * ty - dy * tx)
                turn = abs(-points[k, 3] * tx + points[k, 2] * ty)
                if turn < 0.75 or across > 0.6 * along + 0.4:
                    continue
                this = along + 2.0 * across + 2.0 * (1.0 - turn)
                if this < cost:
                    cost = this
                    best = k
        if best < 0:
            return count
        sign = 1.0 if -points[best, 3] * tx + points[best, 2] * ty > 0.0 else -1.0
        tx = -points[best, 3] * sign
        ty = points[best, 2] * sign
        taken[best] = True
        path[count] = best
        count += 1
        at = best


@kernel
def _link(points, index, high, order, chain):  # type: ignore[no-untyped-def]
    """Chains from every point of at least `high` strength; fills `order` and `chain`, returns the number of points."""
    n = len(points)
    taken = np.zeros(n, np.bool_)
    ahead = np.empty(n, np.int64)
    behind = np.empty(n, np.int64)
    total = 0
    number = 0
    for i in range(n):
        if taken[i] or points[i, 4] < high:
            continue
        taken[i] = True
        na = _follow(points, index, taken, i, 1.0, ahead)
        nb = _follow(points, index, taken, i, -1.0, behind)
        for k in range(nb):
            order[total] = behind[nb - 1 - k]
            chain[total] = number
            total += 1
        order[total] = i
        chain[total] = number
        total += 1
        for k in range(na):
            order[total] = ahead[k]
            chain[total] = number
            total += 1
        number += 1
    return total


@kernel
def _curvatures(points, chain, window, noise, result):  # type: ignore[no-untyped-def]
    """Local circle through each chain, in the frame of the point's own normal.

    With y = a + b x + c (x² + y²) across against along, the curvature is 2c / √(1 + b²) and its variance that of c; the
    scatter across is at least `noise` pixels. No parabola: on the smallest heads the window is half a turn. Points
    whose chain is too short keep their own normal and an unknown curvature. result: nu, nv, curvature, sd.
    """
    n = len(points)
    for i in range(n):
        nx = points[i, 2]
        ny = points[i, 3]
        lo = max(0, i - window)
        hi = min(n, i + window + 1)
        while chain[lo] != chain[i]:
            lo += 1
        while chain[hi - 1] != chain[i]:
            hi -= 1
        result[i, 0] = nx
        result[i, 1] = ny
        result[i, 2] = 0.0
        result[i, 3] = 1e3
        if hi - lo < 5:
            continue
        s0 = 0.0
        s1 = 0.0
        s2 = 0.0
        w0 = 0.0
        w1 = 0.0
        w2 = 0.0
        t0 = 0.0
        t1 = 0.0
        t2 = 0.0
        for k in range(lo, hi):
            dx = points[k, 0] - points[i, 0]
            dy = points[k, 1] - points[i, 1]
            x = -dx * ny + dy * nx
            y = dx * nx + dy * ny
            w = x * x + y * y
            s0 += 1.0
            s1 += x
            s2 += x * x
            w0 += w
            w1 += x * w
            w2 += w * w
            t0 += y
            t1 += x * y
            t2 += w * y
        det = s0 * (s2 * w2 - w1 * w1) - s1 * (s1 * w2 - w1 * w0) + w0 * (s1 * w1 - s2 * w0)
        if det < 1e-6:
            continue
        b = (s0 * (t1 * w2 - t2 * w1) - t0 * (s1 * w2 - w1 * w0) + w0 * (s1 * t2 - t1 * w0)) / det
        c = (s0 * (s2 * t2 - t1 * w1) - s1 * (s1 * t2 - t1 * w0) + t0 * (s1 * w1 - s2 * w0)) / det
        if abs(b) > 1.0:
            continue
        norm = math.sqrt(1.0 + b * b)
        # The normal of y = a + b x at x = 0 is (-b, 1) in the frame (tangent, normal); the tangent is (-ny, nx).
        result[i, 0] = (nx + b * ny) / norm
        result[i, 1] = (ny - b * nx) / norm
        result[i, 2] = 2.0 * c / norm
        result[i, 3] = 2.0 * noise * math.sqrt((s0 * s2 - s1 * s1) / det)


@dataclass(frozen=True)
class RidgeField:
    """Derivatives of an image at one scale, and the noise of the second ones (see `curvature_noise`)."""

    derivatives: Derivatives
    noise: Float32

    @classmethod
    def of(cls, image: Float32, sigma: float) -> RidgeField:
        derivatives = gaussian_derivatives(image, sigma)
        return cls(derivatives, curvature_noise(derivatives.uu, derivatives.vv))


def trace_arcs(
    field: RidgeField, polarity: int, thresholds: tuple[float, float], window: int, position_noise: float
) -> Arcs:
    """Ridge points of one polarity, linked.

    Parameters
    ----------
    polarity : int
        +1 for dark ridges, −1 for bright ones.
    thresholds : (low, high)
        A chain starts at a ridge of `high` and goes on through those of `low`, in units of the field's noise.
    window : int
        Points to either side from which the curvature is taken.
    position_noise : float
        Standard deviation of a ridge point across the ridge, px.
    """
    shape = field.noise.shape
    index = np.full(shape, -1, np.int32)
    points = np.empty((field.noise.size // 3, 5))
    d = field.derivatives
    count = _ridge_points(d.u, d.v, d.uu, d.uv, d.vv, field.noise, float(polarity), thresholds[0], index, points)
    points = points[:count]
    order, chain = np.empty(count, np.int64), np.empty(count, np.int64)
    total = _link(points, index, thresholds[1], order, chain)
    points, chain = np.ascontiguousarray(points[order[:total]]), chain[:total]
    result = np.empty((total, 4))
    _curvatures(points, chain, window, position_noise, result)
    return Arcs(
        u=points[:, 0].copy(),
        v=points[:, 1].copy(),
        nu=result[:, 0].copy(),
        nv=result[:, 1].copy(),
        curvature=result[:, 2].copy(),
        curvature_sd=result[:, 3].copy(),
        chain=chain,
        strength=points[:, 4].copy(),
    )


@kernel
def _vote(u, v, nu, nv, curvature, spread, shape, cell, radii, plane, cells, votes):  # type: ignore[no-untyped-def]
    """Each point votes for the centres from which a circle of each radius would pass through it along its direction."""
    _, rows, columns = votes.shape
    nr = len(radii)
    for i in range(len(u)):
        gy = min(max(int(v[i] / cell), 0), shape.shape[0] - 1)
        gx = min(max(int(u[i] / cell), 0), shape.shape[1] - 1)
        p = shape[gy, gx, 0]
        q = shape[gy, gx, 1]
        w = shape[gy, gx, 2]
        # The ellipse of shape S and radius r through a point with normal n has its centre at ± r S n / sqrt(nᵀ S n).
        dx = p * nu[i] + w * nv[i]
        dy = w * nu[i] + q * nv[i]
        norm = math.sqrt(dx * nu[i] + dy * nv[i])
        dx /= norm
        dy /= norm
        for k in range(nr):
            r = radii[k]
            # Curvature of the ellipse where its normal is n: r⁻¹ (nᵀ S n)^1.5 with det S = 1.
            expected = norm**3 / r
            for side in (-1.0, 1.0):
                if abs(side * curvature[i] - expected) > 2.5 * spread[i] + 0.35 * expected:
                    continue
                x = round((u[i] + side * r * dx) / cells)
                y = round((v[i] + side * r * dy) / cells)
                if 0 <= x < columns and 0 <= y < rows:
                    votes[plane[k], y, x] += 1.0 / r


def vote_centres(
    arcs: Arcs, size: tuple[int, int], radii: Array, edges: Array, shape: Array, cell: float, least: float, most: int
) -> Array:
    """Centres that arcs agree on.

    Parameters
    ----------
    size : (height, width) of the image
    radii : (n,) ndarray
        Radii to vote for, px, at equal distances.
    edges : (k + 1,) ndarray
        Bounds of the k accumulators that the radii share.
    shape : (gy, gx, 3) ndarray
        What a circle looks like in each cell of the image: entries uu, vv, uv of the matrix S of determinant 1 whose
        ellipse it is.
    cell : float
        Size of those cells, px.
    least : float
        Support below which a peak is no candidate.
    most : int
        Candidates kept per plane.

    Returns
    -------
    (n, 3) ndarray
        u, v and radius, px.
    """
    cells = 2.0
    rows, columns = int(size[0] / cells) + 2, int(size[1] / cells) + 2
    plane = np.clip(np.searchsorted(edges, radii, side="right") - 1, 0, len(edges) - 2)
    votes = np.zeros((len(edges) - 1, rows, columns), np.float32)
    _vote(arcs.u, arcs.v, arcs.nu, arcs.nv, arcs.curvature, arcs.curvature_sd, shape, cell, radii, plane, cells, votes)
    found = []
    for k in range(len(votes)):
        if not (plane == k).any():
            continue
        radius = float(radii[plane == k].mean())
        # The peak spreads with the radius, as directions err by a few degrees.
        blur = max(0.8, 0.06 * radius)
        # A full circle gives 2π votes at the centre for its own radius, and few for the others in the plane.
        smooth = cv2.GaussianBlur(votes[k], (0, 0), blur) * (2 * np.pi * blur**2 / (2 * np.pi))
        peak = (smooth >= cv2.dilate(smooth, np.ones((5, 5), np.uint8))) & (smooth > least)
        y, x = np.divmod(np.flatnonzero(peak), columns)
        best = np.argsort(-smooth[y, x], kind="stable")[:most]
        found.append(np.column_stack([x[best] * cells, y[best] * cells, np.full(len(best), radius)]))
    return np.concatenate(found) if found else np.empty((0, 3))
