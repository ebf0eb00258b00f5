"""Rows of the archive, cached by the generation of the index they came from.

The published index is an immutable file behind a symbolic link. Everything read from it is cached under the file's real
path: a new night's results are a new path, so nothing stale is ever shown and nothing needs a time limit.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import duckdb
import pandas as pd
import streamlit as st

from metrology.errors import StoreError
from metrology.rig import Rig
from metrology.tolerance import PanelSpec
from storage.archive.bundle import FITS, MANIFEST
from storage.archive.store import Store
from storage.cloud import StoredCloud
from storage.documents import read_json
from storage.fits import StoredFits, read_fits
from storage.panel_spec import judged_by
from storage.review import Review, ReviewLog

_CACHED_QUERIES, _CACHED_GENERATIONS, _CACHED_CLOUDS, _CACHED_SPECIFICATIONS = 200, 2, 2, 500


class Archive:
    """A store as the pages read it.

    Parameters
    ----------
    root : Path
    """

    def __init__(self, root: Path) -> None:
        self.root = Path(root)
        self.store = Store(self.root)

    @property
    def generation(self) -> str:
        """Names the published index: its real path, empty where there is none."""
        link = self.store.layout.archive
        return os.path.realpath(link) if link.exists() else ""

    @property
    def empty(self) -> bool:
        """Whether nothing was ever published."""
        return not self.generation

    def rows(self, sql: str, parameters: Sequence[Any] = ()) -> pd.DataFrame:
        """Rows of a query of ours."""
        return _rows(str(self.root), self.generation, sql, tuple(parameters))

    def review(self) -> Review:
        """What people decided so far."""
        log = ReviewLog(self.root)
        return _review(str(self.root), log.version)

    def rows_with_review(self, sql: str, parameters: Sequence[Any] = ()) -> pd.DataFrame:
        """Rows of a query of ours that may use two tables more.

        `reviewed` has scene_id, feature_kind, feature_id, disposition, who, decided_at and comment of the last
        disposition of each feature; `signed` has scene_id, signed_by, signed_at.
        """
        version = ReviewLog(self.root).version
        return _rows_with_review(str(self.root), self.generation, version, sql, tuple(parameters))

    def file(self, relative: object) -> Path:
        """A file of the store; refused where the path leads out of it."""
        path = (self.root / str(relative)).resolve()
        if not relative or not path.is_relative_to(self.root.resolve()):
            raise StoreError(f"{self.root}: found path {relative!r} in the archive, expected one inside the store")
        self.store.file(str(relative))
        if not path.is_file():
            raise StoreError(f"{path}: found no such file, expected it; older runs may have been pruned")
        return path

    def cloud(self, relative: object) -> StoredCloud:
        """An organised cloud."""
        return _cloud(str(self.file(relative)))

    def specification(self, bundle: object) -> PanelSpec | None:
        """The limits that a run was judged by, from its own manifest; None where they cannot be read."""
        return _specification(str(self.file(f"{bundle}/{MANIFEST}")))

    def fits(self, bundle: object) -> StoredFits:
        """The fits that a run kept; none where it is of a version that kept none."""
        manifest = self.file(f"{bundle}/{MANIFEST}")
        if FITS not in (read_json(manifest, StoreError).get("files") or {}):
            return StoredFits(())
        return _fits(str(self.file(f"{bundle}/{FITS}")))

    def rig(self, bundle: object) -> Rig:
        """The rig as it was used in a run."""
        from storage.rig import rig_from_document

        path = self.file(f"{bundle}/rig.json")
        return rig_from_document(read_json(path, StoreError), path)


@st.cache_resource(max_entries=_CACHED_GENERATIONS, show_spinner=False)
def _connection(root: str, generation: str) -> duckdb.DuckDBPyConnection:
    return Store(Path(root)).connect()


@st.cache_data(max_entries=_CACHED_QUERIES, show_spinner=False)
def _rows(root: str, generation: str, sql: str, parameters: tuple[Any, ...]) -> pd.DataFrame:
    return _fetch(_connection(root, generation).cursor(), sql, parameters)


@st.cache_data(max_entries=_CACHED_QUERIES, show_spinner=False)
def _rows_with_review(
    root: str, generation: str, version: tuple[int, int], sql: str, parameters: tuple[Any, ...]
) -> pd.DataFrame:
    review = _review(root, version)
    cursor = _connection(root, generation).cursor()
    cursor.register("reviewed", reviewed_features(review))
    cursor.register("signed", signed_scenes(review))
    return _fetch(cursor, sql, parameters)


@st.cache_data(max_entries=4, show_spinner=False)
def _review(root: str, version: tuple[int, int]) -> Review:
    return ReviewLog(Path(root)).read()


@st.cache_resource(max_entries=_CACHED_CLOUDS, show_spinner=False)
def _cloud(path: str) -> StoredCloud:
    from storage.cloud import read_cloud

    return read_cloud(Path(path))


@st.cache_resource(max_entries=_CACHED_SPECIFICATIONS, show_spinner=False)
def _specification(path: str) -> PanelSpec | None:
    return judged_by(read_json(Path(path), StoreError), Path(path))


@st.cache_resource(max_entries=_CACHED_CLOUDS, show_spinner=False)
def _fits(path: str) -> StoredFits:
    return read_fits(Path(path))


def reviewed_features(review: Review) -> pd.DataFrame:
    """The last disposition of each feature."""
    names = ["scene_id", "feature_kind", "feature_id", "disposition", "who", "decided_at", "comment"]
    rows = [
        (scene, feature.kind, feature.id, entry.disposition, entry.who, entry.at, entry.comment)
        for (scene, feature), entry in review.current().items()
    ]
    frame = pd.DataFrame(rows, columns=names)
    return frame.astype(dict.fromkeys(set(names) - {"decided_at"}, "str")).astype({"decided_at": "datetime64[us, UTC]"})


def signed_scenes(review: Review) -> pd.DataFrame:
    """The sign-off of each scene that has one."""
    rows = [(scene, entry.who, entry.at) for scene, entry in review.sign_offs().items()]
    frame = pd.DataFrame(rows, columns=["scene_id", "signed_by", "signed_at"])
    return frame.astype({"scene_id": "str", "signed_by": "str", "signed_at": "datetime64[us, UTC]"})


def _fetch(cursor: duckdb.DuckDBPyConnection, sql: str, parameters: Sequence[Any]) -> pd.DataFrame:
    try:
        return cursor.sql(sql, params=list(parameters)).to_arrow_table().to_pandas()
    except duckdb.Error as problem:
        first = str(problem).splitlines()[0]
        raise StoreError(
            f"archive: found {first}, expected the tables of this version; `flushline archive rebuild` makes them again"
        ) from None
    finally:
        cursor.close()
