"""The fits of a run as Parquet: what a close-up draws, one row per rivet, seam station or defect that was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from metrology.errors import StoreError
from metrology.fits import (
    DefectForm,
    DefectSection,
    FittedDefect,
    FittedRivet,
    FittedStation,
    HeadFit,
    SectionFit,
    SkinLine,
)
from metrology.results import Features
from metrology.surfaces import Frame

_SAME_PLACE_MM = 1e-3  # tables are rounded, and stations stand farther apart
_COLUMNS = (
    ("feature_id", pa.string(), "rivet_id, seam_id, or defect_id"),
    ("s_mm", pa.float64(), "position along the seam, mm; NULL for a rivet and a defect"),
    ("origin_mm", pa.list_(pa.float64()), "origin of the fit's frame in the rig frame, mm"),
    ("axes", pa.list_(pa.float64()), "the frame's axes x, y, h in the rig frame, row by row; a seam's x ends at B"),
    ("skin", pa.list_(pa.float64()), "skin round the head: coefficients of 1, x, y, x², xy, y²"),
    ("head", pa.list_(pa.float64()), "the head's own surface likewise"),
    ("circle_mm", pa.list_(pa.float64()), "the head's circle: x, y, radius"),
    ("side_a", pa.list_(pa.float64()), "skin line of side A: coefficients of 1, x, x²"),
    ("side_b", pa.list_(pa.float64()), "skin line of side B likewise"),
    ("n", pa.list_(pa.int32()), "points of the lines of A and B"),
    ("edges_mm", pa.list_(pa.float64()), "x of the edges D′ and G′"),
    ("depths_mm", pa.list_(pa.float64()), "depth of D and G under them; NULL where the width was not measured"),
    ("reach_mm", pa.list_(pa.float64()),
     "where the points lie: rivet: head up to, skin from, to; seam: skin from, to, half length along the seam"),
    ("heights_mm", pa.list_(pa.float32()), "round a defect, above the skin without it, mm, row by row; NaN unseen"),
    ("map", pa.list_(pa.float64()),
     "of these: columns, step (mm), x and y of the first from the deepest point (mm), direction of the length (rad)"),
    ("outline_mm", pa.list_(pa.float32()), "x, y of the defect's outline at half depth on that map"),
    ("along_mm", pa.list_(pa.float32()),
     "section along the defect: positions, then heights of the surface, of the skin without it, of a straight-edge"),
    ("across_mm", pa.list_(pa.float32()), "section across it likewise"),
)  # fmt: skip
_OF_DEFECTS = "map"
_SCHEMA = pa.schema([pa.field(name, kind, metadata={"comment": said}) for name, kind, said in _COLUMNS])


@dataclass(frozen=True)
class StoredFits:
    """The fits of a run; None where a feature has none."""

    rows: Sequence[dict[str, Any]]

    def head(self, rivet_id: str) -> HeadFit | None:
        """The fit of a rivet."""
        row = next((r for r in self.rows if r["skin"] is not None and r["feature_id"] == rivet_id), None)
        if row is None:
            return None
        inner, *outer = row["reach_mm"]
        skin, head = np.array(row["skin"]), np.array(row["head"])
        (x, y, radius), (start, end) = row["circle_mm"], outer
        return HeadFit(_frame(row), skin, head, x, y, radius, inner, (start, end))

    def section(self, seam_id: str, s_mm: float) -> SectionFit | None:
        """The fit of a seam station."""
        near = [r for r in self.rows if r["feature_id"] == seam_id and r["s_mm"] is not None]
        row = next((r for r in near if abs(r["s_mm"] - s_mm) < _SAME_PLACE_MM), None)
        if row is None:
            return None
        a, b = (SkinLine(np.array(row[f"side_{side}"]), n) for side, n in zip("ab", row["n"], strict=True))
        depths = None if row["depths_mm"] is None else tuple(row["depths_mm"])
        return SectionFit(_frame(row), a, b, tuple(row["edges_mm"]), depths, *row["reach_mm"])

    def form(self, defect_id: str) -> DefectForm | None:
        """The form of a defect."""
        row = next((r for r in self.rows if r.get(_OF_DEFECTS) and r["feature_id"] == defect_id), None)
        if row is None:
            return None
        columns, step, x, y, turn = row[_OF_DEFECTS]
        along, across = (
            DefectSection(*np.array(row[name], float).reshape(4, -1)) for name in ("along_mm", "across_mm")
        )
        heights = np.array(row["heights_mm"], float).reshape(-1, int(columns))
        outline = np.array(row["outline_mm"], float).reshape(-1, 2)
        return DefectForm(heights, (x, y), step, outline, along, across, turn)


def write_fits(path: Path, features: Features) -> None:
    """Write the fits that a result's rows carry."""
    found = [row for of_kind in features.values() for row in of_kind]
    rows = [_head_row(r.rivet_id, r.fit) for r in found if isinstance(r, FittedRivet) and r.fit is not None]
    rows += [
        _section_row(s.seam_id, s.s_mm, s.fit) for s in found if isinstance(s, FittedStation) and s.fit is not None
    ]
    rows += [_form_row(d.defect_id, d.form) for d in found if isinstance(d, FittedDefect) and d.form is not None]
    pq.write_table(pa.Table.from_pylist(rows, _SCHEMA), path, compression="zstd", use_dictionary=False)


def read_fits(path: Path) -> StoredFits:
    """Read the fits of a run."""
    try:
        # Versions before 2026-12 kept no defects' forms.
        known = [name for name in _SCHEMA.names if name in pq.read_schema(path).names]
        return StoredFits(pq.read_table(path, columns=known).to_pylist())
    except (OSError, KeyError, pa.ArrowException) as problem:
        raise StoreError(f"{path}: found {problem}, expected the fits of a run") from None


def _head_row(rivet_id: str, fit: HeadFit) -> dict[str, Any]:
    return {
        "feature_id": rivet_id,
        **_frame_row(fit.frame),
        "skin": fit.skin.tolist(),
        "head": fit.head.tolist(),
        "circle_mm": [fit.x, fit.y, fit.radius],
        "reach_mm": [fit.inner_mm, *fit.outer_mm],
    }


def _section_row(seam_id: str, s_mm: float, fit: SectionFit) -> dict[str, Any]:
    return {
        "feature_id": seam_id,
        "s_mm": s_mm,
        **_frame_row(fit.frame),
        "side_a": fit.a.coefficients.tolist(),
        "side_b": fit.b.coefficients.tolist(),
        "n": [fit.a.n, fit.b.n],
        "edges_mm": list(fit.edges_mm),
        "depths_mm": None if fit.depths_mm is None else list(fit.depths_mm),
        "reach_mm": [fit.inner_mm, fit.outer_mm, fit.half_length_mm],
    }


def _form_row(defect_id: str, form: DefectForm) -> dict[str, Any]:
    along, across = (
        np.concatenate([line.t, line.surface, line.skin, line.edge]).round(4).tolist()
        for line in (form.along, form.across)
    )
    return {
        "feature_id": defect_id,
        "heights_mm": form.heights.round(4).ravel().tolist(),
        _OF_DEFECTS: [form.heights.shape[1], form.step_mm, *form.corner, form.turn],
        "outline_mm": form.outline.round(3).ravel().tolist(),
        "along_mm": along,
        "across_mm": across,
    }


def _frame_row(frame: Frame) -> dict[str, Any]:
    return {"origin_mm": frame.origin.tolist(), "axes": frame.axes.ravel().tolist()}


def _frame(row: dict[str, Any]) -> Frame:
    return Frame(np.array(row["origin_mm"]), np.array(row["axes"]).reshape(3, 3))
