"""From several wrapped phases to the fringe order: the lattice of wrap counts, and the paper's heterodyne.

A projector position ξ in [0, 1) gives the phases ``q = ξ f − k`` in turns, with f the fringe counts and k whole
numbers.
Points of equal k lie on parallel lines along f: seen along f they are the points of a lattice, the whole numbers'
lattice projected orthogonally to f. With equal noise on all phases the most likely k is the nearest lattice point, and
how far the lattice points lie apart is the code's whole margin against slips of the fringe order.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise, product
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc, erfcinv

from metrology.errors import SceneError

Unwrapping = Literal["ml", "heterodyne"]

# Lovász's constant; 3/4 is the usual one, closer to 1 reduces further.
_LOVASZ = 0.99


@dataclass(frozen=True)
class OrderLattice:
    """The wrap-count lattice of a set of n fringe counts, seen along the count vector."""

    counts: NDArray[np.float64]
    """(n,) of float."""
    basis: NDArray[np.float64]
    """(n, n − 1) of whole numbers as float: wrap-count vectors that, with `counts`, generate all whole-number vectors,
    and whose projections are reduced."""
    to_lattice: NDArray[np.float64]
    """(n − 1, n): lattice coordinates of a vector of wrapped phases in turns."""
    gram: NDArray[np.float64]
    """(n − 1, n − 1): scalar products of the projected basis, turns²."""
    shortest: float
    """Least distance between lattice points, turns."""


def largest_sigma(shortest: float, slip_probability: float) -> float:
    """Phase noise (rad, each count) at which about `slip_probability` of all orders are wrong.

    A slip along the shortest vector, `shortest` turns long, needs a deviation of half its length; it can go either way.
    """
    if not np.isfinite(shortest):
        return np.inf
    return float(np.pi * shortest / (np.sqrt(2) * erfcinv(slip_probability)))


def slip_probability(shortest: float, sigma: float) -> float:
    """Share of wrong orders, about, at a phase noise of `sigma` rad in each count; the inverse of `largest_sigma`."""
    return float(erfc(np.pi * shortest / (np.sqrt(2) * sigma)))


@lru_cache(maxsize=32)
def order_lattice(counts: tuple[int, ...]) -> OrderLattice:
    """The lattice of a set of fringe counts without a common factor."""
    f = np.array(counts, float)
    n = f.size
    if np.gcd.reduce(counts) != 1:
        raise SceneError(f"fringe counts: found {list(counts)} with a common factor, expected none")
    if n == 1:
        return OrderLattice(f, np.zeros((1, 0)), np.zeros((0, 1)), np.zeros((0, 0)), np.inf)
    projector = np.eye(n) - np.outer(f, f) / (f @ f)
    basis = _reduce(_completion(counts), projector)
    projected = projector @ basis
    gram = projected.T @ projected
    return OrderLattice(f, basis, np.linalg.pinv(projected), gram, _shortest(gram))


def _completion(counts: tuple[int, ...]) -> NDArray[np.float64]:
    """(n, n − 1) whole-number columns that generate, together with the count vector, all whole-number vectors.

    Unimodular row operations bring the count vector to (1, 0, …, 0) (Euclid's algorithm); the columns of the inverse
    are the wanted basis, the first one being the count vector itself.
    """
    n = len(counts)
    rest = list(counts)
    inverse = [[int(i == j) for j in range(n)] for i in range(n)]
    while sum(value != 0 for value in rest) > 1:
        small = min((i for i in range(n) if rest[i]), key=lambda i: rest[i])
        for i in range(n):
            if i != small and rest[i]:
                quotient = rest[i] // rest[small]
                rest[i] -= quotient * rest[small]
                for row in inverse:
                    row[small] += quotient * row[i]
    unit = next(i for i in range(n) if rest[i])
    return np.array([[row[j] for j in range(n) if j != unit] for row in inverse], float)


def _reduce(basis: NDArray[np.float64], projector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lenstra-Lenstra-Lovász reduction of the projected basis; the whole-number columns follow along."""
    columns = basis.copy()
    m = columns.shape[1]
    k = 1
    while k < m:
        for j in range(k - 1, -1, -1):
            _, mu = _gram_schmidt(projector @ columns)
            columns[:, k] -= np.rint(mu[k, j]) * columns[:, j]
        orthogonal, mu = _gram_schmidt(projector @ columns)
        length = (orthogonal**2).sum(0)
        if length[k] >= (_LOVASZ - mu[k, k - 1] ** 2) * length[k - 1]:
            k += 1
        else:
            columns[:, [k - 1, k]] = columns[:, [k, k - 1]]
            k = max(k - 1, 1)
    return columns


def _gram_schmidt(vectors: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Orthogonalised columns, and mu[i, j] = what column i holds of orthogonal column j."""
    orthogonal = vectors.copy()
    m = vectors.shape[1]
    mu = np.eye(m)
    for i in range(m):
        for j in range(i):
            mu[i, j] = vectors[:, i] @ orthogonal[:, j] / (orthogonal[:, j] @ orthogonal[:, j])
            orthogonal[:, i] -= mu[i, j] * orthogonal[:, j]
    return orthogonal, mu


def _shortest(gram: NDArray[np.float64]) -> float:
    """Length of the shortest vector, searched among small combinations of the reduced basis."""
    reach = 3 if gram.shape[0] <= 3 else 1
    combinations = np.array([c for c in product(range(-reach, reach + 1), repeat=gram.shape[0]) if any(c)], float)
    return float(np.sqrt(np.einsum("ci,ij,cj->c", combinations, gram, combinations).min()))


def nearest_lattice_point(
    turns: NDArray[np.float64], lattice: OrderLattice
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Common position of wrapped phases, by the nearest wrap-count lattice point, and what they miss it by.

    Parameters
    ----------
    turns : (counts, n) ndarray
        Wrapped phases, turns.

    Returns
    -------
    position : (n,) ndarray
        In [0, 1).
    off : (counts, n) ndarray
        Phases less those of the position, turns.
    """
    coordinates = lattice.to_lattice @ turns
    rest = coordinates - np.rint(coordinates)
    aside = rest - np.where(rest >= 0, 1.0, -1.0)
    best = np.full(turns.shape[1], np.inf)
    nearest = rest
    for corner in product((False, True), repeat=len(rest)):
        point = np.where(np.array(corner)[:, None], aside, rest)
        distance = (point * (lattice.gram @ point)).sum(0)
        nearest = np.where(distance < best, point, nearest)
        best = np.minimum(best, distance)
    unwrapped = turns - lattice.basis @ np.rint(coordinates - nearest)
    position = (lattice.counts / (lattice.counts @ lattice.counts)) @ unwrapped
    return position % 1, unwrapped - np.outer(lattice.counts, position)


def heterodyne_beats(counts: tuple[int, ...]) -> NDArray[np.float64]:
    """First count of every level of successive differences, from the counts' own first one down to a single fringe.

    The heterodyne beats neighbouring counts against each other until one fringe is left: 70, 64, 59 → 6, 5 → 1, with
    the levels' first entries 70, 6, 1; 37, 36, 35 → 1, 1, with 37, 1.

    Raises
    ------
    SceneError
        Where the counts do not come down to one fringe.
    """
    level = list(counts)
    firsts = [level[0]]
    while len(level) > 1 and abs(firsts[-1]) != 1:
        level = [a - b for a, b in pairwise(level)]
        firsts.append(level[0])
    if abs(firsts[-1]) != 1 or 0 in firsts:
        raise SceneError(
            f"fringe counts: found {list(counts)}, whose beats end in {firsts[-1]} fringes; the heterodyne expects 1 "
            "(unwrapping 'ml' takes any counts without a common factor)"
        )
    return np.array(firsts, float)
