"""How what scans of a station show differs, with the uncertainty of each difference."""

from __future__ import annotations

from functools import reduce

import numpy as np
import pandas as pd

from dashboard.figures.scene import SceneFeatures
from metrology.kinds import RIVET, SEAM_STATION, Kind, Quantity
from storage.archive.work import NEAR_MM

_COMPARED = ((RIVET, RIVET.quantities[0]), *((SEAM_STATION, quantity) for quantity in SEAM_STATION.quantities))
"""Kinds and quantities, in millimetres all of them."""


def differences(*scans: SceneFeatures) -> pd.DataFrame:
    """Every height, step and gap, the largest change first.

    Heads are the same by their names, and also listed where not all scans have them; positions of a seam are those of
    the first scan that has positions, and the same by where they lie along it. Columns: feature_id, quantity; of each
    scan from 1 on, value_mm_1 and decision_1; of each further one its change from the first, difference_mm_2, and
    difference_u95_mm_2: the root of the sum of both uncertainties' squares, as two scans share no noise.
    """
    parts = [_of_quantity(kind, quantity, [scan[kind.name] for scan in scans]) for kind, quantity in _COMPARED]
    rows = pd.concat([part for part in parts if len(part)] or parts[:1], ignore_index=True)
    later = range(2, len(scans) + 1)
    for number in later:
        rows[f"difference_mm_{number}"] = rows[f"value_mm_{number}"] - rows["value_mm_1"]
        rows[f"difference_u95_mm_{number}"] = np.hypot(rows["u95_mm_1"], rows[f"u95_mm_{number}"])
    largest = rows[[f"difference_mm_{number}" for number in later]].abs().max(axis=1)
    order = largest.sort_values(ascending=False, na_position="last", kind="stable").index
    return rows.loc[order].reset_index(drop=True)


def _of_quantity(kind: Kind, quantity: Quantity, scans: list[pd.DataFrame]) -> pd.DataFrame:
    values = [_values(kind, quantity, rows, number) for number, rows in enumerate(scans, 1)]
    if kind.is_course:
        # Positions are those of a scan that has any; one without leaves the others' alone.
        base = next((part for part in values if len(part)), values[0])
        both = reduce(_nearest, (part for part in values if part is not base), base)
    else:
        both = reduce(lambda one, other: one.merge(other, on=["name", "quantity"], how="outer"), values)
    named = both[[f"feature_id_{number}" for number in range(1, len(scans) + 1)]]
    both["feature_id"] = named.bfill(axis=1).iloc[:, 0]
    return both


def _nearest(one: pd.DataFrame, other: pd.DataFrame) -> pd.DataFrame:
    """Beside each position of one scan the nearest one of another, where it is the same place."""
    return pd.merge_asof(
        one.sort_values("at_mm"), other.sort_values("at_mm"), on="at_mm", by=["name", "quantity"],
        direction="nearest", tolerance=NEAR_MM,
    )  # fmt: skip


def _values(kind: Kind, quantity: Quantity, rows: pd.DataFrame, number: int) -> pd.DataFrame:
    """A scan's values; columns that every scan has of its own bear its number."""
    name, *position = kind.id_columns
    own = {"feature_id": "feature_id", quantity.column: "value_mm", quantity.u95_column: "u95_mm",
           "decision": "decision"}  # fmt: skip
    taken = {name: "name", **dict.fromkeys(position, "at_mm"), **{c: f"{word}_{number}" for c, word in own.items()}}
    values = rows[list(taken)].rename(columns=taken).assign(quantity=quantity.name)
    values = values.dropna(subset=["at_mm"]) if position else values
    numbers = [f"value_mm_{number}", f"u95_mm_{number}", *(["at_mm"] if position else [])]
    return values.astype(dict.fromkeys(numbers, float))
