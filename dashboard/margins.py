"""How far findings lie beyond their limits: what the review's list is sorted by, and says of each."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import pandas as pd

from dashboard.data import Archive, Margin, Name
from metrology.errors import FlushlineError
from metrology.kinds import BY_NAME, Kind
from metrology.requirements import Requirement, of_quantity, requirements
from metrology.tolerance import PanelSpec, decisive
from storage.archive.rows import result_of
from storage.archive.schema import OF_KIND

_MOST_BUNDLES = 5  # that are asked for their specification
_NAN = float("nan")
_UNKNOWN: Margin = (_NAN, "", _NAN, "", _NAN, _NAN)
_COLUMNS = ("margin", "margin_unit", "margin_share", "quantity", "quantity_value", "quantity_u95")


def with_margins(archive: Archive, rows: pd.DataFrame) -> pd.DataFrame:
    """Findings with `margin` (negative: beyond the limit), its `margin_unit`, and `margin_share` of the tolerance.

    Beside them `quantity`, `quantity_value` and `quantity_u95`: what the verdict is about. Of several quantities it is
    the one that lies farthest beyond, as a share of what its limits leave.
    """
    known = archive.margins()
    keys = list(zip(rows["scene_id"], rows["feature_kind"], rows["feature_id"], strict=True))
    new = rows[[key not in known for key in keys]]
    # Runs with the same settings and limits are looked at together: in a real store each scan has a bundle of its own.
    alike = ["config_hash", "panel_spec", "feature_kind"]
    parts = _runs(archive, new).groupby(alike, sort=False, dropna=False) if len(new) else ()
    for (*_run, kind_name), part in parts:
        spec = _specification(archive, part["bundle_path"])
        known |= dict.fromkeys(zip(part["scene_id"], part["feature_kind"], part["feature_id"], strict=True), _UNKNOWN)
        if spec is not None:
            known |= _of_findings(archive, str(kind_name), part, spec)
    margins = [known.get(key, _UNKNOWN) for key in keys]
    return rows.assign(**dict(zip(_COLUMNS, zip(*margins, strict=True), strict=True)))


def mixed(rows: pd.DataFrame) -> bool:
    """Whether a verdict of these findings is about another quantity than the first of its kind."""
    return any(name and name != first for name, first in zip(rows["quantity"], _firsts(rows), strict=True))


def about_the_verdict(rows: pd.DataFrame) -> pd.DataFrame:
    """The findings with the quantity that each one's verdict is about, its value and its U95."""
    first = pd.Series(_firsts(rows), rows.index)
    quantity = rows["quantity"].where(rows["quantity"] != "", first)
    other = quantity != first
    return rows.assign(
        quantity=quantity,
        value_mm=rows["value_mm"].mask(other, rows["quantity_value"]),
        u95_mm=rows["u95_mm"].mask(other, rows["quantity_u95"]),
    )


def _firsts(rows: pd.DataFrame) -> list[str]:
    return [BY_NAME[kind].quantities[0].name for kind in rows["feature_kind"]]


def _runs(archive: Archive, rows: pd.DataFrame) -> pd.DataFrame:
    scenes = rows[["scene_id", "captured_at", "feature_kind", "feature_id"]]
    return archive.rows_about(
        "SELECT wanted.*, bundle_path, config_hash, panel_spec FROM wanted "
        # By the time first: comparing it costs a tenth of comparing names.
        "JOIN (FROM scenes SEMI JOIN wanted USING (captured_at)) USING (scene_id)",
        scenes,
    )


def _specification(archive: Archive, bundles: pd.Series) -> PanelSpec | None:
    """By what runs with the same settings were judged: what the first of their bundles says that is there."""
    for bundle in bundles.unique()[:_MOST_BUNDLES]:
        with suppress(FlushlineError):  # a bundle that is not here any more
            return archive.specification(bundle)
    return None


def _of_findings(archive: Archive, kind_name: str, findings: pd.DataFrame, spec: PanelSpec) -> dict[Name, Margin]:
    """Margins of findings of one kind, and what they are about.

    Of a stretch it is that of the position that pages show it by (see `find_feature`).
    """
    kind = BY_NAME[kind_name]
    columns = ", ".join(column.name for column in OF_KIND[kind_name].columns)
    same = "named = feature_id OR named = stretch" if kind.is_course else "named = feature_id"
    worst = "PARTITION BY scene_id, named ORDER BY beyond_mm DESC NULLS LAST"
    # By the time first: comparing it costs a tenth of comparing names, and leaves little to compare.
    rows = archive.rows_about(
        f"SELECT {columns}, feature_id, named "
        f"FROM (SELECT *, {kind.id_sql} AS feature_id FROM {kind.table} SEMI JOIN wanted USING (captured_at)) "
        f"JOIN (SELECT scene_id, feature_id AS named FROM wanted) USING (scene_id) WHERE {same}"
        + (f" QUALIFY row_number() OVER ({worst}) = 1" if kind.is_course else ""),
        findings,
    )
    return {(row.scene_id, kind_name, row.named): _of_row(kind, row, spec) for row in rows.itertuples()}


def _of_row(kind: Kind, row: Any, spec: PanelSpec) -> Margin:
    result = result_of(kind.row_type, row._asdict())
    about = decisive(kind, result, spec)
    if about is None:
        return (*_worst(requirements(kind, result, spec)), "", _NAN, _NAN)
    value, u95 = (getattr(result, name) for name in (about.column, about.u95_column))
    worst = _worst(of_quantity(about, result, spec.zone(result.zone)))
    return (*worst, about.name, _NAN if value is None else value, _NAN if u95 is None else u95)


def _worst(required: Sequence[Requirement]) -> tuple[float, str, float]:
    margins = [
        (r.limit.margin(r.value), r.unit, r.limit.margin_share(r.value))
        for r in required
        if r.limit is not None and r.value is not None
    ]
    return min(margins, key=lambda margin: margin[2], default=(_NAN, "", _NAN))
