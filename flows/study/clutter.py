"""What a finding that is no rivet lies on, and how many rivets of each kind were found."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from flows.study.document import Cell, Column, Table
from flows.study.series import RigKind, Series, known
from flows.study.values import found_rivets
from simulator.marks import letters_reach
from simulator.panel import Panel
from simulator.truth import TrueRivet
from storage.archive import Store


def lies_on(panel: Panel, x: float, y: float) -> str:
    """What of a panel's clutter is at a place of it (mm), "bare skin" where nothing is."""
    near: list[tuple[str, float, float, float]] = [
        *(("open hole", h.x_mm, h.y_mm, 0.5 * max(h.diameter_mm, h.countersink_mm)) for h in panel.holes),
        *(("temporary fastener", c.x_mm, c.y_mm, 0.5 * c.diameter_mm + c.height_mm) for c in panel.clecos),
        *(("painted ring or sticker", p.x_mm, p.y_mm, 0.5 * math.hypot(*p.size_mm)) for p in panel.surface.patches
          if p.shape != "smudge"),
        *(("dent or bump", d.x_mm, d.y_mm, d.axes_mm[0]) for d in panel.all_dents),
        *(("chip or drop", k.x_mm, k.y_mm, 0.5 * k.diameter_mm) for k in panel.specks),
    ]  # fmt: skip
    for kind, px, py, radius in near:
        if math.hypot(x - px, y - py) < radius + 1.0:
            return kind
    for stencil in panel.surface.stencils:
        angle = math.radians(stencil.angle_deg)
        dx, dy = x - stencil.x_mm, y - stencil.y_mm
        along, across = math.cos(angle) * dx + math.sin(angle) * dy, math.cos(angle) * dy - math.sin(angle) * dx
        if abs(along) < letters_reach(stencil) and abs(across) < 0.5 * stencil.cap_mm + 1.5:
            return "letters"
    for stroke in panel.surface.strokes:
        points = np.array(stroke.points_mm)
        if np.hypot(*(points - [x, y]).T).min() < 2 * stroke.width_mm + 2.0:
            return "grease pencil"
    return "bare skin"


def kinds_table(store: Store, series: Sequence[Series], rig: RigKind) -> Table:
    """Heads found of each kind, and false findings by what they lie on."""
    true, found, false = Counter[str](), Counter[str](), Counter[str]()
    for one in series:
        pose, panel = known(one.simulation, 0).pose, one.simulation.panel
        for trues, rows in found_rivets(store, one, rig):
            for rivet in trues:
                if rivet.visible:
                    true[rivet.kind] += 1
                    found[rivet.kind] += any(_on(rivet, row) for row in rows)
            for row in rows:
                if row["decision"] != "unconfirmed" and not any(_on(rivet, row) for rivet in trues):
                    false[_place(panel, pose.to_panel(_point(row)))] += 1
    cells: list[list[Cell]] = [[kind, true[kind], found[kind], 100 * found[kind] / true[kind]] for kind in sorted(true)]
    cells += [[f"false, on: {kind}", None, count, None] for kind, count in sorted(false.items())]
    columns = (Column("kind"), Column("in view", 0), Column("found", 0), Column("recall, %", 1))
    return Table("detection-kinds", "Findings by kind", columns, cells)


def _on(rivet: TrueRivet, row: dict[str, Any]) -> bool:
    """Whether a row's ellipse holds a rivet's centre in its inner half."""
    return bool(np.hypot(row["u_px"] - rivet.uv_px[0], row["v_px"] - rivet.uv_px[1]) < row["minor_px"] / 4)


def _point(row: dict[str, Any]) -> np.ndarray:
    return np.array([row["x_mm"], row["y_mm"], row["z_mm"]], float)


def _place(panel: Panel, point: np.ndarray) -> str:
    return "an unknown place" if np.isnan(point).any() else lies_on(panel, float(point[0]), float(point[1]))
