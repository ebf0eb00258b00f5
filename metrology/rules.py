"""Acceptance rules as a panel specification declares them; `metrology.acceptance` says what becomes of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from metrology.errors import SpecError
from metrology.kinds import BY_NAME

Measure = Literal["share", "number", "adjacent", "run", "length", "mean", "density"]
Beyond = Literal["limit", "serious", "any"]
Group = Literal["panel", "zone", "row", "course"]

OF_COURSES: tuple[Measure, ...] = ("run", "length", "mean")


@dataclass(frozen=True)
class Rule:
    """What a panel must meet beside the limits of its features."""

    rule_id: str
    measure: Measure
    """share: of the features of a group that lie beyond a limit; number: of such features; adjacent: of such features
    side by side; run: longest stretch of a course beyond a limit, mm; length: all stretches of a course together,
    mm; mean: of every stretch of `over_mm`, against the limits; density: such features per m² of measured skin."""
    kind: str
    """Of the features."""
    most: float = 0.0
    """What is allowed; not for mean."""
    quantity: str = ""
    """Which of the kind's; any of them where nothing is given."""
    beyond: Beyond = "limit"
    """any: every feature of the kind counts, whatever its values."""
    zone: str | None = None
    """Only features of this zone."""
    per: Group = "panel"
    """What the features are grouped by."""
    over_mm: float | None = None
    """Length that a mean is taken over."""
    source: str = ""
    revision: str = ""

    def __post_init__(self) -> None:
        place = f"acceptance {self.rule_id}"
        if self.kind not in BY_NAME:
            raise SpecError(f"{place}: found kind {self.kind!r}, expected one of {', '.join(BY_NAME)}")
        kind = BY_NAME[self.kind]
        if self.quantity and self.quantity not in {quantity.name for quantity in kind.quantities}:
            known = ", ".join(quantity.name for quantity in kind.quantities)
            raise SpecError(f"{place}: found quantity {self.quantity!r}, expected one of {known}")
        if self.measure in OF_COURSES and not kind.is_course:
            raise SpecError(f"{place}: found {self.measure} of {kind.many}, expected a kind that runs along a course")
        if self.most < 0 or (self.measure == "share" and self.most > 1):
            raise SpecError(
                f"{place}: found most = {self.most:g}, expected {'0 … 1' if self.measure == 'share' else '0 or more'}"
            )
        if (self.measure == "mean") != (self.over_mm is not None):
            raise SpecError(f"{place}: found over_mm {self.over_mm}, expected a length for mean and for nothing else")
        if self.over_mm is not None and self.over_mm <= 0:
            raise SpecError(f"{place}: found over_mm {self.over_mm:g}, expected a positive length")

    @property
    def said(self) -> str:
        """The rule in words."""
        kind = BY_NAME[self.kind]
        limit = {"limit": "beyond its limit", "serious": "beyond its serious limit", "any": "of any value"}[self.beyond]
        what = f"{self.quantity or 'any quantity'} {limit}"
        allowed = {
            "share": f"at most {self.most:.0%} of the {kind.many} of a {self.per} with {what}",
            "number": f"at most {self.most:g} {kind.many} of a {self.per} with {what}",
            "adjacent": f"at most {self.most:g} adjacent {kind.many} with {what}",
            "run": f"no stretch of a {kind.subject} longer than {self.most:g} mm with {what}",
            "length": f"at most {self.most:g} mm of a {kind.subject} with {what}",
            "mean": f"mean {self.quantity} over {self.over_mm or 0:g} mm within its limits",
            "density": f"at most {self.most:g} {kind.many} per m² with {what}",
        }[self.measure]
        zone = f" in zone {self.zone}" if self.zone else ""
        origin = " ".join(part for part in (self.source, self.revision) if part)
        return f"{allowed}{zone}" + (f" ({origin})" if origin else "")
