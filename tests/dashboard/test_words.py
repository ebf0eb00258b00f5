"""Languages: every text has a translation whose places agree, and pages and reasons are worded in it."""

from __future__ import annotations

import ast
import string
from collections.abc import Iterator
from pathlib import Path

import pytest
from streamlit.testing.v1 import AppTest

from dashboard.catalogue import texts, updated
from dashboard.findings import feature_words
from dashboard.locale import Locale
from dashboard.reasons import PATTERNS, worded
from dashboard.words import ENGLISH, LANGUAGES, N_, _, language, po_file, speak
from tests.dashboard.test_pages import Open, clean
from tests.support.week import ROOT
from tests.support.week import texts as said

OTHERS = [name for name in LANGUAGES if name != ENGLISH]


@pytest.fixture(autouse=True)
def _english_before_and_after() -> Iterator[None]:
    speak(ENGLISH)
    yield
    speak(ENGLISH)


def places(text: str) -> list[str]:
    return sorted(name for _text, name, _spec, _conversion in string.Formatter().parse(text) if name)


@pytest.mark.parametrize("name", OTHERS)
def test_every_text_has_a_translation_with_the_same_places(name: str) -> None:
    catalogue = updated(name)
    assert [m.id for m in catalogue if m.id and not m.string] == [], f"python -m dashboard.catalogue {name}"
    assert [m.id for m in catalogue if places(m.id) != places(m.string)] == []
    # What Markdown makes bold or small stays so.
    assert [m.id for m in catalogue if m.id.count("**") != m.string.count("**")] == []
    assert len(po_file(name).read_text().split("\nmsgid ")) - 2 == len(catalogue), "texts that are gone"


def test_all_texts_of_the_code_are_extracted() -> None:
    """Babel does not look into the places of an f-string."""
    known = set(texts())
    for path in (ROOT / "dashboard").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("_", "N_"):
                text = node.args[0]
                assert not isinstance(text, ast.JoinedStr), f"{path}:{node.lineno}"
                if isinstance(text, ast.Constant):
                    assert text.value in known, f"{path}:{node.lineno}"
                    given = sorted(str(keyword.arg) for keyword in node.keywords)
                    assert None in [k.arg for k in node.keywords] or given == sorted(set(places(text.value)))


def test_a_text_without_translation_is_english() -> None:
    speak("de")
    assert _("No such text, {n}", n=3) == "No such text, 3"
    assert N_("Overview") == "Overview"
    assert _("Overview") == "Übersicht"
    speak("tlh")
    assert language() == ENGLISH


@pytest.mark.parametrize(
    ("stored", "english", "german"),
    [
        (
            "height +0.238 ± 0.003 mm outside −0.100 … +0.100 (LH-F12 2); ISO 14253-1, guard band U95",
            "height +0.238 ± 0.003 mm outside −0.100 … +0.100 (LH-F12 2)",
            "Überstand +0,238 ± 0,003 mm außerhalb von −0,100 … +0,100 (LH-F12 2)",
        ),
        (
            "from 136 to 200 mm (68 mm), worst at 180 mm: step +0.2 ± 0.1 mm outside by less than U95 of -0.2 … +0.2",
            "from 136 to 200 mm (68 mm), worst at 180 mm: step +0.2 ± 0.1 mm outside by less than U95 of −0.2 … +0.2",
            "von 136 bis 200 mm (68 mm), am schlimmsten bei 180 mm: "
            "Versatz +0,2 ± 0,1 mm um weniger als U95 außerhalb von −0,2 … +0,2",
        ),
        (
            "width not measured; something else",
            "gap not measured; something else",
            "Spalt nicht gemessen; something else",
        ),
        ("dent without a limit that judges it: to be decided",) * 2
        + ("Delle ohne Grenze, die darüber urteilt: zu entscheiden",),
    ],
)
def test_reasons_are_worded_clause_by_clause(stored: str, english: str, german: str) -> None:
    assert Locale("iso").reason(stored) == english
    speak("de")
    assert Locale("de").reason(stored) == german


@pytest.mark.parametrize("pattern", PATTERNS)
def test_each_pattern_fits_itself(pattern: str) -> None:
    filled = pattern.format_map({name: "height" if name == "quantity" else "1.5" for name in places(pattern)})
    assert worded(filled) == filled


def test_features_are_named_one_way() -> None:
    locale = Locale("de")
    named = [feature_words(name, locale) for name in ("R04", "M1@8.0", "M1@8.5", "M1@136.0-200.0", "M1@-4.0--0.5")]
    assert named == ["R04", "M1 at 8 mm", "M1 at 8,5 mm", "M1 136–200 mm", "M1 −4–−0,5 mm"]


def test_pages_speak_the_language_that_the_address_names(filled: Path, open_page: Open) -> None:
    for name, german in (
        ("overview", "Neue Scans: 2"),
        ("review", "26 Befunde"),
        ("scene", "Niet R04"),
        ("trends", "Kein Punkt verletzt"),
        ("archive", "12 Scans, Seite 1"),
        ("runs", "Ausgewertete Scans pro Tag"),
        ("sql", "Tabellen und Sichten"),
    ):
        page: AppTest = clean(open_page(name, filled, language="de"))
        assert german in said(page), name
        assert "mm outside" not in said(page)
    assert not open_page("overview", filled, language="fr").exception
