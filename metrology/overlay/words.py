"""The words of an overlay: English, unless whoever draws it brings another language's."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import get_args

from metrology.defects.row import DefectKind
from metrology.verdicts import SEVERITIES

NOTES = (
    "AT LEAST", "SIZE", "TEMPORARY", "MISSING", "FILLED", "HOLE", *(kind.upper() for kind in get_args(DefectKind)),
)  # fmt: skip
"""What stands beside values of features."""
VALUES, ORDER, NEARER = "values in mm", "before and after the bar", "nearer to a limit than its uncertainty"
NOT_MEASURED, BEYOND = "not measured", "beyond the picture"
NO_PROJECTOR, WORK_ALONE = "LEFT CAMERA - NOT FOR PROJECTION", "OPEN WORK ONLY"
OVERLAY_TEXTS = (
    *NOTES, *(look.short for look in SEVERITIES.values()), VALUES, ORDER, NEARER, NOT_MEASURED, BEYOND, NO_PROJECTOR,
    WORK_ALONE,
)  # fmt: skip
"""All that a language has words for, beside kinds and quantities."""
_NOTE = re.compile(rf"\b({'|'.join(NOTES)})\b")


@dataclass(frozen=True)
class Words:
    """The words of a language."""

    text: Callable[[str], str] = str
    """A text in it."""
    decimal: str = "."
    """The decimal mark."""

    def number(self, text: str) -> str:
        """A written number."""
        return text.replace(".", self.decimal)

    def note(self, text: str) -> str:
        """What stands beside a value, word by word."""
        return _NOTE.sub(lambda found: self.text(found[0]), self.number(text))
