"""What the assembly of a panel leaves behind, complete, as the archive takes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

from metrology.assembly.assemble import Assembly, place_u95
from metrology.assembly.carried import Names
from metrology.assembly.coverage import Coverage
from metrology.assembly.panel import PanelFeatures
from metrology.assembly.picture import Stitched
from metrology.assembly.rows import DifferenceRow, StationRow
from metrology.assembly.verdict import Judgement
from metrology.results import PanelKey, SceneKey


@dataclass(frozen=True)
class PanelResult:
    """An assembled panel."""

    key: PanelKey
    assembly: Assembly
    runs: Mapping[SceneKey, str]
    """The run of each scan that went in."""
    features: PanelFeatures
    """By kind, named and judged."""
    panel_spec: Mapping[str, Any]
    """The specification that it was judged by, as plain values."""
    spec_name: str
    """Its panel and revision."""
    judgement: Judgement
    coverage: Coverage
    warnings: tuple[str, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict)
    pictures: tuple[Stitched, ...] = ()
    """Of each part."""
    remembered: Names = field(default_factory=dict)
    """Names of earlier assemblies that nothing in this one has."""

    @property
    def captured_at(self) -> datetime:
        """When the newest of its scans was taken."""
        return max(scan.key.captured_at for scan in self.assembly.scans)

    def station_rows(self) -> list[StationRow]:
        """Its scans, placed or left out."""
        rows = {}
        for part_number, part in enumerate(self.assembly.parts, 1):
            for index, (number, placement) in enumerate(zip(part.numbers, part.fit.placements, strict=True)):
                x, y, z = placement.t.tolist()
                rows[number] = StationRow(
                    *self._names(number),
                    part_number,
                    "specification" if part.nominal else "own",
                    tuple(placement.R.ravel().tolist()),
                    x,
                    y,
                    z,
                    place_u95(part, self.assembly.scans, index),
                    frame_id=part.frame_id,
                )
        for number, why in self.assembly.left_out.items():
            rows[number] = StationRow(*self._names(number), None, reason=why)
        return [rows[number] for number in sorted(rows)]

    def _names(self, number: int) -> tuple[str, str, str]:
        key = self.assembly.scans[number].key
        return key.station, key.scene_id, self.runs[key]

    def difference_rows(self) -> list[DifferenceRow]:
        """What was measured by several scans."""
        ids = [scan.key.scene_id for scan in self.assembly.scans]
        return [
            DifferenceRow(
                feature.kind.name,
                feature.kind.id_of(feature.row),
                each.quantity.name,
                each.quantity.unit,
                ids[each.scans[0]],
                ids[each.scans[1]],
                each.values[0],
                each.values[1],
                each.values[1] - each.values[0],
                each.u95,
                each.beyond,
            )
            for features in self.features.values()
            for feature in features
            for each in feature.differences
        ]

    @property
    def sides(self) -> dict[str, dict[str, float]]:
        """Where side B of each course lies (see `PanelFeature.side`), by kind and name."""
        return {
            kind: {feature.name: feature.side for feature in features if feature.side}
            for kind, features in self.features.items()
        }

    def feature_columns(self, kind: str) -> Sequence[dict[str, Any]]:
        """What `panel_…` tables have of each feature beside the kind's own columns."""
        ids = [scan.key for scan in self.assembly.scans]
        return [
            {
                "station": ids[feature.best].station,
                "part": feature.part,
                "best_scene_id": ids[feature.best].scene_id,
                "n_scans": len(feature.seen_by),
                "n_measured": len(feature.measured_by),
                "seen_by": [ids[k].scene_id for k in feature.seen_by],
                "seen_as": list(feature.seen_as),
                "place_u95_mm": feature.place_u95_mm,
            }
            for feature in self.features[kind]
        ]
