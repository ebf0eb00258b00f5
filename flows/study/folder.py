"""A study's folder: whose it is, and what is in it at the end."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from flows.study.document import Bar
from flows.study.spec import FORMAT
from metrology.errors import UsageError
from storage.documents import read_json

MANIFEST = "study.json"


@dataclass(frozen=True)
class Finished:
    """What a study left."""

    report: Path
    """HTML."""
    bars: tuple[Bar, ...]
    problems: tuple[str, ...]
    """Why scans could not be inspected."""


def claim(out: Path, kind: str, specification: str) -> None:
    """Write down whose folder this is; refuse one that holds another study or something else.

    Parameters
    ----------
    kind : str
        Which study.
    specification : str
        Names everything that determines it, so that a folder never mixes two studies.
    """
    mark = {"format": FORMAT, "study": kind, "specification": specification}
    path = out / MANIFEST
    if path.exists():
        if read_json(path, UsageError) != mark:
            raise UsageError(f"{path}: found another study, expected the same specification or an empty folder")
        return
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UsageError(f"{out}: found something else than a study, expected a new or an empty folder")
    out.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(mark, indent=1), encoding="utf-8")
