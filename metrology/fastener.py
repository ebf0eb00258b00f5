"""Whether a head is of the size that its place in the pattern asks for.

Head sizes of one series of fasteners are a fifth of a diameter and more apart. What is off by more than half of such a
step is nearer to another size; it is the wrong one for certain where its own U95 cannot account for the excess.
"""

from __future__ import annotations

from typing import Literal

from metrology.results import Rivet
from metrology.verdicts import Verdict

SizeVerdict = Literal["right", "doubtful", "wrong"]

HALF_STEP = 0.1
"""Half the least step between standard sizes, as a share of the diameter."""


def size_verdict(rivet: Rivet) -> SizeVerdict | None:
    """How a head's diameter stands to the nominal one; None where either is not known.

    A diameter of unknown uncertainty is trusted to half a step.
    """
    found, nominal, u95 = rivet.diameter_mm, rivet.diameter_nominal_mm, rivet.diameter_u95_mm
    if found is None or nominal is None:
        return None
    excess = abs(found - nominal) - HALF_STEP * nominal
    if excess <= 0:
        return "right"
    return "wrong" if excess > (HALF_STEP * nominal if u95 is None else u95) else "doubtful"


def size_said(rivet: Rivet) -> str | None:
    """What is to be said of a head's size; None where it is right or not known."""
    verdict = size_verdict(rivet)
    if verdict is None or verdict == "right":
        return None
    said = f"wrong fastener: {rivet.diameter_mm:.1f} mm, expected {rivet.diameter_nominal_mm:.1f}"
    if verdict == "wrong":
        return said
    u95 = "" if rivet.diameter_u95_mm is None else f" (diameter ± {rivet.diameter_u95_mm:.1f} mm)"
    return f"perhaps a {said}{u95}"


def size_note(rivet: Rivet) -> str:
    """What the projector says of a head that is of another size for certain."""
    return f"SIZE {rivet.diameter_mm:.1f}" if size_verdict(rivet) == "wrong" else ""


def size_finding(rivet: Rivet) -> Verdict | None:
    """The verdict on a head of another size than the pattern's, whatever its height; None where nothing is wrong."""
    verdict, said = size_verdict(rivet), size_said(rivet)
    if verdict == "wrong":
        return Verdict("red", "fail", said)
    return Verdict("blue", "conditional fail", said) if verdict == "doubtful" else None
