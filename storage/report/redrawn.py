"""The overlay of a stored scan drawn anew: in another language, with names, or of nothing but the open work."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrology.errors import FlushlineError, StoreError
from metrology.kinds import KINDS, Kind
from metrology.overlay import Overlay, Words, draw_overlay, scan_title
from metrology.overlay.words import WORK_ALONE
from metrology.results import SceneKey
from metrology.rig import Rig
from storage import png
from storage.archive import Store
from storage.archive.bundle import RIG, sound_file
from storage.archive.panel_scans import features_of
from storage.archive.schema import PANEL_OF_KIND
from storage.archive.work import open_work
from storage.review import Feature, ReviewLog
from storage.rig import load_rig
from storage.wording import Wording, _, wording


@dataclass(frozen=True)
class _Skin:
    rig: Rig
    points: NDArray[np.float32]


def overlay_file(store: Store, scene_id: str, suffix: str = ".png") -> bytes:
    """A scan's overlay in the language that is written in: as it was stored, which is in English, or drawn anew.

    Parameters
    ----------
    suffix : str
        ".png" or ".svg".
    """
    stored = sound_file(store.paths(scene_id).overlay.with_suffix(suffix)).read_bytes()
    if wording().language == Wording().language:
        return stored
    try:
        overlay = redrawn_overlay(store, scene_id, named=False)
    except FlushlineError:  # what it is drawn from is not there any more
        return stored
    return encoded(overlay, suffix)


def encoded(overlay: Overlay, suffix: str) -> bytes:
    """An overlay as PNG or SVG."""
    return overlay.svg().encode() if suffix == ".svg" else png.encode(overlay.image())


def redrawn_overlay(store: Store, scene_id: str, work_alone: bool = False, named: bool = True) -> Overlay:
    """The overlay in the language that is written in (`storage.wording`).

    Parameters
    ----------
    work_alone : bool
        Only that whose rework, repair or re-scan was decided and is not done.
    named : bool
        With the names that features have in their assembled panel, or else on their scan.
    """
    paths, features = store.paths(scene_id), features_of(store, [scene_id])[scene_id]
    with contextlib.closing(store.connect()) as connection:

        def rows(sql: str) -> list[dict[str, Any]]:
            return connection.sql(sql, params=[scene_id]).to_arrow_table().to_pylist()

        names: dict[str, str] = {}
        for kind in KINDS:
            names |= {_single(kind, row["own"]): row["name"] for row in rows(_of_panel(kind))}
        (key,) = rows("SELECT aircraft_serial, panel, station, captured_at FROM scenes WHERE scene_id = ?")
        if work_alone:
            open_ones = {feature for __, feature in open_work(connection, ReviewLog(store.root).of_scenes([scene_id]))}
            features = {kind.name: [r for r in features[kind.name] if _is_of(open_ones, kind, r)] for kind in KINDS}
            if not any(features.values()):
                raise StoreError(f"{scene_id}: found no open rework, repair or re-scan, expected some to draw")
    title = scan_title(SceneKey(**key)) + ((_(WORK_ALONE),) if work_alone else ())
    skin = _Skin(load_rig(paths.bundle / RIG), store.load_cloud(scene_id).points)
    return draw_overlay(features, skin, title, names=names if named else None, words=Words(_, wording().decimal))


def _of_panel(kind: Kind) -> str:
    """What a scan calls each feature of its assembled panel, and the name of that in the panel."""
    return (
        f"SELECT own, name FROM (SELECT {kind.id_columns[0]} AS name, unnest(seen_by) AS scene_id, "
        f"unnest(seen_as) AS own FROM {PANEL_OF_KIND[kind.name].name}) WHERE scene_id = ?"
    )


def _single(kind: Kind, own: str) -> str:
    return own.split("@")[0] if kind.is_course else own


def _is_of(chosen: set[Feature], kind: Kind, row: Any) -> bool:
    """Whether a row is one of some features, or a position of one of some stretches."""
    return any(Feature(kind.name, name) in chosen for name in (kind.id_of(row), getattr(row, "stretch", None)) if name)
