"""Which scan a scene folder holds: a name for its content, and one for its files as they lie on disk.

Two scans that were given the same key by mistake differ in every frame. The digest of the content is another;
it costs next to nothing, as it is made of checksums that reading the frames has at hand. The state of the files shows,
without reading them, that nothing changed since they were read.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from metrology.fringe import FringeCode

_LENGTH = 32


def frames_digest(code: FringeCode, exposures: Sequence[float], left: Sequence[int], right: Sequence[int]) -> str:
    """Names the frames of a scan and what the projector showed on them.

    Parameters
    ----------
    left, right : sequence of int
        Checksums of each camera's frame files, exposure-major, in the order of the code.
    """
    gray = [code.gray.stripes, code.gray.inverse] if code.gray else None
    shown: list[object] = [code.axis, code.steps, list(code.counts), gray]
    others = [list(code.phase_offsets_rad), code.size_px, code.gray and [code.gray.references, code.gray.shift]]
    if others not in ([[], None, None], [[], None, [False, 0.0]]):  # scans that had no such keys keep their names
        shown.append(others)
    return _name([shown, [float(exposure) for exposure in exposures], list(left), list(right)])


def cloud_digest(checksums: Sequence[int]) -> str:
    """Names a cloud's files: picture, points, and σ where it is known."""
    return _name(["cloud", list(checksums)])


def files_state(folder: Path, names: Iterable[str]) -> str:
    """Names files as they lie on disk: by size, inode and time of the last change, which no copying tool sets back."""
    return _name([[name, *_status(folder / name)] for name in names])


def _status(path: Path) -> tuple[int, ...]:
    try:
        status = os.stat(path)
    except (OSError, ValueError):  # reading it says what is wrong with it
        return ()
    return status.st_size, status.st_ino, status.st_ctime_ns


def _name(document: object) -> str:
    return hashlib.sha256(json.dumps(document).encode()).hexdigest()[:_LENGTH]
