"""The demonstration: a panel is simulated, inspected, and what was found is set beside what is true."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from flows.compiling import kernels_beside
from flows.inspect_scene import Answer, Job, inspect_scene
from flows.progress import progress_bar
from flows.simulate import RIG_FILE, simulate_folders
from metrology.results import Features, Rivet, SeamStation, of_type
from simulator.spec import shipped_spec
from storage.archive import Store
from storage.panel_spec import load_panel_spec
from storage.scene_models import MANIFEST
from tasks.settings import InspectionSettings

_SPEC = "demo"
_SAME_SEAM_MM = 5.0


@dataclass(frozen=True)
class Pair:
    """A quantity of one feature, found and true; None where it was not found."""

    feature: str
    quantity: str
    found: float | None
    true: float
    u95: float | None
    decision: str


def run_demo(out: Path, keep: bool) -> int:
    """Simulate, inspect, compare; returns the command's exit code.

    Parameters
    ----------
    out : Path
        Gets the scene, its rig and the store.
    keep : bool
        Use the scene that an earlier run rendered there.
    """
    with kernels_beside():
        scene, rig = _scene(out, keep)
        truth = json.loads((scene / "truth.json").read_text(encoding="utf-8"))
        store, overlay, console = Store(out / "store"), out / "overlay.png", Console()

        def tell(answer: Answer) -> None:
            pairs = compare(answer.features, truth)
            console.print(_table(pairs))
            for line in _summary(pairs, answer):
                console.print(line, highlight=False)
            overlay.write_bytes(answer.picture())
            print(f"overlay  {overlay}", flush=True)

        with progress_bar() as progress:
            bar = progress.add_task("inspecting (the first time compiles, about a minute)", total=None)
            inspect_scene(
                Job(scene, store, rig, InspectionSettings(), load_panel_spec()),
                on_step=lambda step: progress.update(bar, description=f"inspecting: {step}"),
                on_answer=tell,
            )
    print(f"scene    {scene}\nrig      {rig}\nstore    {store.root}")
    print(f'ask      flushline query "SELECT * FROM worst_rivets" --store {store.root}')
    return 0


def compare(features: Features, truth: dict[str, Any]) -> list[Pair]:
    """What was found beside the truth of a rendered scene: each rivet's height, each seam's mean step and width."""
    rivets, stations = of_type(features, Rivet), of_type(features, SeamStation)
    return [
        *(_rivet_pair(true, rivets) for true in truth["rivets"] if true.get("visible", True)),
        *(pair for true in truth["seams"] for pair in _seam_pairs(str(true["id"]), true, stations)),
    ]


def _rivet_pair(true: dict[str, Any], rivets: Sequence[Rivet]) -> Pair:
    placed = [rivet for rivet in rivets if rivet.x_mm is not None]
    name, height = str(true["id"]), float(true["height_mean_mm"])
    if placed:
        at = np.array([(rivet.x_mm, rivet.y_mm, rivet.z_mm) for rivet in placed], float)
        distance = np.linalg.norm(at - np.array(true["xyz_mm"]), axis=1)
        rivet = placed[int(distance.argmin())]
        if distance.min() < true["diameter_mm"] / 2:
            return Pair(name, "height", rivet.height_mean_mm, height, rivet.height_u95_mm, rivet.decision)
    return Pair(name, "height", None, height, None, "not found")


def _seam_pairs(name: str, true: dict[str, Any], stations: Sequence[SeamStation]) -> list[Pair]:
    """Means over the stations that lie on the seam, against the truth at the same places."""
    course = np.array(true["xyz_mm"])
    rows: dict[str, list[tuple[float, float, float]]] = {"step": [], "width": []}
    decisions = []
    for station in stations:
        if station.x_mm is None:
            continue
        distance = np.linalg.norm(course - np.array([station.x_mm, station.y_mm, station.z_mm]), axis=1)
        if distance.min() > _SAME_SEAM_MM:
            continue
        decisions.append(station.decision)
        for quantity, row in rows.items():
            value, u95 = getattr(station, f"{quantity}_mm"), getattr(station, f"{quantity}_u95_mm")
            if value is not None:
                row.append((value, true[f"{quantity}_mm"][int(distance.argmin())], u95 or np.nan))
    worst = "not found" if not decisions else f"{decisions.count('pass')} of {len(decisions)} pass"
    pairs = []
    for quantity, row in rows.items():
        found, expected, u95 = (
            (float(np.mean(column)) for column in zip(*row, strict=True)) if row else (None, None, None)
        )
        all_true = float(np.mean(true[f"{quantity}_mm"]))
        pairs.append(Pair(name, f"mean {quantity}", found, all_true if expected is None else expected, u95, worst))
    return pairs


def _scene(out: Path, keep: bool) -> tuple[Path, Path]:
    """The scene folder and its rig; rendered unless an earlier one is to be used."""
    scenes = out / "scenes"
    rig = scenes / RIG_FILE
    earlier = sorted(scenes.glob(f"*/{MANIFEST}"))
    if keep and earlier and rig.is_file():
        return earlier[0].parent, rig
    for folder in earlier:
        shutil.rmtree(folder.parent)
    with progress_bar(counted=False) as progress:
        bar = progress.add_task("rendering a panel", total=1.0)
        folders, rig = simulate_folders(
            shipped_spec(_SPEC),
            scenes,
            lambda done, what: progress.update(bar, completed=done, description=f"rendering a panel: {what}"),
        )
    return folders[0], rig


def _table(pairs: list[Pair]) -> Table:
    table = Table(title="Found against true, mm", title_justify="left")
    table.add_column("feature")
    table.add_column("quantity")
    for name in ("found", "true", "error", "U95"):
        table.add_column(name, justify="right")
    table.add_column("verdict")
    for pair in pairs:
        error = None if pair.found is None else pair.found - pair.true
        numbers = [
            _signed(pair.found),
            _signed(pair.true),
            _signed(error),
            "–" if pair.u95 is None else f"{pair.u95:.4f}",
        ]
        table.add_row(pair.feature, pair.quantity, *numbers, pair.decision)
    return table


def _summary(pairs: list[Pair], answer: Answer) -> list[str]:
    errors = [abs(p.found - p.true) for p in pairs if p.quantity == "height" and p.found is not None]
    rivets = [p for p in pairs if p.quantity == "height"]
    lines = [f"{len(errors)} of {len(rivets)} rivets found and measured in {answer.seconds['total']:.1f} s"]
    if errors:
        lines.append(f"height error: mean {np.mean(errors):.4f} mm, largest {max(errors):.4f} mm")
    return lines


def _signed(value: float | None) -> str:
    return "–" if value is None else f"{value:+.4f}"
