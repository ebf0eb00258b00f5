"""Settings of registration."""

from __future__ import annotations

from dataclasses import dataclass

from metrology.errors import UsageError


@dataclass(frozen=True)
class RegistrationSettings:
    """How a scan is recognised."""

    tolerance_mm: float = 3.0
    """A rivet further than this from its nominal place is another one. Rivets drilled by hand differ by up to a
    millimetre or two from aircraft to aircraft; they stand at least three diameters apart."""
    seam_tolerance_mm: float = 4.0
    """The same for the median distance of a seam from its nominal course."""
    shift_mm: float = 15.0
    turn_deg: float = 5.0
    """shift_mm, turn_deg: how far the rig may usually stand from the station's nominal placement; half as far again is
    searched."""
    missing_rate: float = 0.1
    false_rate: float = 0.05
    """missing_rate, false_rate: usual shares of nominal rivets that are not found, and of found rivets that are none.
    """
    least_share: float = 0.6
    """Share of the expected rivets that must be recognised for the scan to count as one of this pattern."""
    gap_mm: float = 10.0
    """A nominal seam that is in view but not found over more than this length gets a row that says so."""

    def __post_init__(self) -> None:
        for name in ("tolerance_mm", "seam_tolerance_mm", "shift_mm", "turn_deg", "gap_mm"):
            if getattr(self, name) <= 0:
                raise UsageError(f"registration {name}: found {getattr(self, name):g}, expected a positive number")
        for name in ("missing_rate", "false_rate", "least_share"):
            if not 0 < getattr(self, name) < 1:
                raise UsageError(f"registration {name}: found {getattr(self, name):g}, expected a share from 0 to 1")
