"""What proves that a report is as it was written: a last line that names its content and the bytes before it.

Whoever changes a report and not that line is found out by the file alone. Whoever changes both is found out by a store:
the content is named by the SHA-256 of everything that the report was made of, which the store still has.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from datetime import datetime
from typing import Any

import numpy as np

from metrology.errors import StoreError

FORMAT = "flushline-report/1"
_PDF, _HTML = (f"%{FORMAT} ", ""), (f"<!--{FORMAT} ", "-->")
_LATER = ("review_head", "chain", "overlay_shown")
"""What of a record changes with what happens elsewhere in the store, or with the language."""


@dataclass(frozen=True)
class Proof:
    """What a report is about."""

    subject: tuple[str, ...]
    """"scene" and its id; "panel" or "stations", aircraft, panel."""
    content: str
    """SHA-256 of what it was made of."""


def content_of(record: object) -> str:
    """SHA-256 of a record: the same for the same rows, pictures, limits and decisions."""
    text = json.dumps(_plain(record), sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode(errors="surrogatepass")).hexdigest()


def sealed(report: bytes, proof: Proof) -> bytes:
    """A report with its last line."""
    begins, ends = _PDF if report.startswith(b"%PDF") else _HTML
    said = {"subject": proof.subject, "content": proof.content, "file": hashlib.sha256(report).hexdigest()}
    line = json.dumps(said).replace("--", "-\\u002d").replace(">", "\\u003e")  # no end of an HTML comment
    return report + f"\n{begins}{line}{ends}\n".encode()


def proof_of(name: str, report: bytes) -> Proof:
    """What a report's last line says; refused where it lacks, or where the bytes before it are others.

    Parameters
    ----------
    name : str
        The file, for messages.
    """
    begins, ends = _PDF if report.startswith(b"%PDF") else _HTML
    written, mark, line = report.rpartition(f"\n{begins}".encode())
    try:
        said = json.loads(line.decode().removesuffix(f"{ends}\n"))
        proof, file = Proof(tuple(map(str, said["subject"])), str(said["content"])), said["file"]
    except (ValueError, KeyError, TypeError):
        mark = b""
    if not mark:
        raise StoreError(f"{name}: found no proof at its end, expected a report that flushline wrote, whole")
    if hashlib.sha256(written).hexdigest() != file:
        raise StoreError(f"{name}: found it changed since it was written, expected the bytes that its proof names")
    return proof


def _plain(value: Any) -> Any:
    """A value as JSON has it; pictures by their checksum."""
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value) if f.name not in _LATER}
    if isinstance(value, Mapping):
        return {str(name): _plain(each) for name, each in value.items()}
    if isinstance(value, np.ndarray):
        return hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
    if isinstance(value, bytes):
        return hashlib.sha256(value).hexdigest()
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in value]
    if isinstance(value, datetime):
        return value.isoformat()
    return value if isinstance(value, (str, int, float, type(None))) else str(value)
