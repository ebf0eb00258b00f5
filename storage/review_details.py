"""What an entry of the review log may say beside: numbers of the paperwork, a mark of a person, a signature.

Such entries have the format flushline-review/5; versions before it cannot read them. All of it stands in the entry's
document alone, so that the table of decisions stays as earlier versions made it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, model_validator

from storage.models import StrictModel

LONGEST_NUMBER = 80
_Text = Annotated[str, Field(max_length=LONGEST_NUMBER)]
MarkKind = Literal["false", "missed"]
Confirmation = Literal["log-in, name typed", "given name"]
CONFIRMATIONS: tuple[Confirmation, ...] = get_args(Confirmation)


class Numbers(StrictModel):
    """Numbers of the paperwork that belongs to a disposition, as people write them; "" where there is none."""

    concession: _Text = ""
    """Of the concession or NCR."""
    part_number: _Text = ""
    work_order: _Text = ""

    @property
    def given(self) -> dict[str, str]:
        """Those that are there, by what they are: words for `storage.wording`."""
        named = {"concession": self.concession, "part": self.part_number, "work order": self.work_order}
        return {name: number for name, number in named.items() if number}

    @property
    def columns(self) -> tuple[str | None, str | None, str | None]:
        """As a table has them, in their order here."""
        return self.concession or None, self.part_number or None, self.work_order or None


NO_NUMBERS = Numbers()


class Mark(StrictModel):
    """What a person says of a place: that no fastener is there, or that one was missed."""

    kind: MarkKind
    u_px: float | None = None
    v_px: float | None = None
    """u_px, v_px: where in the scan's picture, pixel of its first row and column at 0; None where a note says it."""

    @model_validator(mode="after")
    def _both_or_none(self) -> Mark:
        if (self.u_px is None) != (self.v_px is None):
            raise ValueError("both u_px and v_px, or neither")
        return self


class Signature(StrictModel):
    """What a signature is beside the name."""

    role: str
    """In which the person signs, by the log-in or the settings."""
    meaning: str
    """What the signature says."""
    confirmed: Confirmation
    """How sure it is who signed: they logged in and typed their name once more, or nobody logs in."""


SCAN_RELEASED = "every finding of the scan is decided, and no work is open"
PANEL_RELEASED = "panel {panel} released with {n} scans; verdict {verdict}"
PANEL_RELEASED_ONE = "panel {panel} released with 1 scan; verdict {verdict}"
"""What signatures say, kept in English."""
ADDED = ("numbers", "mark", "takes_back", "signature")
"""Parts of a document that earlier formats do not have."""


AT_PIXEL = "at column {u}, row {v} of the picture"
"""How the place of a mark is said; `u` and `v` are whole pixels."""


def remarks(entry: Any, word: Callable[[str], str], reason: Callable[[str], str]) -> str:
    """What an entry says beside what was decided: numbers, place, role and meaning, comment.

    Parameters
    ----------
    entry : storage.review.Entry
    word : callable
        A text of the code in the language that is written in.
    reason : callable
        A stored sentence in it: what a signature says was kept in English.
    """
    said = [f"{word(name)} {number}" for name, number in entry.numbers.given.items()]
    if entry.mark and entry.mark.u_px is not None:
        said.append(word(AT_PIXEL).format(u=round(entry.mark.u_px), v=round(entry.mark.v_px)))
    if entry.signature:
        said.append(f"{word(entry.signature.role)}: {reason(entry.signature.meaning)}")
    return "; ".join([*said, *([entry.comment] if entry.comment else [])])


def wrong_details(entry: Any) -> str | None:
    """What an entry's added parts should be, where they do not belong to its action."""
    action, mark = entry.action, entry.mark
    for name, of in (("numbers", "disposition"), ("mark", "mark"), ("takes_back", "unmark"), ("signature", "sign-off")):
        there = getattr(entry, name) is not None
        if there and action != of:
            return f"{name} with a {of} alone"
        if not there and action == of and action in ("mark", "unmark"):
            return f"a {action} with {name}"
    if mark is not None and (mark.kind == "false") != (entry.feature_id is not None):
        return "a feature that is no fastener, or a missed one that is no feature"
    if mark is not None and mark.kind == "missed" and mark.u_px is None and not entry.comment:
        return "the place of a missed fastener, or a note that says it"
    return None
