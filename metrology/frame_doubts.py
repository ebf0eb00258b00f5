"""What a scan's frames make doubtful beyond the U95 of its values, and what becomes of what was measured in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from metrology.kinds import BY_NAME, DEFECT
from metrology.plausibility import without
from metrology.results import Feature


@dataclass(frozen=True)
class Place:
    """A part of the left image, px."""

    u_px: tuple[float, float]
    v_px: tuple[float, float]
    """u_px, v_px: from, to."""

    def meets(self, row: Feature) -> bool:
        """Whether a feature, as wide as its picture, reaches into it."""
        half = (getattr(row, "major_px", None) or 0.0) / 2
        across = self.u_px[0] - half <= row.u_px <= self.u_px[1] + half
        return bool(across and self.v_px[0] - half <= row.v_px <= self.v_px[1] + half)


@dataclass(frozen=True)
class FrameDoubt:
    """Something about the frames."""

    warning: str
    """The whole sentence: which camera, what was found, what it does, what to do."""
    clause: str
    """What was found, in short: a reason."""
    relief: bool = False
    """Whether it may look like a dent or a bump: a person must confirm those that were found."""
    quantities: tuple[str, ...] = ()
    """Names of the quantities whose values it falsifies by more than their U95."""
    places: tuple[Place, ...] | None = None
    """Where; None for the whole picture."""

    def concerns(self, row: Feature) -> bool:
        """Whether a feature lies where something is doubtful."""
        return self.places is None or any(place.meets(row) for place in self.places)


def without_doubtful(
    features: Mapping[str, Sequence[Feature]], doubts: Sequence[FrameDoubt]
) -> dict[str, Sequence[Feature]]:
    """Features, by kind, without the values that cannot be believed; defects are unconfirmed where relief cannot."""
    kept = dict(features)
    for doubt in doubts:
        for name, rows in kept.items():
            for quantity in BY_NAME[name].quantities:
                if quantity.name in doubt.quantities:
                    rows = [
                        row
                        if getattr(row, quantity.column) is None or not doubt.concerns(row)
                        else without(row, quantity, f"{quantity.name} not measured; {doubt.clause}")
                        for row in rows
                    ]
            if name == DEFECT.name and doubt.relief:
                rows = [
                    replace(row, decision="unconfirmed", reason="; ".join(filter(None, (row.reason, doubt.clause))))
                    if doubt.concerns(row)
                    else row
                    for row in rows
                ]
            kept[name] = rows
    return kept
