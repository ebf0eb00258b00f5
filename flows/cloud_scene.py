"""From another scanner's cloud to a scene folder that Flushline inspects."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from metrology.camera_fit import FittedCamera, fit_camera
from metrology.errors import SceneError
from metrology.gridding import grid_points, lay_on
from metrology.results import SceneKey
from metrology.rig import Device, Rig
from storage.archive.bundle import document_hash
from storage.cloud_scene import write_cloud_scene
from storage.documents import utc_text
from storage.foreign_cloud import ForeignCloud, read_depth_map, read_foreign_cloud
from storage.frames import Frame, read_as_grey
from storage.rig import load_rig, rig_document

_DEPTH_MAPS = (".png", ".tif", ".tiff", ".npy")
# Farther off the rays of its pixels than this, a cloud is no picture's.
_MOST_PX = 2.0
_SMALLEST_MM, _LARGEST_MM = 20.0, 20_000.0


@dataclass(frozen=True)
class CloudOrder:
    """What a cloud scene is to be made of."""

    file: Path
    """Cloud or depth map."""
    picture: Path | None = None
    rig: Path | None = None
    """Its left camera took the picture."""
    intrinsics: tuple[float, ...] = ()
    """fx, fy, cx, cy and the distortion, where no rig file has them."""
    grid: tuple[int, int] | None = None
    """(int, int) or None: rows and columns, where the file does not tell them."""
    mm: float | None = None
    """What the file's unit is."""
    sigma_mm: float | None = None
    """Standard deviation of the depths."""


@dataclass(frozen=True)
class _Laid:
    """A cloud on the pixels of a picture."""

    points: NDArray[np.float32]
    picture: Frame
    device: Device
    R: NDArray[np.float64]
    t: NDArray[np.float64]
    sigma: NDArray[np.float32] | None
    said: str
    cost: str | None = None


def new_cloud_scene(folder: Path, key: SceneKey, order: CloudOrder, operator: str | None = None) -> list[str]:
    """Write the scene; returns what is to be said about the cloud."""
    given = load_rig(order.rig) if order.rig else None
    try:
        laid = _depth_map(order, given) if _is_depth_map(order) else _cloud(order, given)
    except SceneError as problem:
        known = str(problem).startswith((str(order.file), str(order.picture)))
        raise problem if known else SceneError(f"{order.file}: {problem}") from None
    rig = given or _rig_of(laid.device, key)
    source = {"file": order.file.name, "R": laid.R.tolist(), "t": laid.t.tolist()}
    source |= {"gridded": laid.cost} if laid.cost else {}
    write_cloud_scene(folder, key, rig, laid.picture, laid.points, laid.sigma, source, operator)
    there = np.isfinite(laid.points[..., 2])
    height, width = there.shape
    return [
        f"points: {there.sum():,} on a grid of {width}×{height} ({there.mean():.0%})",
        f"camera: {laid.said}",
        *([f"gridded: {laid.cost}"] if laid.cost else []),
        "σ of the points: " + ("estimated from the cloud at inspection" if laid.sigma is None else "as given"),
        "overlay: through the rig's projector" if rig.projector else
        "overlay: over the picture, since no projector is known; --rig with one calibrated to this camera makes it one",
    ]  # fmt: skip


def _is_depth_map(order: CloudOrder) -> bool:
    return order.file.suffix.lower() in _DEPTH_MAPS


def _rig_of(device: Device, key: SceneKey) -> Rig:
    """A rig of one camera, named by what it is."""
    rig = Rig("cloud", utc_text(key.captured_at), device)
    document = rig_document(rig)
    return replace(rig, id=f"cloud-{document_hash(document['cameras'])[:12]}")


def _depth_map(order: CloudOrder, given: Rig | None) -> _Laid:
    """Depths along z on the pixels of a known camera."""
    depth = read_depth_map(order.file) * (order.mm or 1.0)
    height, width = depth.shape
    device = given.left if given else _device(order.intrinsics, (width, height))
    if device is None:
        raise SceneError(f"{order.file}: found a depth map without its camera, expected --intrinsics or --rig")
    if (device.width, device.height) != (width, height):
        raise SceneError(
            f"{order.file}: found {width}×{height}, expected {device.width}×{device.height} as the rig has"
        )
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
    points = np.concatenate([device.normalized(pixels), np.ones((height, width, 1))], axis=-1) * depth[..., None]
    _check_size(order.file, points)
    picture = _picture(order, None, (height, width))
    return _Laid(
        points.astype(np.float32), picture, device, np.eye(3), np.zeros(3), _constant(order, depth), "as given"
    )


def _cloud(order: CloudOrder, given: Rig | None) -> _Laid:
    """A cloud with a grid on the pixels of its camera, one without on those of a rig's or of a made one."""
    found = read_foreign_cloud(order.file)
    mm = order.mm or found.mm
    points = found.points * mm
    _check_size(order.file, points)
    grid = order.grid or found.grid or _size_of_picture(order, len(points))
    if grid is None:
        return _without_grid(order, found, points, given)
    if grid[0] * grid[1] != len(points):
        raise SceneError(f"{order.file}: found {len(points):,} points, expected {grid[1]}×{grid[0]} as the grid has")
    laid = points.reshape(*grid, 3)
    picture = _picture(order, found, grid)
    sigma = found.sigma.reshape(grid) * mm if found.sigma is not None else _constant(order, laid[..., 2])
    if given is not None:
        _check_rays(order.file, laid, given.left)
        return _Laid(laid.astype(np.float32), picture, given.left, np.eye(3), np.zeros(3), _f32(sigma), "as given")
    camera = fit_camera(laid, _MOST_PX)
    if camera is None:
        cost = "the rows and columns are no camera's pixels (a height map?)"
        return _made_grid(points, picture.ravel(), cost)
    seen = (laid @ camera.R.T + camera.t).astype(np.float32)
    return _Laid(seen, picture, camera.device, camera.R, camera.t, _f32(sigma), _said(camera))


def _without_grid(order: CloudOrder, found: ForeignCloud, points: NDArray[np.float64], given: Rig | None) -> _Laid:
    if given is not None:
        known = points[np.isfinite(points).all(axis=1)]
        if not (known[:, 2] > 0).all():
            raise SceneError(f"{order.file}: found points behind the rig's camera, expected them in its frame")
        laid, nearest = lay_on(given.left, known)
        grid = laid.shape[0], laid.shape[1]
        of_points = None if found.grey is None else replace(found, grey=found.grey[nearest].ravel())
        cost = "points without an order were interpolated on the camera's pixels; an edge is known to a pixel"
        picture = _picture(order, of_points, grid)
        return _Laid(laid, picture, given.left, np.eye(3), np.zeros(3), None, "as given", cost)
    if found.grey is None:
        raise SceneError(
            f"{order.file}: found points without order and brightness, expected an organised cloud with --picture, "
            "or colours of the points"
        )
    return _made_grid(points, found.grey, "the points have no order")


def _made_grid(points: NDArray[np.float64], grey: NDArray, why: str) -> _Laid:
    made = grid_points(points, grey)
    cost = (
        f"{why}; laid on pixels of {made.spacing_mm:.3g} mm by planes through the nearest points: an edge is known to "
        "a pixel, and neighbouring pixels share points"
    )
    return _Laid(made.points, made.grey, made.device, made.R, made.t, None, "made to face the points", cost)


def _said(camera: FittedCamera) -> str:
    K = camera.device.K
    frame = "in its own frame" if not camera.t.any() else "with its pose"
    return f"found from the points, {frame}: f {K[0, 0]:.0f}, {K[1, 1]:.0f} px, {camera.rms_px:.2g} px off its pixels"


def _picture(order: CloudOrder, found: ForeignCloud | None, grid: tuple[int, int]) -> Frame:
    """The picture of the cloud's pixels: of its own file, or the points' brightness."""
    if order.picture is None:
        if found is None or found.grey is None:
            raise SceneError(f"{order.file}: found no brightness of the points, expected --picture")
        return found.grey.reshape(grid)
    picture = read_as_grey(order.picture, SceneError)
    if picture is None:
        raise SceneError(f"{order.picture}: found no readable picture, expected one of 8 or 16 bit")
    if picture.shape != grid:
        raise SceneError(
            f"{order.picture}: found {picture.shape[1]}×{picture.shape[0]} pixels, expected {grid[1]}×{grid[0]} as the "
            "cloud's grid has"
        )
    return picture


def _size_of_picture(order: CloudOrder, count: int) -> tuple[int, int] | None:
    """The picture's rows and columns, where there are as many points."""
    picture = read_as_grey(order.picture, SceneError) if order.picture else None
    return (picture.shape[0], picture.shape[1]) if picture is not None and picture.size == count else None


def _device(intrinsics: tuple[float, ...], size: tuple[int, int]) -> Device | None:
    if len(intrinsics) < 4:
        return None
    fx, fy, cx, cy, *lens = intrinsics
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return Device(*size, K, np.array(lens), np.eye(3), np.zeros(3))


def _constant(order: CloudOrder, depth: NDArray) -> NDArray[np.float32] | None:
    return None if order.sigma_mm is None else np.full(depth.shape, order.sigma_mm, np.float32)


def _f32(sigma: NDArray | None) -> NDArray[np.float32] | None:
    return None if sigma is None else sigma.astype(np.float32)


def _check_size(path: Path, points: NDArray) -> None:
    """Refuse a cloud in another unit."""
    known = points.reshape(-1, 3)
    known = known[np.isfinite(known).all(axis=1)]
    low, high = np.quantile(known, [0.01, 0.99], axis=0) if len(known) else (np.zeros(3), np.zeros(3))
    size = float(np.linalg.norm(high - low))
    if not _SMALLEST_MM <= size <= _LARGEST_MM:
        raise SceneError(
            f"{path}: found a cloud {size:.3g} mm across, expected {_SMALLEST_MM:g} to {_LARGEST_MM:g} mm; --unit says "
            "what the file's unit is (mm, m, or so many mm)"
        )


def _check_rays(path: Path, points: NDArray, device: Device) -> None:
    """Refuse points that do not lie on their pixels' rays."""
    some = points[::16, ::16].reshape(-1, 3)
    v, u = np.indices(points.shape[:2])[:, ::16, ::16].reshape(2, -1)
    known = np.isfinite(some[:, 2])
    off = np.linalg.norm(device.project(some[known]) - np.stack([u, v], axis=1)[known], axis=1)
    if (missed := float(np.median(off))) > _MOST_PX:
        raise SceneError(
            f"{path}: found points {missed:.3g} px off the rays of their pixels, expected them in the frame of the "
            f"rig's left camera, to {_MOST_PX:g} px"
        )
