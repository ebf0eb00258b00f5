"""Languages: every text has a translation whose places agree, and pages and reasons are worded in it."""

from __future__ import annotations

import ast
import html
import re
import string
from collections.abc import Iterator
from pathlib import Path

import pytest
from streamlit.testing.v1 import AppTest

from dashboard.catalogue import texts, updated
from dashboard.causes import CAUSES
from dashboard.findings import feature_words
from dashboard.locale import Locale
from dashboard.meanings import meaning
from dashboard.reasons import PATTERNS, worded
from dashboard.refusals import GENERAL, HALVES, REFUSALS
from dashboard.reports import wording_of
from dashboard.sentences import CLAUSES, SENTENCES
from dashboard.words import ENGLISH, LANGUAGES, N_, _, language, po_file, speak, translations
from flows.cli import main
from metrology.results import PanelKey
from storage.archive import Store
from storage.archive.schema import TABLES
from storage.archive.views import VIEWS
from storage.report import panel_report, scene_report, verify
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
            "von 136 bis 200 mm (68 mm), größte Abweichung bei 180 mm: "
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


@pytest.mark.parametrize(
    ("stored", "german"),
    [
        (
            "first scan of station S3: the rivets (12) and seams (1) found in it were enrolled as the panel's pattern; "
            "check that none is missing · judged by the example limits, which are nobody's requirement; give "
            "--panel-spec",
            "erster Scan der Station S3: die darin gefundenen Niete (12) und Fugen (1) wurden als Muster des Paneels "
            "übernommen; prüfen, dass keine fehlen · beurteilt nach den Beispielgrenzen, die niemandes Anforderung "
            "sind; --panel-spec angeben",
        ),
        (
            "rig rig-7: texture lies off the epipolar lines by 0.213 px RMS, expected at most 0.100 px: calibrate the "
            "rig again",
            "Messkopf rig-7: die Textur liegt 0.213 px RMS neben den Epipolarlinien (wo die eine Kamera sie bei der "
            "anderen erwartet), erwartet höchstens 0.100 px: den Messkopf neu kalibrieren",
        ),
        (
            "from 0 to 4 mm (6 mm): worst step +0.209 ± 0.004 mm at 2 mm, expected -0.200 … +0.200 (LH-F12 2)",
            "von 0 bis 4 mm (6 mm): größte Abweichung Versatz +0,209 ± 0,004 mm bei 2 mm, "
            "erwartet −0,200 … +0,200 (LH-F12 2)",
        ),
        (
            "A1: at most 5% of the rivets of a panel with height beyond its limit: found 8% of F12, up to 10% with "
            "what lies within the guard band; not seen: R01, R02",
            "A1: höchstens 5% der Niete je Paneel: Überstand jenseits der Grenze: gefunden 8% bei F12, bis zu 10% mit "
            "allem, was näher als U95 an der Grenze liegt; nicht gesehen: R01, R02",
        ),
        (
            "step into the wind +0.210 ± 0.005 mm outside -0.100 … +0.100 (LH-F12 2)",
            "Versatz gegen den Wind +0,210 ± 0,005 mm außerhalb von −0,100 … +0,100 (LH-F12 2)",
        ),
        (
            "defect depth for a width of 12.5 mm 0.312 ± 0.010 mm outside −∞ … +0.200",
            "Schadenstiefe bei 12,5 mm Breite 0,312 ± 0,010 mm außerhalb von −∞ … +0,200",
        ),
        (
            "lap joint: no gap (what is dark is its edge's wall and shadow, or a gap under 0.42 mm)",
            "Überlappstoß: kein Spalt (dunkel sind Wand und Schatten der Kante, oder ein Spalt unter 0,42 mm)",
        ),
        (
            "known: accepted as it is on 2026-11-20 by K. Ito; depth since then +0.012 ± 0.020 mm, no more than its "
            "uncertainty",
            "bekannt: am 2026-11-20 von K. Ito wie vorliegend angenommen; Tiefe seitdem +0,012 ± 0,020 mm, nicht mehr "
            "als ihre Unsicherheit",
        ),
        (
            "rig rig-7: cannot tell whether the rig still fits: too few points; texture lies off the epipolar lines by "
            "0.213 px with noise of 0.5 px, expected at most 0.2 px",
            "Messkopf rig-7: ob die Kalibrierung noch passt, ist nicht zu sagen: zu wenige Punkte; die Textur liegt "
            "0.213 px neben den Epipolarlinien (wo die eine Kamera sie bei der anderen erwartet), mit einem Rauschen "
            "von 0.5 px, erwartet höchstens 0.2 px",
        ),
        (
            "not measured: S01@144.0-166.0, R07 and 4 more",
            "nicht gemessen: S01 144–166 mm, R07 und 4 weitere",
        ),
        (
            "panel MSN-1 LH-F12 released with 2 scans; verdict accepted with conditions: within U95 of a limit: R04",
            "Paneel MSN-1 LH-F12 freigegeben, Scans: 2; Urteil: bedingt angenommen (näher als U95 an einer Grenze: "
            "R04)",
        ),
        (
            "panel MSN-1 LH-F12 released with 1 scan; verdict not put together",
            "Paneel MSN-1 LH-F12 freigegeben, Scans: 1; Urteil: nicht zusammengesetzt",
        ),
        ("edges of M1@8.5 and R04", "edges of M1 bei 8,5 mm and R04"),
        ("3 % of the pixels are saturated", "3 % of the pixels are saturated"),
        (
            "left/f02.png: found the same picture as f03.png, expected step 3 of count 70 at exposure 2; left/f05.png: "
            "found that it does not fit the other steps of count 64 below row 310 (a dark frame), expected step 2 of "
            "count 64",
            "left/f02.png: gefunden: dasselbe Bild wie f03.png; erwartet: Schritt 3 der Streifenzahl 70 bei "
            "Belichtung 2; left/f05.png: gefunden: dass es unterhalb von Zeile 310 nicht zu den anderen Schritten der "
            "Streifenzahl 64 passt (ein dunkles Bild); erwartet: Schritt 2 der Streifenzahl 64",
        ),
        (
            "in/s1: found that the frames fit rig 'rig-7' when left and right are exchanged and all frames are "
            "mirrored left to right, expected scene.json to list them as the rig's cameras are and frames as the "
            "cameras gave them when the rig was calibrated",
            "in/s1: die Bilder passen zum Messkopf 'rig-7', wenn links und rechts vertauscht sind und alle Bilder "
            "seitenverkehrt sind; erwartet: scene.json nennt sie, wie die Kameras des Messkopfs stehen und Bilder, wie "
            "sie die Kameras bei der Kalibrierung gaben",
        ),
        (
            "s1 R04: found it decided since it was shown (use as is by K. Ito at 2026-11-20T08:15:00Z), expected it as "
            "it was shown",
            "s1 R04: darüber wurde entschieden, seit es gezeigt wurde (wie vorliegend durch K. Ito am "
            "2026-11-20T08:15:00Z)",
        ),
    ],
)
def test_warnings_and_verdicts_are_worded(stored: str, german: str) -> None:
    assert worded(stored) == stored
    speak("de")
    assert Locale("de").reason(stored) == german


def test_meanings_of_tables_have_a_translation() -> None:
    comments = [column.comment for table in TABLES for column in table.columns] + [view.comment for view in VIEWS]
    assert [text for text in comments if meaning(text) != text] == []
    speak("de")
    assert meaning("expanded uncertainty (95 %) of step_mm, mm") == "erweiterte Unsicherheit (95 %) von step_mm, mm"
    same = {"mm", "value minus before_value"}
    assert {text for text in comments if meaning(text) == text} <= same


def test_sentences_are_those_that_the_code_says() -> None:
    """What was reworded in the code would stay English on the pages: each fixed part stands in some source."""
    sources = "".join(
        re.sub(r'"\s*(?:\+ \()?f?"', "", path.read_text())
        for room in ("metrology", "tasks", "storage")
        for path in (ROOT / room).rglob("*.py")
    )
    composed = (
        r"\{\w+\}| of the right camera|(?<=camera's picture), |(?<=every exposure); |perhaps a |no more than |"
        r"(?<=mm), more than |(?<=no gap) \(|(?<=its rim) below|(?<=several ways), |mm below the skin: |"
        "edge A and B |: give"
    )
    parts = {part.strip(" ,:;()") for said in (*SENTENCES, *CLAUSES, *CAUSES) for part in re.split(composed, said)}
    whole = [part for part in parts if len(part.split()) > 3]
    assert len(whole) > 40
    assert [part for part in whole if part not in sources] == []
    own = (ROOT / "dashboard" / name for name in ("sql_runner.py", "sql_worker.py", "data.py", "views/sql.py"))
    sources += "".join(re.sub(r'"\s*f?"', "", path.read_text()) for path in own)
    composed = (
        r"\{\w+\}|(?<=expected), |; look at it|, expected |: found |(?<=query:) |since it was shown|found it |"
        r"that other |it shown | \(it does|(?<=zone), |all frames are |turned by|mirrored"
    )
    parts = {part.strip(" ,:;()") for said in (*REFUSALS, *HALVES) for part in re.split(composed, said)}
    assert [part for part in parts if len(part.split()) > 3 and part not in sources] == []


@pytest.mark.parametrize("pattern", [*PATTERNS, *SENTENCES, *REFUSALS, *HALVES, *GENERAL])
def test_each_pattern_fits_itself(pattern: str) -> None:
    own = {"quantity": "height", "said": "at most 2 rivets per m² with height beyond its limit"}
    filled = pattern.format_map({name: own.get(name, "1.5") for name in places(pattern)})
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


def shown_texts(page: str) -> set[str]:
    """What stands between the tags of a page."""
    said = re.sub(r"<(style|pre)\b.*?</\1>", "", page, flags=re.DOTALL)
    return {html.unescape(text).strip() for text in re.split(r"<[^>]*>", said)}


def test_reports_are_written_in_the_language(filled: Path) -> None:
    store, key = Store(filled), PanelKey("MSN-0425", "LH-F12")
    words, known = wording_of(Locale("de"), "de"), translations("de")
    scene = "MSN-0425~LH-F12~S2~20261119T212500Z"
    for english, german in (
        (scene_report(store, scene), scene_report(store, scene, words)),
        (panel_report(store, key), panel_report(store, key, wording=words)),
        (panel_report(store, key, stations=True), panel_report(store, key, True, words)),
    ):
        assert english.proof == german.proof  # what a report says is the same in all languages
        assert {"Traceability", "height", "✗ fail"} & shown_texts(english.html)
        left = {text for text in shown_texts(german.html) if known.get(text, text) != text}
        assert left == set()
        assert '<html lang="de">' in german.html
        assert "Überstand +0,238 ± 0,003 mm außerhalb von −0,100 … +0,100" in german.html
        assert "Überstand +0" not in english.html


def test_a_report_in_german_from_the_command_line(
    filled: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "report.html"
    asked = ["report", "MSN-0425~LH-F12~S2~20261119T212500Z", "--store", str(filled), "--out", str(path)]
    assert main([*asked, "--language", "de"]) == 0
    assert "Rückführbarkeit" in path.read_text()
    assert "the store says the same" in verify(path, Store(filled))
    assert main([*asked, "--language", "tlh"]) == 2
    panel = ["overlay", "--aircraft", "MSN-0425", "--panel", "LH-F12", "--store", str(filled), "--out"]
    assert main([*panel, str(path.parent / "overlays"), "--language", "de"]) == 0
    assert "Projektionsbilder von MSN-0425 LH-F12" in (path.parent / "overlays" / "index.html").read_text()
    drawn = (path.parent / "overlays" / "S2.svg").read_text()
    assert {"STARK AUSSERHALB", "+0,24"} <= shown_texts(drawn)  # the picture's own words and numbers, too
    assert not {"SERIOUS", "+0.24"} & shown_texts(drawn)
    stored = Store(filled).paths(asked[1]).overlay
    one = ["overlay", asked[1], "--store", str(filled), "--out", str(path.with_suffix(".png"))]
    assert main(one) == 0
    assert path.with_suffix(".png").read_bytes() == stored.read_bytes()  # in English it is the one that was stored
    assert main([*one, "--language", "de"]) == 0
    assert path.with_suffix(".png").read_bytes() != stored.read_bytes()
    assert "found language 'tlh', expected one of en, de" in capsys.readouterr().err
