"""One table says how verdicts look: no other module has one of its own, and no symbol means two things."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import pytest

from dashboard import palette
from metrology.overlay import marks
from metrology.results import Decision, Severity
from metrology.verdicts import DECISIONS, OPEN, OUTSIDE, SEVERITIES, gravity
from storage.report import verdicts as paper

ROOT = Path(__file__).parents[2]
ROOMS = ("metrology", "storage", "tasks", "flows", "dashboard")
# Words that are also colours or plain English stand for a verdict only in company.
WORDS = [set(get_args(Decision)), {"red", "blue", "green"}]


def modules() -> Iterator[Path]:
    for room in ROOMS:
        yield from (ROOT / room).rglob("*.py")


def lists_of_its_own(text: str) -> list[int]:
    """Lines of tuples, lists, sets and dicts that list three verdicts or more, and of such a ranking in SQL."""
    found = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, (ast.Tuple, ast.List, ast.Set, ast.Dict)):
            members = node.keys if isinstance(node, ast.Dict) else node.elts
            words = {m.value for m in members if isinstance(m, ast.Constant) and isinstance(m.value, str)}
            if any(len(words & known) >= 3 for known in WORDS):
                found.append(node.lineno)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and re.search(r"WHEN 'fail'", node.value):
            found.append(node.lineno)
    return found


def test_the_search_finds_tables() -> None:
    assert lists_of_its_own("A = {'green': 'disc', 'blue': 'square', 'red': 'diamond', None: 'ring'}")
    assert lists_of_its_own("A = ('fail', 'conditional fail', 'pass')")
    assert lists_of_its_own("A = \"CASE decision WHEN 'fail' THEN 0 END\"")
    assert not lists_of_its_own("A = ('pass', 'fail')")


def test_no_other_module_has_a_table_of_its_own() -> None:
    # The types of the words themselves, and the table.
    own = {ROOT / "metrology/results.py", ROOT / "metrology/verdicts.py"}
    # `Limit.decision` in words, for reasons.
    known = {ROOT / "metrology/tolerance.py": 1, ROOT / "dashboard/palette.py": 1}
    for path in modules():
        if path not in own:
            assert len(lists_of_its_own(path.read_text(encoding="utf-8"))) <= known.get(path, 0), path


def test_every_verdict_is_in_the_table_and_looks_unlike_the_others() -> None:
    assert set(DECISIONS) == set(get_args(Decision))
    assert set(SEVERITIES) == {*get_args(Severity), None}
    signs = [look.sign for look in (*SEVERITIES.values(), *DECISIONS.values())]
    assert len(set(signs)) == len(signs)
    for what in ("symbol", "screen", "paper", "projector", "words", "short"):
        assert len({getattr(look, what) for look in SEVERITIES.values()}) == len(SEVERITIES), what


def test_screen_paper_and_projector_follow_the_table() -> None:
    for severity, look in SEVERITIES.items():
        assert palette.SEVERITY_COLOURS[severity] == look.screen
        assert paper.COLOURS[severity] == look.paper
        assert marks.COLOURS[severity] == look.projector
        assert palette.SEVERITY_SYMBOLS[severity] == {
            "disc": "circle", "diamond": "diamond", "cross": "x", "ring": "circle-open"
        }[look.symbol]  # fmt: skip
        assert f"{look.sign} {look.words}" in paper.key()
    for decision, look in DECISIONS.items():
        assert palette.decision_words(decision) == f"{look.sign} {decision}"
        assert paper.SIGNS[decision] == look.sign
    assert list(palette.DECISIONS) == list(DECISIONS) == sorted(DECISIONS, key=gravity)
    assert tuple(SEVERITIES) == marks.GRAVEST_FIRST
    assert OUTSIDE == ("fail", "conditional fail")
    assert OPEN == ("fail", "conditional fail", "not measured", "unconfirmed", "conditional pass")


@pytest.mark.parametrize("severity", [*get_args(Severity), None])
def test_a_report_draws_the_table_s_symbol(severity: Severity | None) -> None:
    from storage.report.drawings import _symbol

    drawn = _symbol(0, 0, severity, "R1")
    assert SEVERITIES[severity].paper in drawn
    corners = {"disc": 0, "ring": 0, "diamond": 4, "cross": 12}[SEVERITIES[severity].symbol]
    points = re.search(r'points="([^"]*)"', drawn)
    assert (len(points.group(1).split()) if points else 0) == corners
    assert ('fill="#fff"' in drawn) == (SEVERITIES[severity].symbol == "ring")
