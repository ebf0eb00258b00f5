"""What captured scenes tell without truth: repeatability where a station was scanned twice, flatness of planes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flows.inbox import only_run, scene_folders
from flows.inspect_scene import Call, Job, directly, inspect_scene
from flows.study.document import Cell, Column, Section, Table
from flows.study.folder import Finished, claim
from flows.study.planes import planes_section, read_planes
from flows.study.report import write_report
from flows.study.values import Quantity, between, shared_places
from metrology.errors import FlushlineError, UsageError
from storage.archive import Store
from storage.archive.bundle import document_hash
from storage.panel_spec import load_panel_spec
from storage.rig import load_rig, rig_document
from storage.scene import load_manifest
from storage.scene_models import MANIFEST
from tasks.result import config_hash
from tasks.settings import InspectionSettings

_POSITIONS = 10
_QUANTITIES: tuple[Quantity, ...] = ("step", "width")


@dataclass(frozen=True)
class Captured:
    """Scenes to look at, the rig that took them, planes declared on them (or None), and where results go."""

    folder: Path
    out: Path
    rig: Path
    planes: Path | None = None


def run_real(
    captured: Captured,
    settings: InspectionSettings,
    call: Call = directly,
    on_progress: Callable[[int, int, str], None] = lambda _done, _all, _what: None,
) -> Finished:
    """Inspect captured scenes and write what they tell; truth.json is not read.

    Parameters
    ----------
    call : callable
        Runs a step.
    on_progress : callable
        Told how many scenes are done, of how many, and what comes next.
    """
    if not captured.folder.is_dir():
        raise UsageError(f"{captured.folder}: found no such folder, expected one with scene folders")
    folders = [folder for folder in scene_folders(captured.folder) if (folder / MANIFEST).exists()]
    if not folders:
        raise UsageError(f"{captured.folder}: found no scene folder in it, expected folders with a {MANIFEST}")
    rig = load_rig(captured.rig)
    planes = read_planes(captured.planes) if captured.planes else ()
    claim(captured.out, "real", str(captured.folder.resolve()))
    store = Store(captured.out / "store")
    specification = load_panel_spec()
    names = config_hash(settings, specification), document_hash(rig_document(rig))
    problems = []
    with only_run(captured.out):
        for done, folder in enumerate(folders):
            on_progress(done, len(folders), f"inspecting {folder.name}")
            try:
                if not store.holds(load_manifest(folder / MANIFEST).key.scene_id, *names):
                    inspect_scene(Job(folder, store, captured.rig, settings, specification), call)
            except FlushlineError as problem:
                problems.append(str(problem))
        if len(problems) == len(folders):
            raise UsageError(problems[0])
        on_progress(len(folders), len(folders), "report")
        sections = repeatability_sections(store)
        if planes:
            sections.append(planes_section(store, planes))
        lead = (f"Captured scenes of {captured.folder}, inspected with rig {rig.id}; nothing is known of their truth.",)
        missed = tuple(f"Not inspected: {problem}" for problem in problems)
        return Finished(
            write_report(captured.out, "Study of captured scenes", lead + missed, sections), (), tuple(problems)
        )


def repeatability_sections(store: Store) -> list[Section]:
    """Tables 2 and 3 for every station that was scanned more than once."""
    groups = store.query(
        "SELECT aircraft_serial, panel, station, count(*) AS scans FROM scenes GROUP BY ALL ORDER BY ALL"
    ).to_pylist()
    sections = []
    for group in groups:
        place = (group["aircraft_serial"], group["panel"], group["station"])
        title = f"Repeatability: {' '.join(place)}"
        if group["scans"] < 2:
            sections.append(Section(title, ("One scan: nothing to compare it with.",)))
            continue
        name = "-".join(place).lower()
        text = (f"{group['scans']} scans. sd and max deviation (range) over the scans that measured the feature.",)
        sections.append(Section(title, text, (_rivets(store, place, name), _seams(store, place, name))))
    return sections


_COLUMNS = (
    Column("scans", 0), Column("average, mm", 4), Column("sd, mm", 4), Column("max deviation, mm", 4),
    Column("median U95, mm", 4),
)  # fmt: skip


def _figures(values: Sequence[tuple[float | None, float | None]]) -> list[Cell]:
    """Number, mean, standard deviation, range and median U95 of one feature's values."""
    known = np.array([value for value, _ in values if value is not None])
    spans = [u95 for _, u95 in values if u95 is not None]
    u95 = float(np.median(spans)) if spans else None
    if len(known) < 2:
        return [len(known), float(known[0]) if len(known) else None, None, None, u95]
    return [len(known), float(known.mean()), float(known.std(ddof=1)), float(np.ptp(known)), u95]


def _rivets(store: Store, place: tuple[str, str, str], name: str) -> Table:
    rows = _rows(store, "rivets", place)
    features: dict[str, list[tuple[float | None, float | None]]] = {}
    for row in rows:
        features.setdefault(row["rivet_id"], []).append((row["height_mean_mm"], row["height_u95_mm"]))
    body = [[feature, *_figures(values)] for feature, values in sorted(features.items())]
    return Table(f"rivets-{name}", "Heights of rivets", (Column("rivet"), *_COLUMNS), body)


def _seams(store: Store, place: tuple[str, str, str], name: str) -> Table:
    """Step and width at places along each seam that all scans show."""
    seams: dict[str, dict[str, list[tuple[dict[str, Any], float]]]] = {}
    for row in _rows(store, "seam_stations", place):
        seams.setdefault(row["seam_id"], {}).setdefault(row["scene_id"], []).append((row, row["s_mm"]))
    body: list[list[Cell]] = []
    for seam, scans in sorted(seams.items()):
        for stations in scans.values():
            stations.sort(key=lambda pair: pair[1])
        for at in shared_places(list(scans.values()), _POSITIONS):
            for quantity in _QUANTITIES:
                values = [between(stations, at, quantity) for stations in scans.values()]
                body.append([seam, at, quantity, *_figures(values)])
    columns = (Column("seam"), Column("s, mm", 1), Column("quantity"), *_COLUMNS)
    return Table(f"seams-{name}", "Steps and widths of seams", columns, body)


def _rows(store: Store, table: str, place: tuple[str, str, str]) -> list[dict[str, Any]]:
    return store.query(
        f"SELECT * FROM {table} WHERE aircraft_serial = ? AND panel = ? AND station = ? AND x_mm IS NOT NULL "
        "ORDER BY captured_at",
        place,
    ).to_pylist()
