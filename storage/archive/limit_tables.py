"""The limits that scans and panels were judged by as a table for SQL: `limits`, from the runs' own manifests."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrology.errors import FlushlineError, SpecError, StoreError
from metrology.kinds import KINDS, RIVET, Kind, LimitName, Quantity
from metrology.limits import DEFAULT_ZONE, GradedLimit, Limit
from metrology.panel import NominalSeam, PanelLayout
from storage.archive.layout import MANIFEST

if TYPE_CHECKING:
    import duckdb
    import pyarrow as pa

    from storage.panel_spec import PanelSpecification

LIMITS_COLUMNS = {
    "panel": "panel of the aircraft",
    "panel_spec": "panel and revision of the specification, as scenes and panels have it",
    "revision": "revision of the specification",
    "example": "whether its limits are an example and nobody's requirement",
    "config_hashes": "settings and limits of the scans judged by it, as scenes have them; none for a panel alone",
    "n_scenes": "scans judged by it",
    "first_captured_at": "when the first scan or panel judged by it was taken (UTC)",
    "last_captured_at": "when the last one was",
    "zone": "the tolerance zone; features without one of their own are in the zone default",
    "holds_for": "rivets and seams of the zone, with the stretch along a seam in mm; NULL where none is named",
    "kind": "kind of feature; NULL where the specification cannot be read",
    "quantity": "the quantity",
    "depends_on": "into the wind, out of the wind, or the extent that the limit goes with; NULL where of the value",
    "lower": "the value is not to be less; NULL where that side is open",
    "upper": "the value is not to be more; NULL where that side is open; the greatest of what goes with an extent",
    "serious_lower": "below this a deviation is serious",
    "serious_upper": "beyond this a deviation is serious",
    "unit": "of these limits",
    "steps": "of a limit that goes with an extent: limit at extent in mm, straight between them",
    "inherited": "whether the zone leaves it open, so that the limit of the zone default holds",
    "source": "the document that the limit comes from",
    "source_revision": "its revision",
    "problem": "why the specification cannot be read; its limits are not in this table",
}
_ALONG = ("into the wind", "out of the wind")
"""What the limits of a quantity are of, beside its value (`metrology.kind.Quantity.into_wind`)."""


@dataclass
class _Judged:
    """What was judged by one specification, of a panel."""

    panel: str
    panel_spec: str | None
    specification: PanelSpecification | None
    problem: str | None
    config_hashes: set[str] = field(default_factory=set)
    n_scenes: int = 0
    times: list[datetime] = field(default_factory=list)

    @property
    def columns(self) -> dict[str, Any]:
        """What all its limits have in common."""
        spec = self.specification
        return {
            "panel": self.panel,
            "panel_spec": self.panel_spec,
            "revision": spec.limits.revision if spec else None,
            "example": spec.example if spec else None,
            "config_hashes": sorted(self.config_hashes),
            "n_scenes": self.n_scenes,
            "first_captured_at": min(self.times),
            "last_captured_at": max(self.times),
            "problem": self.problem,
        }


def register_limits(connection: duckdb.DuckDBPyConnection, root: Path) -> None:
    """Make the table known to a connection."""
    connection.register("limits", limits(connection, root))


def limits(connection: duckdb.DuckDBPyConnection, root: Path) -> pa.Table:
    """A row per limit of each zone of each specification that the newest runs were judged by.

    Scans of equal settings were judged alike, so one manifest is read for each of these. Of assembled panels, those of
    the first and the last one are read for each name of a specification, and where these differ, as many between them
    as tell since when. Where a manifest cannot be read, a row says why.
    """
    import pyarrow as pa

    rows = [row for judged in _all_judged(connection, root) for row in _rows(judged)]
    return pa.table({name: pa.array([row.get(name) for row in rows], _type(name)) for name in LIMITS_COLUMNS})


def _type(name: str) -> pa.DataType:
    import pyarrow as pa

    if name.endswith("_at"):
        return pa.timestamp("us", "UTC")
    if name == "config_hashes":
        return pa.list_(pa.string())
    if name == "n_scenes":
        return pa.int64()
    if name.endswith(("lower", "upper")):
        return pa.float64()
    return pa.bool_() if name in ("example", "inherited") else pa.string()


def _all_judged(connection: duckdb.DuckDBPyConnection, root: Path) -> list[_Judged]:
    """What the index shows, by panel and by what its specification says."""
    found = connection.execute(
        "SELECT panel, panel_spec, config_hash, count(*), arg_max(bundle_path, captured_at), min(captured_at), "
        "max(captured_at) FROM scenes GROUP BY ALL ORDER BY ALL"
    ).fetchall()
    found = sorted([*found, *_assemblies(connection, root)], key=lambda row: (row[0], row[1] or "", row[2] or ""))
    judged: dict[tuple[str, str | None, str], _Judged] = {}
    for panel, named, config, n, bundle, *times in found:
        document, problem = _document(root, bundle)
        specification = None
        if problem is None:
            specification, problem = _specification(document, bundle)
        key = panel, named, problem or json.dumps(document, sort_keys=True, default=str)
        one = judged.setdefault(key, _Judged(panel, named, specification, problem))
        one.config_hashes |= {config} - {None}
        one.n_scenes += n
        one.times += times
    return list(judged.values())


def _assemblies(connection: duckdb.DuckDBPyConnection, root: Path) -> Iterator[tuple[Any, ...]]:
    """Assembled panels that were judged alike, as rows of the same columns: by one specification after the other."""
    order = "ORDER BY processed_at, bundle_path"
    found = connection.execute(
        f"SELECT panel, panel_spec, list(bundle_path {order}), list(captured_at {order}) FROM panels GROUP BY ALL"
    ).fetchall()
    for panel, named, bundles, times in found:
        read = cache(partial(_nth_document, root, bundles))
        for first, last in _alike(read, 0, len(bundles) - 1):
            taken = times[first : last + 1]
            yield panel, named, None, 0, bundles[last], min(taken), max(taken)


def _nth_document(root: Path, bundles: Sequence[str], k: int) -> tuple[Mapping[str, Any], str | None]:
    return _document(root, bundles[k])


def _alike(read: Callable[[int], object], first: int, last: int) -> Iterator[tuple[int, int]]:
    """From which to which one all are the same, by halving: where both ends are, so is what lies between them."""
    if read(first) == read(last):
        yield first, last
        return
    middle = (first + last) // 2
    yield from _alike(read, first, middle)
    yield from _alike(read, middle + 1, last)


def _document(root: Path, bundle: str) -> tuple[Mapping[str, Any], str | None]:
    """The specification that a run keeps, or why it cannot be read."""
    from storage.documents import read_json
    from storage.models import leads_inside

    if not leads_inside(bundle):
        return {}, f"{bundle}: found a path that leads out of the store, expected one of a bundle"
    try:
        document = read_json(root / bundle / MANIFEST, StoreError).get("panel_spec")
    except FlushlineError as problem:
        return {}, str(problem).replace(f"{root}/", "")
    if not isinstance(document, dict) or not document:
        return {}, f"{bundle}/{MANIFEST}: found no panel_spec, expected the specification that it was judged by"
    return document, None


def _specification(document: Mapping[str, Any], bundle: str) -> tuple[PanelSpecification | None, str | None]:
    from storage.panel_spec import panel_spec_from

    try:
        return panel_spec_from(document, Path(bundle) / MANIFEST), None
    except SpecError as problem:
        return None, str(problem)


def _rows(judged: _Judged) -> Iterator[dict[str, Any]]:
    if judged.specification is None:
        yield judged.columns
        return
    limited, layout = judged.specification.limits, judged.specification.layout
    for zone in dict.fromkeys((DEFAULT_ZONE, *limited.zones)):
        own, held = limited.zones.get(zone, {}), limited.zone(zone)
        for kind in KINDS:
            place = {**judged.columns, "zone": zone, "kind": kind.name, "holds_for": _holds_for(kind, zone, layout)}
            for quantity in kind.quantities:
                for name, depends_on in _asked(quantity):
                    if limit := held.get(name.name):
                        yield {**place, **_columns(quantity, limit), "depends_on": depends_on,
                               "inherited": name.name not in own}  # fmt: skip


def _asked(quantity: Quantity) -> Iterator[tuple[LimitName, str | None]]:
    """What a zone may ask of a quantity, with what it depends on."""
    yield from zip(quantity.limits, (None, *_ALONG), strict=False)
    if quantity.by_extent:
        yield quantity.by_extent.limit, quantity.by_extent.word


def _columns(quantity: Quantity, limit: Limit) -> dict[str, Any]:
    bounds = {name: value for name, value in asdict(limit).items() if name.endswith(("lower", "upper"))}
    return {
        **bounds,
        "quantity": quantity.said,
        "unit": quantity.unit,
        "steps": limit.said if isinstance(limit, GradedLimit) else None,
        "source": limit.source,
        "source_revision": limit.revision,
    }


def _holds_for(kind: Kind, zone: str, layout: PanelLayout) -> str | None:
    """The features of the pattern that a zone's limits of a kind hold for, for people."""
    if kind is RIVET:
        return ", ".join(rivet.rivet_id for rivet in layout.rivets if rivet.zone == zone) or None
    if kind.is_course:
        return ", ".join(said for seam in layout.seams for said in _stretches(seam, zone)) or None
    return None


def _stretches(seam: NominalSeam, zone: str) -> Iterator[str]:
    """Where along a seam a zone's limits hold."""
    if seam.zone == zone:
        other = ", ".join(f"{start:g}–{end:g} mm" for start, end, named in seam.stretches if named != zone)
        yield f"{seam.seam_id} but {other}" if other else seam.seam_id
        return
    yield from (f"{seam.seam_id} {start:g}–{end:g} mm" for start, end, named in seam.stretches if named == zone)
