"""Pages come from templates that escape what is put into them, and every template is part of the installed packages."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from jinja2 import UndefinedError

from storage.report.markup import badge, facts, figure, table
from storage.report.sections import limits_table
from storage.templates import environment, rendered

ROOT = Path(__file__).parents[2]
ROOMS = ("metrology", "storage", "tasks", "flows", "dashboard", "simulator")
HOSTILE = '<script>"&'


def test_what_is_put_into_a_page_is_escaped_and_what_a_template_wrote_is_not() -> None:
    made = table([HOSTILE], [[HOSTILE], [badge("pass")]]) + facts([(HOSTILE, HOSTILE)]) + figure(HOSTILE, HOSTILE)
    assert "<script>" not in made
    assert made.count("&lt;script&gt;&#34;&amp;") == 6
    assert '<span class="badge pass">' in made
    assert "cannot be read by this version" in limits_table(None)


def test_a_value_that_a_template_misses_is_an_error_and_no_gap() -> None:
    with pytest.raises(UndefinedError, match="'parts' is undefined"):
        rendered("dashboard", "decision_bar.html")


def test_no_module_escapes_by_hand() -> None:
    # The overlay's SVG is written in metrology, which knows no templates: one text, escaped there.
    allowed = {"metrology/overlay/paint.py"}
    found = {
        str(path.relative_to(ROOT))
        for room in ROOMS
        for path in (ROOT / room).rglob("*.py")
        if re.search(r"from html import escape|html\.escape\(", path.read_text(encoding="utf-8"))
    }
    assert found == allowed


def test_templates_are_packaged_and_compile() -> None:
    data = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["package-data"]
    templates = [path for room in ROOMS for path in (ROOT / room).rglob("*.html")]
    assert len(templates) >= 9
    for path in templates:
        package = ".".join(path.parent.parent.relative_to(ROOT).parts)
        assert "templates/*.html" in data[package]
        assert "safe" not in path.read_text(encoding="utf-8")
        environment(package).get_template(path.name)
