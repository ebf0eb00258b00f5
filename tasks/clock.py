"""Whether a scan's time can be true."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from metrology.moments import moment_of
from metrology.results import SceneKey
from metrology.rig import Rig
from storage.archive.views import CLOCK_SLACK
from storage.documents import utc_text


def clock_warnings(key: SceneKey, rig: Rig, first_stored_at: datetime | None) -> list[str]:
    """What is odd about the time of a scan.

    Parameters
    ----------
    first_stored_at : datetime or None
        When a result of the scan was stored for the first time; None where it never was.
    """
    warnings = []
    here = first_stored_at or datetime.now(UTC)
    if key.captured_at > here + CLOCK_SLACK:
        warnings.append(
            f"captured_at {utc_text(key.captured_at)} is {_span(key.captured_at - here)} ahead of this computer's "
            "clock; it counts as the station's newest scan only where there is no other; check the camera's clock"
        )
    try:
        calibrated = moment_of(rig.calibrated_at)
    except ValueError:  # a rig that was made here and has no time
        return warnings
    if key.captured_at < calibrated:
        warnings.append(
            f"captured_at {utc_text(key.captured_at)} is {_span(calibrated - key.captured_at)} before rig {rig.id!r} "
            f"was calibrated ({utc_text(calibrated)}); check the camera's clock and the rig that the scene names"
        )
    return warnings


def _span(span: timedelta) -> str:
    for unit, seconds in (("day", 86400), ("hour", 3600), ("minute", 60)):
        if (count := int(span.total_seconds() // seconds)) >= 1:
            return f"{count} {unit}{'' if count == 1 else 's'}"
    return "less than a minute"
