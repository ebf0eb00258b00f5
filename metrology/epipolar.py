"""What stereo matching needs of a rig, once per rig: undistorted pixel maps and the epipolar plane of every pixel.

Nothing is resampled: raw pixels stay where they are and are labelled with the epipolar plane they see.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from metrology.arrays import Float32
from metrology.errors import RigError
from metrology.fringe import Axis
from metrology.jit import kernel, over_rows
from metrology.pixel_directions import pixel_directions
from metrology.rig import Device, Rig

# Share of the phase gradient that must lie along the epipolar lines for a rig and a fringe axis to fit.
_LEAST_SHARE_ALONG = 0.1
# Where many rigs are tried: undistorted pixels by a camera's size and lens, which most of them share.
_tried: ContextVar[dict[bytes, NDArray[np.float64]] | None] = ContextVar("tried", default=None)
_MOST_TRIED = 4


@dataclass(frozen=True)
class EpipolarMaps:
    """Per-pixel constants of one camera."""

    xy: Float32
    """(h, w, 2) float32: undistorted image coordinates x/z, y/z in the camera's own frame."""
    row: Float32
    """(h, w) float32: epipolar plane that the pixel lies on, as the row it would have in a rectified image pair, pixels
    from 0; the same number in both cameras for the same plane."""


@dataclass(frozen=True)
class EpipolarGeometry:
    """Both cameras' maps, and the transformation between them in the right camera's frame."""

    left: EpipolarMaps
    right: EpipolarMaps
    rows: int
    """Number of rectified rows."""
    R: NDArray[np.float64]
    t: NDArray[np.float64]
    """R, t: (3, 3) and (3,): x_right = R x_left + t, mm."""
    along: NDArray[np.float64]
    """(2,): direction of the epipolar lines in the middle of the right image, unit."""


def check_axis(rig: Rig, axis: Axis) -> None:
    """Refuse fringes that run along the rig's epipolar lines: equal coordinate would then pick out no single point.

    Looks at a plane facing the left camera where the viewing directions come closest: how much of the projector
    coordinate's change over the right image lies along the epipolar line. Without a calibrated projector only the
    points can tell.

    Raises
    ------
    RigError
    """
    if rig.projector is None:
        return
    middle = middle_of_view(rig)
    step = 1e-3 * middle[2]
    steps = np.array([[0, 0, 0], [step, 0, 0], [0, step, 0]])
    right = rig.with_right().project(middle + steps)
    coordinate = rig.projector.project(middle + steps)[:, 0 if axis == "x" else 1]
    gradient = np.linalg.solve(right[1:] - right[0], coordinate[1:] - coordinate[0])
    along = rig.with_right().project(np.stack([middle, middle * (1 + 1e-4)]))
    direction = (along[1] - along[0]) / np.linalg.norm(along[1] - along[0])
    share = abs(gradient @ direction) / np.linalg.norm(gradient)
    if share < _LEAST_SHARE_ALONG:
        other = "y" if axis == "x" else "x"
        raise RigError(
            f"fringe axis {axis!r}: found fringes along the epipolar lines of rig {rig.id!r} (share {share:.2f} of the "
            f"phase gradient across them), expected axis {other!r} or cameras side by side across the fringes"
        )


def middle_of_view(rig: Rig) -> NDArray[np.float64]:
    """(3,) point where the cameras' middle rays come closest; ten baselines ahead where they do not converge."""
    baseline = rig.with_right().centre
    rays = [
        device.rays(np.array([(device.width - 1) / 2, (device.height - 1) / 2]))
        for device in (rig.left, rig.with_right())
    ]
    design = np.column_stack([rays[0], -rays[1]])
    distances = np.linalg.lstsq(design, baseline, rcond=None)[0]
    converging = np.linalg.svd(design, compute_uv=False)[1] > 1e-3 and (distances > 0).all()
    return np.asarray(rays[0] * (distances[0] if converging else 10 * np.linalg.norm(baseline)))


def epipolar_geometry(rig: Rig) -> EpipolarGeometry:
    """Maps of a rig; kept for the last few rigs, since they depend on nothing else."""
    key = tuple(_bytes(device) for device in (rig.left, rig.with_right()))
    return _geometry(key, _Hidden(rig))


class _Hidden:
    """Carries the rig past the cache's comparison, which goes by the key alone."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig

    def __hash__(self) -> int:
        return 0

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Hidden)


def _bytes(device: Device) -> bytes:
    size = np.array([device.width, device.height], float)
    return b"".join(a.tobytes() for a in (size, device.K, device.lens, device.R, device.t))


@lru_cache(maxsize=2)
def _geometry(key: tuple[bytes, ...], hidden: _Hidden) -> EpipolarGeometry:
    rig = hidden.rig
    baseline = rig.with_right().centre / np.linalg.norm(rig.with_right().centre)
    # The plane's angle about the baseline is measured from the mean viewing direction.
    view = rig.left.R[2] + rig.with_right().R[2]
    forward = view - (view @ baseline) * baseline
    forward /= np.linalg.norm(forward)
    across = np.cross(forward, baseline)
    focal = float(np.mean([rig.left.K[0, 0], rig.left.K[1, 1]]))
    left_xy, left_row = _maps(rig.left, across, forward, focal)
    right_xy, right_row = _maps(rig.with_right(), across, forward, focal)
    lowest = min(left_row.min(), right_row.min())
    rows = int(np.ceil(max(left_row.max(), right_row.max()) - lowest)) + 1
    middle = np.array([(rig.with_right().width - 1) / 2, (rig.with_right().height - 1) / 2])
    ray = rig.with_right().rays(middle)
    ahead = rig.with_right().centre + ray * np.linalg.norm(rig.with_right().centre)
    shift = np.diff(rig.with_right().project(np.stack([ahead, ahead + 1e-3 * baseline])), axis=0)[0]
    return EpipolarGeometry(
        left=EpipolarMaps(left_xy, (left_row - lowest).astype(np.float32)),
        right=EpipolarMaps(right_xy, (right_row - lowest).astype(np.float32)),
        rows=rows,
        R=rig.with_right().R,
        t=rig.with_right().t,
        along=shift / np.linalg.norm(shift),
    )


def _maps(device: Device, across: NDArray, forward: NDArray, focal: float) -> tuple[Float32, NDArray[np.float64]]:
    """Undistorted coordinates (h, w, 2) and row (h, w) of every pixel of a camera."""
    xy = _undistorted(device)
    rounded, row = np.empty(xy.shape, np.float32), np.empty(xy.shape[:2])

    def label(first: int, end: int) -> None:
        _label_rows(xy, focal * device.R @ across, device.R @ forward, first, end, rounded, row)

    over_rows(label, device.height)
    return rounded, row


@kernel
def _label_rows(xy, across, forward, first, end, rounded, row):  # type: ignore[no-untyped-def]
    """Fill rows `first` to `end` of the rounded coordinates and of the plane that each pixel lies on."""
    for v in range(first, end):
        for u in range(xy.shape[1]):
            x, y = xy[v, u]
            rounded[v, u, 0], rounded[v, u, 1] = x, y
            row[v, u] = (x * across[0] + y * across[1] + across[2]) / (x * forward[0] + y * forward[1] + forward[2])


@contextlib.contextmanager
def trying_rigs() -> Iterator[None]:
    """Work out once what rigs share whose cameras have the same lenses, until the body ends."""
    token = _tried.set({})
    try:
        yield
    finally:
        _tried.reset(token)


def _undistorted(device: Device) -> NDArray[np.float64]:
    """(h, w, 2) x/z, y/z of every pixel of a camera; not to be written to."""
    kept = _tried.get()
    lens = np.array([device.width, device.height], float), device.K, device.lens
    key = b"".join(part.tobytes() for part in lens)
    if kept is not None and key in kept:
        return kept[key]
    xy = pixel_directions(device)
    if kept is not None:
        while len(kept) >= _MOST_TRIED:
            del kept[next(iter(kept))]
        kept[key] = xy
    return xy
