"""What the flows put aside in the inboxes, with the reason they wrote beside it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

QUARANTINE = "quarantine"
_SUFFIX = ".reason.txt"
_MOST, _MOST_CHARACTERS = 500, 500


def put_aside(inboxes: Sequence[str]) -> pd.DataFrame:
    """Quarantined scene folders of inboxes, the newest first: at, scene, inbox, why."""
    rows = []
    for inbox in inboxes:
        for note in Path(inbox).glob(f"{QUARANTINE}/*{_SUFFIX}"):
            try:
                text, at = note.read_text(encoding="utf-8", errors="replace"), note.stat().st_mtime
            except OSError:
                continue
            why = " ".join(text.split())[:_MOST_CHARACTERS]
            rows.append((pd.Timestamp(at, unit="s", tz="UTC"), note.name.removesuffix(_SUFFIX), inbox, why))
    rows.sort(key=lambda row: row[0], reverse=True)
    return pd.DataFrame(rows[:_MOST], columns=["at", "scene", "inbox", "why"])
