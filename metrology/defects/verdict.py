"""What a defect is judged by beside its limits: whether all of it was seen, and whether any limit speaks of it."""

from __future__ import annotations

from metrology.defects.row import Defect
from metrology.verdicts import Verdict


def defect_note(defect: Defect) -> str:
    """What the projector writes beside a defect."""
    return f"{'AT LEAST ' if defect.hidden_by and defect.kind != 'deposit' else ''}{defect.kind.upper()}"


def defect_finding(defect: Defect) -> Verdict | None:
    """What lies on the skin is to be removed; what was not seen whole, or not measured, passes no limit; else None."""
    if defect.kind == "deposit":
        return Verdict("blue", "conditional fail", "something lies on the skin: remove it and scan again")
    if defect.depth_mm is None or defect.hidden_by:
        return Verdict(None, "not measured", defect.reason)
    return None


def unlimited_defect(defect: Defect) -> Verdict | None:
    """A defect that no limit of its zone judges: somebody must decide. Outside of nothing, it has no severity."""
    if defect.depth_mm is None:
        return None
    return Verdict(None, "conditional fail", f"{defect.kind} without a limit that judges it: to be decided")
