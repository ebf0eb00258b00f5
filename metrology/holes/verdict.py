"""What a hole is judged by beside its limits: whether a fastener belongs into it."""

from __future__ import annotations

from metrology.results import MISSING, Hole
from metrology.verdicts import Verdict


def hole_note(hole: Hole) -> str:
    """What the projector writes beside a hole."""
    if hole.kind == "temporary fastener":
        return "TEMPORARY"
    if hole.kind == "missing fastener":
        return f"{MISSING.upper()} {hole.fastener_id}"
    return "FILLED" if hole.kind == "filled hole" else "HOLE"


def hole_finding(hole: Hole) -> Verdict | None:
    """A missing fastener fails, a filled hole is to be decided; what is of unknown size is not measured; else None."""
    if hole.kind == "missing fastener":
        return Verdict("red", "fail", hole.reason)
    if hole.kind == "filled hole":
        size = "" if hole.diameter_mm is None else f" of {hole.diameter_mm:.1f} mm"
        return Verdict("blue", "conditional fail", f"filled hole{size}: what belongs there is to be decided")
    return Verdict(None, "not measured", hole.reason) if hole.diameter_mm is None else None


def unexpected_hole(hole: Hole) -> Verdict | None:
    """An open hole that no zone's `hole_diameter_mm` asks for: somebody must say what belongs there."""
    if hole.kind != "open hole" or hole.diameter_mm is None:
        return None
    return Verdict(None, "conditional fail", f"open hole of {hole.diameter_mm:.1f} mm where no limit asks for one")
