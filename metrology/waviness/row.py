"""The waviness of a piece of skin as it is stored: one row of `waviness`, and its settings."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Annotated, Literal

from metrology.errors import UsageError
from metrology.results import Feature

Direction = Literal["along", "across"]


@dataclass(frozen=True)
class Waviness(Feature):
    """One row of `waviness`: of a piece of skin between seams, in one direction."""

    waviness_id: Annotated[str, "name of the piece of skin and of the direction, such as W1-along"]
    _: KW_ONLY
    direction: Annotated[
        Direction, "along: the direction in which the skin is curved least (flat: across the picture); or across that"
    ]
    edge_mm: Annotated[float, "length of the straight-edge, mm"]
    waviness_mm: Annotated[
        float | None, "greatest gap under the straight-edge slid over the skin, the skin's own curvature left out, mm"
    ] = None
    waviness_u95_mm: Annotated[float | None, "expanded uncertainty (95 %) of waviness_mm, mm"] = None


@dataclass(frozen=True)
class WavinessSettings:
    """How waviness is measured, where a panel specification limits it."""

    straight_edge_mm: float = 150.0
    """Length of the straight-edge."""

    def __post_init__(self) -> None:
        if not 30.0 <= self.straight_edge_mm <= 1000.0:
            raise UsageError(f"straight_edge_mm: found {self.straight_edge_mm:g}, expected 30 … 1000")
