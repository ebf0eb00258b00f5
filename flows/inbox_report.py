"""What an inbox run did, for people."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from flows.inbox_job import Outcome, State

_ORDER: tuple[State, ...] = ("failed", "quarantined", "waiting", "copying", "inspected", "signed off", "known")
_WORDS: dict[State, str] = {
    "inspected": "inspected",
    "known": "known already",
    "signed off": "signed off earlier",
    "copying": "still being copied",
    "waiting": "waiting for their rig",
    "quarantined": "put aside",
    "failed": "failed",
}


def summary(outcomes: Sequence[Outcome]) -> str:
    """One line: how many of each."""
    counted = Counter(outcome.state for outcome in outcomes)
    parts = [f"{counted[state]} {_WORDS[state]}" for state in reversed(_ORDER) if counted[state]]
    return ", ".join(parts) or "nothing in the inbox"


def markdown(outcomes: Sequence[Outcome]) -> str:
    """A table of all that is not simply known."""
    lines = [f"**{summary(outcomes)}**", "", "| scene | became | found | s |", "|---|---|---|---:|"]
    for outcome in sorted(outcomes, key=lambda o: (_ORDER.index(o.state), str(o.folder))):
        if outcome.state != "known":
            text = outcome.text.replace("|", "\\|")
            name = outcome.scene_id or outcome.folder.name
            lines.append(f"| {name} | {_WORDS[outcome.state]} | {text} | {outcome.seconds:.1f} |")
    return "\n".join(lines)
