"""The texts of the pages and reports, for translators.

    python -m dashboard.catalogue de

writes what the code says into `locales/de/LC_MESSAGES/dashboard.po`: translations that are there stay, new texts are
empty, and texts that are gone are left out. Any editor for gettext's catalogues opens the file; nothing is compiled.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import get_args

from babel.messages.catalog import Catalog
from babel.messages.extract import extract_from_dir
from babel.messages.pofile import read_po, write_po

from dashboard import meanings
from dashboard.reasons import AND, PARTLY, PATTERNS
from dashboard.refusals import GENERAL, HALVES, REFUSALS
from dashboard.sentences import SENTENCES, WORDS
from dashboard.words import ENGLISH, LANGUAGES, po_file
from metrology.acceptance import PanelVerdict
from metrology.assembly.rows import CHANGES as PANEL_CHANGES
from metrology.kinds import KINDS, LIMITS
from metrology.overlay.words import OVERLAY_TEXTS
from metrology.statistics import NELSON_RULES, WESTERN_ELECTRIC_RULES
from metrology.steps import TIMED
from metrology.tolerance import RULE
from metrology.verdicts import DECISIONS, SEVERITIES
from storage.archive import panel_rework
from storage.archive.changes import CHANGES
from storage.archive.work import DECIDED, OPEN_WORK, WAITING
from storage.review import DISPOSITIONS
from storage.review_details import AT_PIXEL
from storage.wording import AT, STRETCH

_CODE = Path(__file__).parent
_REPORTS, _EVIDENCE = _CODE.parent / "storage" / "report", _CODE.parent / "storage" / "evidence"
_TEMPLATES = "jinja2.ext:babel_extract"
_OTHERS = (
    "bump",
    "crease",
    "dent",
    "deposit",
    "raised edge",
    "scratch",
    "signed off",
    "work closed",
    "decision undone",
    "no fastener here",
    "fastener missed",
    "mark taken back",
    "concession",
    "part",
    "work order",
    "ok",
    "warnings",
    "warning",
    "unjudged",
    "viewer",
    "reviewer",
    "design authority",
    "not seen",
    "scan",
    "recognised",
    "not recognised",
    "enrolled",
    "not enrolled",
    "missing",
    "unlisted",
)
"""Kinds of defects, and words of the review log, of the table `scenes`, of coverage of roles, of registration."""


def declared() -> Iterator[str]:
    """Words that are declared outside of the pages and shown on them."""
    yield from (*DECISIONS, *(look.words for look in SEVERITIES.values()), *DISPOSITIONS)
    yield from (*get_args(PanelVerdict), *PANEL_CHANGES, *panel_rework.STATES)
    yield from (
        *CHANGES,
        *OVERLAY_TEXTS,
        WAITING,
        OPEN_WORK,
        DECIDED,
        *_OTHERS,
        *PATTERNS,
        *PARTLY,
        *SENTENCES,
        *REFUSALS,
        *GENERAL,
        *HALVES,
        AND,
        *WORDS,
        RULE,
        AT_PIXEL,
        AT,
        STRETCH,
    )
    yield from (step.replace("_", " ") for step in TIMED)
    yield from (rule.meaning for rule in (*NELSON_RULES, *WESTERN_ELECTRIC_RULES))
    yield from (limit.title for limit in LIMITS.values())
    yield from meanings.texts()
    for kind in KINDS:
        yield from (
            kind.subject,
            f"{kind.subject}s",
            kind.many,
            *(cell.head for cell in kind.shown),
            *(count.column.removeprefix("n_") for count in kind.counts),
        )
        for quantity in kind.quantities:
            yield from (quantity.name, quantity.said, quantity.title)


def texts() -> dict[str, list[tuple[str, int]]]:
    """Every text that a page can say, with where the code says it."""
    found: dict[str, list[tuple[str, int]]] = {}
    for folder in (_CODE, _REPORTS, _EVIDENCE):
        extracted: Iterable[tuple[str, int, object, object, object]] = extract_from_dir(
            folder, [("**.py", "python"), ("templates/**.html", _TEMPLATES)], keywords={"_": None, "N_": None},
            options_map={"templates/**.html": {"trimmed": "true"}},
        )  # fmt: skip
        for name, line, text, *_rest in extracted:
            found.setdefault(str(text), []).append((f"{folder.relative_to(_CODE.parent)}/{name}", line))
    for word in declared():
        found.setdefault(word, [])
    return found


def updated(language: str) -> Catalog:
    """The catalogue of a language as it is, with the texts of now."""
    known, path = Catalog(), po_file(language)
    if path.exists():
        with path.open("rb") as file:
            known = read_po(file, locale=language)
    catalogue = Catalog(
        language, project="Flushline", version="0", charset="utf-8", fuzzy=False, creation_date=known.creation_date,
        header_comment=f"# Flushline's pages in {LANGUAGES[language]}.", msgid_bugs_address="none",
        last_translator="Flushline", language_team=language,
    )  # fmt: skip
    for text in texts():
        message = known.get(text)
        catalogue.add(text, message.string if message else "", flags=["python-brace-format"] if "{" in text else ())
    return catalogue


def main() -> None:
    """Bring a language's catalogue up to date."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("language", choices=[name for name in LANGUAGES if name != ENGLISH])
    path = po_file(language := parser.parse_args().language)
    path.parent.mkdir(parents=True, exist_ok=True)
    catalogue = updated(language)
    with path.open("wb") as file:
        write_po(file, catalogue, width=0, sort_output=True, omit_header=False)
    print(f"{path}: {len(catalogue)} texts, without translation {sum(not message.string for message in catalogue)}")


if __name__ == "__main__":
    main()
