"""How far findings lie beyond their limits: what the review's list is sorted by, and says of each."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import pandas as pd

from dashboard.data import Archive, Margin, Name
from dashboard.scenes import required_by
from metrology.errors import FlushlineError
from metrology.kinds import BY_NAME
from metrology.requirements import Requirement
from metrology.tolerance import Limit, PanelSpec
from storage.archive.schema import OF_KIND
from storage.review import Feature

_MOST_BUNDLES = 5  # that are asked for their specification
_UNKNOWN: Margin = (float("nan"), "", float("nan"))


def with_margins(archive: Archive, rows: pd.DataFrame) -> pd.DataFrame:
    """Findings with `margin` (negative: beyond the limit), its `margin_unit`, and `margin_share` of the tolerance.

    Of several quantities it is the one that lies farthest beyond, as a share of what its limits leave.
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
    return rows.assign(**dict(zip(("margin", "margin_unit", "margin_share"), zip(*margins, strict=True), strict=True)))


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
    """Margins of findings of one kind; of a stretch that of the position that pages show it by (see `find_feature`)."""
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
    margins = {
        (row.scene_id, kind_name, row.named): _worst(required_by(Feature(kind_name, row.feature_id), row, spec))
        for row in rows.itertuples()
    }
    return {key: margin for key, margin in margins.items() if margin is not None}


def _worst(required: Sequence[Requirement]) -> Margin | None:
    margins = [_margin(r, r.limit) for r in required if r.limit is not None and r.value is not None]
    return min(margins, key=lambda margin: margin[2], default=None)


def _margin(required: Requirement, limit: Limit) -> Margin:
    margin = limit.margin(float(required.value or 0.0))
    _, reach = limit.scaling or (0.0, 1.0)
    return margin, required.unit, margin / reach
