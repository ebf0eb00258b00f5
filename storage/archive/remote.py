"""Bundles on object storage, such as S3, through pyarrow's file systems.

Object storage has no renaming: a run is complete there as soon as it has its manifest, which is written last and
removed first.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from metrology.errors import StoreError
from storage.archive.bundle import MANIFEST
from storage.archive.files import protect, replacing

if TYPE_CHECKING:
    from pyarrow.fs import FileSystem


class Remote:
    """A folder of another file system that holds bundles under their paths in the store.

    Parameters
    ----------
    target : str
        A folder, or a URI that pyarrow knows, such as ``s3://bucket/prefix``.
    """

    def __init__(self, target: str) -> None:
        self.filesystem, self.base = _opened(target)

    def has(self, run: str) -> bool:
        """Whether a run is complete there."""
        return bool(self.filesystem.get_file_info(f"{self.base}/{run}/{MANIFEST}").is_file)

    def runs(self, below: str = "bundles") -> list[str]:
        """Every complete run below a folder, by its path in the store."""
        from pyarrow.fs import FileSelector

        place = FileSelector(f"{self.base}/{below}", allow_not_found=True, recursive=True)
        manifests = (info.path for info in self.filesystem.get_file_info(place) if info.base_name == MANIFEST)
        return sorted(str(PurePosixPath(path).parent.relative_to(self.base)) for path in manifests)

    def names(self, run: str) -> list[str]:
        """The files of a run there."""
        from pyarrow.fs import FileSelector

        files = self.filesystem.get_file_info(FileSelector(f"{self.base}/{run}", allow_not_found=True))
        return [info.base_name for info in files if info.is_file]

    def put(self, folder: Path, run: str) -> None:
        """Copy a run's folder there."""
        self.copy_files(sorted(folder.iterdir(), key=lambda path: (path.name == MANIFEST, path.name)), run)

    def copy_files(self, files: Iterable[Path], place: str) -> None:
        """Copy files into a folder there, in their order."""
        from pyarrow import fs

        self.filesystem.create_dir(f"{self.base}/{place}", recursive=True)
        for path in files:
            fs.copy_files(str(path), f"{self.base}/{place}/{path.name}", fs.LocalFileSystem(), self.filesystem)

    def fetch(self, run: str, name: str, target: Path) -> None:
        """Bring one file of a run here; it appears whole or not at all."""
        from pyarrow import fs

        target.parent.mkdir(parents=True, exist_ok=True)
        with replacing(target, durable=False) as partial:  # others may be fetching the same file just now
            fs.copy_files(f"{self.base}/{run}/{name}", str(partial), self.filesystem, fs.LocalFileSystem())
            protect(partial)

    def remove(self, run: str) -> None:
        """Remove a run there, or what there is of one that did not arrive."""
        from pyarrow.fs import FileType

        if self.has(run):
            self.filesystem.delete_file(f"{self.base}/{run}/{MANIFEST}")
        if self.filesystem.get_file_info(f"{self.base}/{run}").type != FileType.NotFound:
            self.filesystem.delete_dir(f"{self.base}/{run}")

    def folders(self, place: str) -> list[str]:
        """Names of the folders in a folder there."""
        from pyarrow.fs import FileSelector, FileType

        found = self.filesystem.get_file_info(FileSelector(f"{self.base}/{place}", allow_not_found=True))
        return sorted(info.base_name for info in found if info.type == FileType.Directory)

    def remove_folder(self, place: str) -> None:
        """Remove a folder there."""
        self.filesystem.delete_dir(f"{self.base}/{place}")

    def write(self, path: str, content: bytes) -> None:
        """Write a small file there."""
        with self.filesystem.open_output_stream(f"{self.base}/{path}") as stream:
            stream.write(content)

    def size(self, path: str) -> int | None:
        """Bytes of a file there; None where there is none."""
        size: int | None = self.filesystem.get_file_info(f"{self.base}/{path}").size
        return size


def _opened(target: str) -> tuple[FileSystem, str]:
    from pyarrow import ArrowInvalid, fs

    if "://" not in target:
        if Path(target).is_file():
            raise StoreError(f"{target}: found a file, expected a folder or a URI such as s3://bucket/prefix")
        return fs.LocalFileSystem(), str(Path(target).absolute())
    try:
        filesystem, base = fs.FileSystem.from_uri(target)
    except (ArrowInvalid, OSError) as problem:
        text = str(problem).splitlines()[0]
        raise StoreError(f"{target}: found {text}, expected a folder or a URI such as s3://bucket/prefix") from None
    if not base.strip("/"):
        raise StoreError(f"{target}: found no bucket or folder, expected a URI such as s3://bucket/prefix")
    return filesystem, base.rstrip("/")
