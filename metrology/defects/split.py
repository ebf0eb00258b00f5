"""Defects whose feet run into each other: one region, several bottoms."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LEVELS = 16
_APART = 0.5  # of its depth must a bottom rise on the way to any deeper one: outlines at half depth then part


def bottoms(depth: Array, member: Mask, sure: Array, least_cells: int) -> list[Mask]:
    """Parts of a region, one for each bottom that has an outline at half depth of its own.

    Parameters
    ----------
    depth : (rows, columns) ndarray
        Smoothed, positive to the region's side, mm.
    member : (rows, columns) bool
        The region's cells.
    sure : (rows, columns) ndarray
        Depth that a cell must reach to be off the skin for certain, mm.
    least_cells : int
        Of a part at half depth.
    """
    inside = np.where(member, depth, 0.0)
    cores = np.zeros(member.shape, np.uint8)
    # From the deepest level up: a part that holds no core yet, and is deep enough over its level, is one.
    for level in np.geomspace(max(float(inside.max()), 1e-9), max(float(inside[member].min()), 1e-4), _LEVELS)[1:]:
        count, labels = cv2.connectedComponents((inside > level).astype(np.uint8), connectivity=4)
        held = np.unique(labels[cores > 0])
        for k in np.setdiff1d(np.arange(1, count), held):
            part = labels == k
            if part.sum() >= least_cells and level <= _APART * inside[part].max() and (inside > sure)[part].any():
                cores[part & (inside > _APART * inside[part].max())] = 1
    count, labels = cv2.connectedComponents(cores, connectivity=4)
    if count <= 2:
        return [member]
    _, nearest = cv2.distanceTransformWithLabels(1 - cores, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_CCOMP)
    return [member & (nearest == k) for k in np.unique(nearest[cores > 0])]
