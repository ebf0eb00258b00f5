"""Logging in through an OpenID Connect provider, in a real browser: who may look, who may review, who may neither."""

from __future__ import annotations

import shutil
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.browser import browser, free_port, new_page, served, settle
from tests.support.oidc_provider import CLIENT, Provider, provider

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def hall(filled: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Provider, Any]]:
    """A dashboard with log-in, its provider, and a browser."""
    with browser() as chromium, provider() as state:
        root = Path(shutil.copytree(filled, tmp_path_factory.mktemp("login") / "store", symlinks=True))
        (root / "dashboard.toml").write_text(
            '[roles]\nreviewers = ["m.weber@example.com"]\nviewers = ["j.doe@example.com"]\n'
            'claim = "groups"\nreviewer_values = ["quality"]\nviewer_values = ["hall-7"]\n'
        )
        port = free_port()
        secrets = root.parent / ".streamlit" / "secrets.toml"
        secrets.parent.mkdir()
        secrets.write_text(
            f"""[auth]
redirect_uri = "http://localhost:{port}/oauth2callback"
cookie_secret = "a random text of more than thirty-two bytes"
client_id = "{CLIENT}"
client_secret = "secret"
server_metadata_url = "{state.address}/.well-known/openid-configuration"
"""
        )
        with served(root, port) as address:
            yield address, state, chromium


def logged_in(hall: tuple[str, Provider, Any], said: str, **claims: Any) -> Any:
    """The review page as it shows after logging in and being told `said`."""
    address, state, chromium = hall
    state.person = {"sub": "person-1", **claims}
    page = new_page(chromium, apart=True)
    page.goto(address)
    settle(page)
    assert page.locator("text=Aircraft").count() == 0
    page.get_by_role("button", name="Log in").click()
    page.wait_for_selector(f"text={said}")
    settle(page)
    page.goto(f"{address}/review")
    settle(page)
    return page


def test_a_reviewer_may_dispose(hall: tuple[str, Provider, Any]) -> None:
    page = logged_in(hall, "M.Weber@example.com · reviewer", email="M.Weber@example.com", email_verified=True)
    assert page.get_by_role("button", name="Record").is_visible()


def test_a_viewer_only_looks(hall: tuple[str, Provider, Any]) -> None:
    page = logged_in(hall, "j.doe@example.com · viewer", email="j.doe@example.com", email_verified=True)
    assert page.get_by_role("button", name="Record").count() == 0


@pytest.mark.parametrize(
    "claims",
    [
        {"email": "someone@example.com", "email_verified": True},
        {"email": "m.weber@example.com", "email_verified": "false", "groups": ["canteen", 7]},
    ],
)
def test_others_see_nothing(hall: tuple[str, Provider, Any], claims: dict[str, Any]) -> None:
    page = logged_in(hall, "this dashboard's settings give you no role", **claims)
    assert page.locator("text=findings").count() == 0


def test_roles_come_from_a_claim_too(hall: tuple[str, Provider, Any]) -> None:
    logged_in(hall, "person-1 · reviewer", groups=["hall-7", "quality"])


def test_a_cookie_ends_at_log_out(hall: tuple[str, Provider, Any]) -> None:
    address, _, chromium = hall
    page = logged_in(hall, "m.weber@example.com · reviewer", email="m.weber@example.com", email_verified=True)
    kept = page.context.cookies()
    page.get_by_role("button", name="Settings").click()
    page.get_by_role("button", name="Log out").click()
    page.wait_for_selector("text=Please log in")
    # Whoever kept a copy of the cookie comes back with it.
    other = new_page(chromium, apart=True)
    other.context.add_cookies(kept)
    other.goto(address)
    settle(other)
    assert other.locator("text=Please log in").is_visible()
    # The person logs in anew.
    logged_in(hall, "m.weber@example.com · reviewer", email="m.weber@example.com", email_verified=True)


def test_pages_cannot_be_framed(hall: tuple[str, Provider, Any]) -> None:
    with urllib.request.urlopen(hall[0]) as answer:
        assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"]
        assert answer.headers["X-Frame-Options"] == "DENY"
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
