"""Whose report it is: the company's name and logo, from `report.toml` in the store.

company = "Muster Aerostructures GmbH"
logo = "logo.png"    # PNG or JPEG beside it
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from metrology.errors import StoreError
from storage.documents import read_toml
from storage.models import StrictModel, validate
from storage.templates import data_uri

FILE = "report.toml"
_KINDS = {b"\x89PNG\r\n\x1a\n": "png", b"\xff\xd8\xff": "jpeg"}
_MOST_BYTES = 2 << 20


class LetterheadModel(StrictModel):
    """report.toml."""

    company: str = ""
    logo: str | None = None


@dataclass(frozen=True)
class Letterhead:
    """What stands above a report."""

    company: str = ""
    logo: str = ""
    """As a data URI; empty where there is none."""
    content: str = ""
    """Names what the report says: equal for equal content; empty where nothing names it."""


def letterhead(root: Path, content: str = "") -> Letterhead:
    """A store's letterhead, for a report of this content."""
    path = root / FILE
    if not path.exists():
        return Letterhead(content=content)
    model = validate(LetterheadModel, read_toml(path, StoreError), path, StoreError)
    return Letterhead(model.company, _logo(path.parent / model.logo) if model.logo else "", content)


def _logo(path: Path) -> str:
    try:
        picture = path.read_bytes()
    except OSError as problem:
        raise StoreError(f'{path}: found "{problem.strerror}", expected the logo that {FILE} names') from None
    kind = next((kind for begins, kind in _KINDS.items() if picture.startswith(begins)), None)
    if kind is None or len(picture) > _MOST_BYTES:
        raise StoreError(f"{path}: found {len(picture)} bytes that are no logo, expected a PNG or JPEG up to 2 MB")
    return data_uri(picture, kind)
