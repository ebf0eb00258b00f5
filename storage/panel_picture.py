"""Stitched pictures of panels as files of a panel's run: the picture (WebP, transparent where nothing was seen), and
the map of deviations (PNG, 16 bit: 32 768 is on the smooth skin, a step is 2 µm, 0 is no point).
"""  # fmt: skip

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from metrology.assembly.picture import Stitched
from metrology.errors import StoreError
from storage.documents import read_json

PICTURES = "pictures"
"""Where a panel run's manifest says which pictures it has."""
_QUALITY = 85
_ZERO, _STEP_MM = 32768, 0.002


def encoded(pictures: Iterable[Stitched]) -> tuple[dict[str, bytes], list[dict[str, Any]]]:
    """Files by name, and what the manifest says of them."""
    files: dict[str, bytes] = {}
    listed = []
    for each in pictures:
        names = f"picture-{each.part}.webp", f"deviation-{each.part}.png"
        files |= dict(zip(names, (webp(each.grey, each.seen), _png(each.deviation)), strict=True))
        listed.append(
            {"part": each.part, "picture": names[0], "deviation": names[1], "left_mm": each.left_mm,
             "top_mm": each.top_mm, "mm_per_px": each.mm_per_px}
        )  # fmt: skip
    return files, listed


def listed_files(listed: Sequence[Mapping[str, Any]]) -> list[str]:
    """The files that a manifest's pictures are in."""
    return [str(entry[kind]) for entry in listed for kind in ("picture", "deviation")]


def stored_pictures(file: Callable[[str], Path], manifest: str) -> dict[int, Stitched]:
    """The pictures of a stored run by the number of the part; none where it is of a version that made none.

    Parameters
    ----------
    file : callable
        Fetches a file of the store by its path there.
    manifest : str
        The run's, by its path in the store.
    """
    folder = manifest.rpartition("/")[0]
    listed = read_json(file(manifest), StoreError).get(PICTURES) or []
    return read_pictures(listed, lambda name: file(f"{folder}/{name}").read_bytes())


def read_pictures(listed: Iterable[Mapping[str, Any]], read: Callable[[str], bytes]) -> dict[int, Stitched]:
    """The pictures that a manifest lists, by the number of the part.

    Parameters
    ----------
    read : callable
        The content of a file of the run.
    """
    return {int(entry["part"]): _stitched(entry, read) for entry in listed}


def _stitched(entry: Mapping[str, Any], read: Callable[[str], bytes]) -> Stitched:
    image, steps = (_decoded(str(entry[kind]), read(str(entry[kind]))) for kind in ("picture", "deviation"))
    if image.ndim != 3 or image.shape[2] != 4 or steps.dtype != np.uint16:
        raise StoreError(f"{entry['picture']}: found other pictures, expected WebP and 16 bit PNG")
    deviation = np.where(steps == 0, np.float32(np.nan), (steps.astype(np.float32) - _ZERO) * np.float32(_STEP_MM))
    return Stitched(
        int(entry["part"]), np.ascontiguousarray(image[..., 0]), image[..., 3] > 127, deviation,
        float(entry["left_mm"]), float(entry["top_mm"]), float(entry["mm_per_px"]),
    )  # fmt: skip


def webp(grey: NDArray[np.uint8], seen: NDArray[np.bool_]) -> bytes:
    """A grey picture that is transparent where nothing was seen."""
    image = np.dstack([grey, grey, grey, np.where(seen, 255, 0).astype(np.uint8)])
    return _encode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])


def _png(deviation: NDArray[np.float32]) -> bytes:
    steps = np.rint(np.nan_to_num(deviation) / _STEP_MM).clip(1 - _ZERO, _ZERO - 1) + _ZERO
    return _encode(".png", np.where(np.isnan(deviation), 0, steps).astype(np.uint16), [])


def _encode(ending: str, image: NDArray[Any], options: list[int]) -> bytes:
    ok, data = cv2.imencode(ending, image, options)
    if not ok:
        raise StoreError(f"found a picture of shape {image.shape} that does not encode, expected a panel's")
    return data.tobytes()


def _decoded(name: str, content: bytes) -> NDArray[Any]:
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if content else None
    if image is None:
        raise StoreError(f"{name}: found no readable picture, expected one of a panel's run")
    return image
