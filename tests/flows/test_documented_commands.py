"""Every command that the pages show is one that the command line takes, and every view they name exists."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from flows.cli import build_parser, main
from storage.archive import Store
from storage.archive.views import VIEWS
from tests.support.results import small_result

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def commands(page: Path) -> list[str]:
    """Lines of code blocks that begin with flushline; what follows wide space or # explains."""
    blocks = re.findall(r"^```\w*\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    lines = [line for block in blocks for line in block.splitlines() if line.startswith("flushline ")]
    return [re.split(r"\s{3,}|\s#", line)[0] for line in lines]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_documented_commands_are_taken(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for command in commands(page):
        try:
            build_parser().parse_args(shlex.split(command)[1:])
        except SystemExit as left:
            if left.code != 0:  # --help leaves with 0
                pytest.fail(f"{page.name}: {command}: {capsys.readouterr().err}")


QUERIES = [command for page in PAGES for command in commands(page) if command.startswith("flushline query")]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store with one scene."""
    root = tmp_path_factory.mktemp("documented") / "store"
    Store(root).publish(small_result())
    return root


@pytest.mark.parametrize("command", QUERIES)
def test_documented_queries_are_answered(
    command: str, store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # some write a file
    arguments = shlex.split(command)[1:]
    arguments[arguments.index("--store") + 1] = str(store)
    assert main(arguments) == 0


def test_the_archives_page_names_every_view() -> None:
    page = next(page for page in PAGES if page.stem == "archive").read_text(encoding="utf-8")
    assert {view.name for view in VIEWS} <= set(re.findall(r"`(\w+)`", page))


def test_the_reference_is_made_from_the_docstrings(tmp_path: Path) -> None:
    import pdoc

    pdoc.render.configure(docformat="numpy")
    pdoc.pdoc("metrology.flatness", output_directory=tmp_path)
    page = (tmp_path / "metrology" / "flatness.html").read_text(encoding="utf-8")
    assert 'id="flatness"' in page
    assert "<h6 " in page  # "Parameters" is a head, not an underlined word
