"""A store as a week of inspections leaves it, and a way to run a page on it."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import streamlit as st
from streamlit.components.v2 import manifest_scanner
from streamlit.testing.v1 import AppTest

from tests.support.browser import browser, served
from tests.support.once import made_once
from tests.support.week import fill


@pytest.fixture(scope="session")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The week's store; do not write to it."""
    return made_once(tmp_path_factory, "week", fill)


@pytest.fixture(scope="session")
def server(filled: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    """A dashboard on a copy of the week's store that tests share; gives its address and the store.

    Who decides about findings takes an aircraft of their own: see `week.AIRCRAFT`.
    """
    root = Path(shutil.copytree(filled, tmp_path_factory.mktemp("browser") / "store", symlinks=True))
    with served(root) as address:
        yield address, root


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """A browser; not longer than a module, as its event loop stands in the way of others."""
    with browser() as started:
        yield started


@pytest.fixture
def writable(filled: Path, tmp_path: Path) -> Path:
    """A copy to review in."""
    return Path(shutil.copytree(filled, tmp_path / "store", symlinks=True))


@pytest.fixture(scope="session", autouse=True)
def _components_are_looked_for_once() -> Iterator[None]:
    """AppTest reads the metadata of all packages whenever it runs a page: longer than the page itself takes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(manifest_scanner, "scan_component_manifests", cache(manifest_scanner.scan_component_manifests))
        yield


@pytest.fixture(autouse=True)
def _fresh_caches(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    # AppTest leaves its page as __main__, which processes started by later tests would run.
    monkeypatch.setitem(sys.modules, "__main__", sys.modules["__main__"])
    for variable in ("FLUSHLINE_STORE", "FLUSHLINE_DASHBOARD_SETTINGS"):
        monkeypatch.delenv(variable, raising=False)
    yield
    st.cache_data.clear()
    st.cache_resource.clear()


def _page_script(name: str) -> None:
    from dashboard.app import PAGES

    PAGES[name][2]()


@pytest.fixture
def open_page(monkeypatch: pytest.MonkeyPatch) -> Callable[..., AppTest]:
    """Run a page on a store with query parameters."""

    def open_(name: str, root: Path, /, **parameters: Any) -> AppTest:
        monkeypatch.setenv("FLUSHLINE_STORE", str(root))
        page = AppTest.from_function(_page_script, kwargs={"name": name}, default_timeout=30)
        for key, value in parameters.items():
            page.query_params[key] = value
        return page.run()

    return open_
