"""The option `--language` of commands that write pages for people."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from storage.wording import Wording


def add_language(parser: argparse.ArgumentParser) -> None:
    """Add `--language`."""
    parser.add_argument("--language", default="en", metavar="LANGUAGE", help="en or de (default: en)")


def wording_in(language: str) -> Wording | None:
    """The words of a language, which the pages have, too; None for English."""
    from metrology.errors import UsageError

    if language == "en":
        return None
    from dashboard.locale import Locale
    from dashboard.reports import wording_of
    from dashboard.words import LANGUAGES

    if language not in LANGUAGES:
        raise UsageError(f"--language: found language {language!r}, expected one of {', '.join(LANGUAGES)}")
    return wording_of(Locale("de" if language == "de" else "iso"), language)
