"""How far findings lie beyond their limits: what the review's list is sorted by, and says of each."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from dashboard.data import Archive
from dashboard.scenes import required_by
from metrology.errors import FlushlineError
from metrology.kinds import BY_NAME
from metrology.requirements import Requirement
from metrology.tolerance import Limit, PanelSpec
from storage.archive.schema import OF_KIND
from storage.review import Feature


def with_margins(archive: Archive, rows: pd.DataFrame) -> pd.DataFrame:
    """Findings with `margin` (negative: beyond the limit), its `margin_unit`, and `margin_share` of the tolerance.

    Of several quantities it is the one that lies farthest beyond, as a share of what its limits leave.
    """
    found = {}
    for (bundle, kind_name), part in _bundles(archive, rows).groupby(["bundle_path", "feature_kind"], sort=False):
        spec = _specification(archive, bundle)
        if spec is not None:
            found |= _of_scenes(archive, str(kind_name), list(part["scene_id"]), set(part["feature_id"]), spec)
    keys = zip(rows["scene_id"], rows["feature_kind"], rows["feature_id"], strict=True)
    margins = [found.get(key, (float("nan"), "", float("nan"))) for key in keys]
    return rows.assign(**dict(zip(("margin", "margin_unit", "margin_share"), zip(*margins, strict=True), strict=True)))


def _bundles(archive: Archive, rows: pd.DataFrame) -> pd.DataFrame:
    scenes = sorted(set(rows["scene_id"].astype(str)))
    bundles = archive.rows(
        f"SELECT scene_id, bundle_path FROM scenes WHERE scene_id IN ({', '.join('?' * len(scenes))})", scenes
    )
    return rows[["scene_id", "feature_kind", "feature_id"]].merge(bundles, on="scene_id")


def _specification(archive: Archive, bundle: object) -> PanelSpec | None:
    try:
        return archive.specification(bundle)
    except FlushlineError:  # a bundle that is not here any more
        return None


def _of_scenes(
    archive: Archive, kind_name: str, scenes: Sequence[str], wanted: set[str], spec: PanelSpec
) -> dict[tuple[str, str, str], tuple[float, str, float]]:
    kind = BY_NAME[kind_name]
    columns = ", ".join(column.name for column in OF_KIND[kind_name].columns)
    named = sorted(set(scenes))
    rows = archive.rows(
        f"SELECT {columns}, {kind.id_sql} AS feature_id FROM {kind.table} "
        f"WHERE scene_id IN ({', '.join('?' * len(named))})",
        named,
    )
    found: dict[tuple[str, str, str], tuple[float, str, float]] = {}
    for row in rows.itertuples():
        for name in {row.feature_id, getattr(row, "stretch", None)} & wanted:
            margin = _worst(required_by(Feature(kind_name, row.feature_id), row, spec))
            key = (row.scene_id, kind_name, name)
            if margin is not None and (key not in found or margin[2] < found[key][2]):
                found[key] = margin
    return found


def _worst(required: Sequence[Requirement]) -> tuple[float, str, float] | None:
    margins = [_margin(r, r.limit) for r in required if r.limit is not None and r.value is not None]
    return min(margins, key=lambda margin: margin[2], default=None)


def _margin(required: Requirement, limit: Limit) -> tuple[float, str, float]:
    margin = limit.margin(float(required.value or 0.0))
    _, reach = limit.scaling or (0.0, 1.0)
    return margin, required.unit, margin / reach
