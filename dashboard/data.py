"""Rows of the archive, cached by the generation of the index they came from.

The published index is an immutable file behind a symbolic link. Everything read from it is cached under the file's real
path: a new night's results are a new path, so nothing stale is ever shown and nothing needs a time limit.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import duckdb
import pandas as pd
import pyarrow as pa
import streamlit as st

from metrology.errors import StoreError
from metrology.rig import Rig
from metrology.tolerance import PanelSpec
from storage.archive.bookkeeping import is_known
from storage.archive.bundle import FITS, MANIFEST
from storage.archive.decisions import shown_finding
from storage.archive.known_defects import Accepted, accepted_before
from storage.archive.older import cover
from storage.archive.store import Store
from storage.archive.work import Standing, noticed_sql, reviewed_features, signed_scenes, standings_of
from storage.cloud import StoredCloud
from storage.documents import read_json
from storage.fits import StoredFits, read_fits
from storage.panel_spec import judged_by
from storage.review import Feature, Review, ReviewLog, ShownFinding

_CACHED_QUERIES, _CACHED_FINDINGS, _CACHED_GENERATIONS = 200, 2000, 1
_CACHED_CLOUDS, _CACHED_SPECIFICATIONS = 2, 500
NOTICED = "noticed"
"""What needs attention on the newest scans, as a table of queries that may use what people decided."""
Name = tuple[str, str, str]
"""A finding: scene, kind and id."""
Margin = tuple[float, str, float, str, float, float]
"""Distance to the limit (negative: beyond it), its unit, and as a share of what the limits leave; name, value and U95
of the quantity that the verdict is about, "" where something else than a limit decided."""


class Archive:
    """A store as the pages read it."""

    def __init__(self, root: Path) -> None:
        self.root = Path(root)
        self.store = Store(self.root)

    # Both are looked up once, so that all of a page shows the same state of the store.
    @cached_property
    def generation(self) -> str:
        """Names the published index: its real path, empty where there is none."""
        link = self.store.layout.archive
        return os.path.realpath(link) if link.exists() else ""

    @cached_property
    def _review_version(self) -> tuple[int, ...]:
        return ReviewLog(self.root).version

    @property
    def empty(self) -> bool:
        """Whether nothing was ever published."""
        return not self.generation

    def rows(self, sql: str, parameters: Sequence[Any] = ()) -> pd.DataFrame:
        """Rows of a query of ours."""
        return _rows(str(self.root), self.generation, sql, tuple(parameters))

    def shared_rows(self, sql: str) -> pd.DataFrame:
        """Rows of a query of ours that are many and that nobody changes: all who ask get the same ones."""
        return _shared_rows(str(self.root), self.generation, sql)

    def rows_about(self, sql: str, wanted: pd.DataFrame) -> pd.DataFrame:
        """Rows of a query of ours about those of a frame, which it knows as `wanted`; asked anew each time."""
        cursor = _cursor(str(self.root), self.generation)
        cursor.register("wanted", wanted)
        return _fetch(cursor, sql, ())

    def margins(self) -> dict[Name, Margin]:
        """What is known of how far findings lie from their limits; whoever finds out more adds it."""
        return _margins(str(self.root), self.generation)

    def review(self) -> Review:
        """What people decided so far."""
        return _review(str(self.root), self._review_version)

    def rows_with_review(self, sql: str, parameters: Sequence[Any] = ()) -> pd.DataFrame:
        """Rows of a query of ours that may use what people decided (see `storage.archive.work.register`)."""
        return _rows_with_review(str(self.root), self.generation, self._review_version, sql, tuple(parameters))

    def shown(self, scene_id: str, feature: Feature) -> ShownFinding | None:
        """A finding as this page shows it, for a decision about it; None where there is no such feature."""
        return _shown(str(self.root), self.generation, self._review_version, scene_id, feature)

    def standings(self, scene_id: str) -> tuple[Standing, ...]:
        """How the findings of a scene stand."""
        return self.standings_of([scene_id])[scene_id]

    def standings_of(self, scene_ids: Sequence[str]) -> Mapping[str, tuple[Standing, ...]]:
        """How the findings of some scenes stand, by the scene; one question for all of them."""
        if not scene_ids:
            return {}
        return _standings(str(self.root), self.generation, self._review_version, tuple(scene_ids))

    def accepted(self, scene_id: str) -> Mapping[str, Accepted]:
        """Defects of a scene that were accepted on an earlier one, by their ids."""
        return _accepted(str(self.root), self.generation, self._review_version, scene_id)

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


@st.cache_resource(max_entries=_CACHED_GENERATIONS, show_spinner=False)
def _is_of_this_version(root: str, generation: str) -> bool:
    return is_known(_connection(root, generation))


def _cursor(root: str, generation: str) -> duckdb.DuckDBPyConnection:
    """A connection of one's own to the generation that is open."""
    cursor = _connection(root, generation).cursor()
    if not _is_of_this_version(root, generation):
        cover(cursor)
    return cursor


@st.cache_data(max_entries=_CACHED_QUERIES, show_spinner=False)
def _rows(root: str, generation: str, sql: str, parameters: tuple[Any, ...]) -> pd.DataFrame:
    return _fetch(_cursor(root, generation), sql, parameters)


@st.cache_resource(max_entries=4, show_spinner=False)
def _shared_rows(root: str, generation: str, sql: str) -> pd.DataFrame:
    return _fetch(_cursor(root, generation), sql, ())


@st.cache_data(max_entries=_CACHED_QUERIES, show_spinner=False)
def _rows_with_review(
    root: str, generation: str, version: tuple[int, ...], sql: str, parameters: tuple[Any, ...]
) -> pd.DataFrame:
    cursor = _cursor(root, generation)
    if NOTICED in sql:
        cursor.register(NOTICED, _noticed(root, generation))
    cursor.register("reviewed", _reviewed(root, generation, version))
    cursor.register("signed", signed_scenes(_review(root, version)))
    return _fetch(cursor, sql, parameters)


@st.cache_resource(max_entries=_CACHED_GENERATIONS, show_spinner=False)
def _margins(root: str, generation: str) -> dict[Name, Margin]:
    return {}


@st.cache_resource(max_entries=_CACHED_GENERATIONS, show_spinner=False)
def _noticed(root: str, generation: str) -> pa.Table:
    """Rows of `noticed_sql`: few of all, and the same whatever people decide and look for."""
    cursor = _cursor(root, generation)
    try:
        return cursor.sql(noticed_sql()).to_arrow_table()
    finally:
        cursor.close()


@st.cache_resource(max_entries=4, show_spinner=False)
def _reviewed(root: str, generation: str, version: tuple[int, ...]) -> pa.Table:
    cursor = _cursor(root, generation)
    try:
        return reviewed_features(cursor, _review(root, version))
    finally:
        cursor.close()


@st.cache_data(max_entries=_CACHED_FINDINGS, show_spinner=False)
def _shown(
    root: str, generation: str, version: tuple[int, ...], scene_id: str, feature: Feature
) -> ShownFinding | None:
    cursor = _cursor(root, generation)
    try:
        return shown_finding(cursor, _review(root, version), scene_id, feature)
    finally:
        cursor.close()


@st.cache_data(max_entries=_CACHED_QUERIES, show_spinner=False)
def _standings(
    root: str, generation: str, version: tuple[int, ...], scene_ids: tuple[str, ...]
) -> dict[str, tuple[Standing, ...]]:
    cursor = _cursor(root, generation)
    try:
        return standings_of(cursor, _review(root, version), scene_ids)
    finally:
        cursor.close()


@st.cache_data(max_entries=_CACHED_QUERIES, show_spinner=False)
def _accepted(root: str, generation: str, version: tuple[int, ...], scene_id: str) -> Mapping[str, Accepted]:
    cursor = _cursor(root, generation)
    try:
        return accepted_before(cursor, _review(root, version), scene_id)
    finally:
        cursor.close()


@st.cache_resource(max_entries=4, show_spinner=False)
def _review(root: str, version: tuple[int, ...]) -> Review:
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
