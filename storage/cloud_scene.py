"""Scene folders of other scanners' clouds (`flushline-cloud-scene/1`): points on the pixels of one picture."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from metrology.arrays import Float32
from metrology.errors import SceneError
from metrology.results import SceneKey
from metrology.rig import Rig
from storage import scan_identity
from storage.documents import check_regular_file
from storage.frames import Frame, FrameHeader, file_checksum, read_frame, read_header, write_frame
from storage.models import InnerPath, Line, StrictModel, validate
from storage.rig import load_rig, save_rig
from storage.scene_models import MANIFEST, ScanModel, scan_document

FORMAT = "flushline-cloud-scene/1"
PICTURE, POINTS, SIGMA, RIG = "picture.png", "points.npy", "sigma.npy", "rig.json"

Row = Annotated[tuple[float, ...], Field(min_length=3, max_length=3)]


class SourceModel(StrictModel):
    """Where the cloud comes from: a point x of its file, in mm, is at R x + t in the scene."""

    file: Line
    R: Annotated[tuple[Row, ...], Field(min_length=3, max_length=3)]
    t: Row
    gridded: Line | None = None


class CloudSceneModel(ScanModel):
    """scene.json of a cloud."""

    format: Literal["flushline-cloud-scene/1"]
    rig_file: InnerPath | None = None
    picture: InnerPath
    points: InnerPath
    sigma: InnerPath | None = None
    source: SourceModel | None = None

    @property
    def files(self) -> list[str]:
        """Everything but the manifest and the rig."""
        return [self.picture, self.points, *([self.sigma] if self.sigma else [])]

    def digest(self, folder: Path) -> str:
        """Names the content of the files."""
        return scan_identity.cloud_digest([file_checksum(folder / name, SceneError) for name in self.files])

    def own_rig(self, folder: Path) -> Rig | None:
        """The rig that lies in the folder; None where the store has it."""
        return load_rig(folder / self.rig_file) if self.rig_file else None


@dataclass(frozen=True)
class CloudScene:
    """A cloud scene whose manifest is sound and whose files are there and of one size."""

    folder: Path
    model: CloudSceneModel
    picture_header: FrameHeader
    files_state: str
    """Names the folder's files as they lay on disk when they were looked at."""

    @property
    def key(self) -> SceneKey:
        """Which scene it is."""
        return self.model.key

    @property
    def rig_id(self) -> str:
        """The camera whose pixels the points lie on."""
        return self.model.rig

    @property
    def operator(self) -> str | None:
        """Who took it."""
        return self.model.operator

    def own_rig(self) -> Rig | None:
        """The rig that lies in the folder; None where the store has it."""
        return self.model.own_rig(self.folder)

    def check_fits(self, rig: Rig) -> None:
        """Refuse a rig whose left camera has another size than the picture."""
        header, camera = self.picture_header, rig.left
        if (header.width, header.height) != (camera.width, camera.height):
            raise SceneError(
                f"{self.folder / self.model.picture}: found {header.width}×{header.height} pixels, expected "
                f"{camera.width}×{camera.height} as the left camera of rig {rig.id!r} has"
            )

    def picture(self) -> Frame:
        """(h, w) grey levels."""
        return read_frame(self.folder / self.model.picture, self.picture_header, SceneError)

    def points(self) -> Float32:
        """(h, w, 3) mm in the camera's frame."""
        header = self.picture_header
        return read_array(self.folder / self.model.points, (header.height, header.width, 3))

    def sigma(self) -> Float32 | None:
        """(h, w) standard deviation of the depths, mm; None where nobody knows it."""
        if self.model.sigma is None:
            return None
        header, path = self.picture_header, self.folder / self.model.sigma
        sigma = read_array(path, (header.height, header.width))
        if not (sigma[np.isfinite(sigma)] > 0).all():
            raise SceneError(f"{path}: found standard deviations that are not positive, expected mm")
        return sigma


def look_at(folder: Path, model: CloudSceneModel) -> CloudScene:
    """The scene of a manifest; only headers are read."""
    state = scan_identity.files_state(folder, [MANIFEST, *model.files])
    return CloudScene(folder, model, read_header(folder / model.picture, SceneError), state)


def read_array(path: Path, shape: tuple[int, ...]) -> Float32:
    """An npy file of floats of a known shape."""
    size = check_regular_file(path, SceneError).st_size
    wanted = f"an npy file of float32 of shape {shape}"
    try:
        with path.open("rb") as file:
            version = np.lib.format.read_magic(file)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            found, _, kind = read(file)
            whole = file.tell() + kind.itemsize * int(np.prod(found)) == size
        if found != shape or kind.kind != "f" or not whole:
            raise SceneError(
                f"{path}: found {'' if whole else 'a damaged file of '}{kind} of shape {found}, expected {wanted}"
            )
        return np.asarray(np.load(path, allow_pickle=False), np.float32)
    except (ValueError, OSError, EOFError) as problem:
        said = " ".join(str(problem).split())[:100]
        raise SceneError(f"{path}: found a file that cannot be read ({said}), expected {wanted}") from None


def write_cloud_scene(
    folder: Path,
    key: SceneKey,
    rig: Rig,
    picture: Frame,
    points: Float32,
    sigma: Float32 | None = None,
    source: Mapping[str, Any] | None = None,
    operator: str | None = None,
) -> None:
    """Write a cloud scene with its rig; scene.json comes last.

    Parameters
    ----------
    picture : (h, w) ndarray of uint8 or uint16
    points : (h, w, 3) ndarray of float32
        In the frame of the rig's left camera, mm.
    sigma : (h, w) ndarray of float32, optional
        mm.
    source : mapping, optional
        See SourceModel.
    """
    document = {
        **scan_document(FORMAT, key, rig.id, operator),
        "rig_file": RIG,
        "picture": PICTURE,
        "points": POINTS,
        **({} if sigma is None else {"sigma": SIGMA}),
        **({"source": dict(source)} if source else {}),
    }
    manifest = folder / MANIFEST
    validate(CloudSceneModel, document, manifest, SceneError)
    folder.mkdir(parents=True, exist_ok=True)
    manifest.unlink(missing_ok=True)
    save_rig(rig, folder / RIG)
    write_frame(folder / PICTURE, picture)
    np.save(folder / POINTS, np.asarray(points, np.float32))
    if sigma is not None:
        np.save(folder / SIGMA, np.asarray(sigma, np.float32))
    manifest.write_text(json.dumps(document, indent=1, ensure_ascii=False), encoding="utf-8")
