"""How what two scans of a station show differs, with the uncertainty of each difference."""

from __future__ import annotations

import numpy as np
import pandas as pd

from dashboard.figures.scene import SceneFeatures
from metrology.kinds import RIVET, SEAM_STATION, Kind, Quantity
from storage.archive.work import NEAR_MM

_COMPARED = ((RIVET, RIVET.quantities[0]), *((SEAM_STATION, quantity) for quantity in SEAM_STATION.quantities))
"""Kinds and quantities, in millimetres all of them."""


def differences(left: SceneFeatures, right: SceneFeatures) -> pd.DataFrame:
    """Every height, step and gap, the largest change first.

    Heads are the same by their names, and also listed where one scan alone has them; positions of a seam are those of
    the left scan, and the same by where they lie along it. Columns: feature_id, quantity, value_mm_left, decision_left,
    value_mm_right, decision_right, difference_mm and difference_u95_mm: the root of the sum of both uncertainties'
    squares, as two scans share no noise.
    """
    parts = [_of_quantity(kind, quantity, left[kind.name], right[kind.name]) for kind, quantity in _COMPARED]
    both = pd.concat([part for part in parts if len(part)] or parts[:1], ignore_index=True)
    both["difference_mm"] = both["value_mm_right"] - both["value_mm_left"]
    both["difference_u95_mm"] = np.hypot(both["u95_mm_left"], both["u95_mm_right"])
    return both.sort_values("difference_mm", key=abs, ascending=False, na_position="last", ignore_index=True)


def _of_quantity(kind: Kind, quantity: Quantity, *sides: pd.DataFrame) -> pd.DataFrame:
    before, after = (_values(kind, quantity, rows) for rows in sides)
    if not kind.is_course or before.empty or after.empty:
        both = before.merge(after, on=["name", "quantity"], how="outer", suffixes=("_left", "_right"))
    else:
        both = pd.merge_asof(
            before.sort_values("at_mm"), after.sort_values("at_mm"), on="at_mm", by=["name", "quantity"],
            direction="nearest", tolerance=NEAR_MM, suffixes=("_left", "_right"),
        )  # fmt: skip
    both["feature_id"] = both["feature_id_left"].fillna(both["feature_id_right"])
    return both


def _values(kind: Kind, quantity: Quantity, rows: pd.DataFrame) -> pd.DataFrame:
    name, *position = kind.id_columns
    taken = {name: "name", "feature_id": "feature_id", quantity.column: "value_mm", quantity.u95_column: "u95_mm",
             "decision": "decision", **dict.fromkeys(position, "at_mm")}  # fmt: skip
    values = rows[list(taken)].rename(columns=taken).assign(quantity=quantity.name)
    values = values.dropna(subset=["at_mm"]) if position else values
    return values.astype({"value_mm": float, "u95_mm": float, **dict.fromkeys(("at_mm",) if position else (), float)})
