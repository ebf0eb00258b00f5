"""What every page shares: who asks, their language and numbers, and that no traceback ever reaches them."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, cast

import streamlit as st

from dashboard.access import Person, current_person, log_out, login_configured
from dashboard.address import one_of, unknown_values
from dashboard.data import Archive
from dashboard.locale import STYLE_NAMES, Locale, locale_of
from dashboard.reasons import worded
from dashboard.settings import SettingsModel, load_settings, store_root
from dashboard.words import ENGLISH, KEPT, LANGUAGES, _, language, speak
from metrology.errors import FlushlineError

_LOG = logging.getLogger("flushline.dashboard")
_PAGES = "flushline_pages"
_STYLE = "flushline_style"


@dataclass(frozen=True)
class PageContext:
    """The page context: what a page works with."""

    archive: Archive
    locale: Locale
    person: Person
    settings: SettingsModel


def guarded(title: str, render: Callable[[PageContext], None], needs_results: bool = True) -> Callable[[], None]:
    """A page: title and settings above, then what `render` shows; what goes wrong is said in one line.

    Parameters
    ----------
    needs_results : bool
        Whether the page says nothing without at least one inspected scene.
    """

    def page() -> None:
        try:
            speak_their_language()
            _page(title, render, needs_results)
        except FlushlineError as problem:
            st.error(told(problem), icon=":material/error:")
        except Exception as problem:  # whatever is in the store or the URL
            _LOG.exception("page %s", title)
            st.error(
                _(
                    "This page met something it did not expect ({problem}); the server's log says more. "
                    "The other pages are not affected.",
                    problem=plain(type(problem).__name__),
                ),
                icon=":material/error:",
            )

    page.__name__ = render.__module__.rpartition(".")[2]
    return page


def _page(title: str, render: Callable[[PageContext], None], needs_results: bool) -> None:
    root = store_root()
    settings = load_settings(root)
    person = current_person(settings.roles, root)
    with st.container(horizontal=True, vertical_alignment="center"):
        st.markdown(f"##### {plain(settings.title)} · {plain(_(title))}")
        locale = _corner(settings, person, root)
    if person.role == "nobody":
        _ask_to_log_in(person, root)
        return
    archive = Archive(root)
    if needs_results and archive.empty:
        say_how_to_begin(archive)
        return
    place = st.empty()
    unknown_values()
    render(PageContext(archive, locale, person, settings))
    if unknown := unknown_values():
        said = "; ".join(plain(value) for value in unknown)
        place.warning(
            _("The address asks for what is not here, and is shown without it: {said}.", said=said),
            icon=":material/link_off:",
        )


def _corner(settings: SettingsModel, person: Person, root: Path) -> Locale:
    """Upper right: who is here, and how numbers and times are written."""
    with st.container(horizontal=True, horizontal_alignment="right", vertical_alignment="center", gap="small"):
        if not login_configured():
            st.caption(
                _("This computer only · no log-in"), help=_("docs/dashboard.md says how to set up a log-in and roles.")
            )
        elif person.name:
            st.caption(f"{plain(person.name)} · {_(person.role)}")
        with st.popover(_("Settings"), icon=":material/tune:", type="tertiary"):
            st.selectbox(
                _("Language"), list(LANGUAGES), format_func=LANGUAGES.__getitem__,
                **one_of("language", list(LANGUAGES), language()),
            )  # fmt: skip
            browser = _context("locale") or ""
            tag = browser if browser.lower().startswith(language()) else language()
            guessed = locale_of(tag, _context("timezone"), settings.numbers)
            named = {short: name for name, short in STYLE_NAMES.items()}
            first = st.session_state.get(_STYLE) or named[guessed.style]
            style = st.selectbox(
                _("Numbers and dates"), list(STYLE_NAMES), format_func=_, **one_of("numbers", list(STYLE_NAMES), first)
            )
            if "numbers" in st.query_params:
                st.session_state[_STYLE] = style  # stays when a link leads to another page
            locale = Locale(STYLE_NAMES.get(style, guessed.style), guessed.zone)
            st.caption(f"{locale.number(1234.5, 1)} · {locale.time(datetime.now(UTC))}")
            st.caption(_("Times: {zone}", zone=guessed.zone))
            if person.verified:
                st.button(_("Log out"), on_click=log_out, args=(root,))
    return locale


def _ask_to_log_in(person: Person, root: Path) -> None:
    if person.name:
        st.warning(_("You are logged in, but this dashboard's settings give you no role. Ask whoever runs it."))
        st.button(_("Log out and in as someone else"), on_click=log_out, args=(root,))
        return
    st.info(_("Please log in to see inspection results."))
    st.button(_("Log in"), on_click=st.login, type="primary")


def speak_their_language() -> None:
    """Word this run in the language that the address names, else the one of before, the settings', or the browser's."""
    try:
        preset = load_settings(store_root()).language
    except FlushlineError:  # the page says what is wrong
        preset = None
    asked = (st.query_params.get("language"), st.session_state.get(KEPT), preset, str(_context("locale"))[:2].lower())
    speak(next((name for name in asked if name in LANGUAGES), ENGLISH))
    st.session_state[KEPT] = language()


def say_how_to_begin(archive: Archive) -> None:
    """For a store without results: what to do next."""
    st.info(_("No scan has been inspected into this store yet."), icon=":material/inbox:")
    st.markdown(_("Inspect a scan with its rig, and come back:"))
    st.code(f"flushline inspect SCENE --rig rig.json --store {archive.root}", language="sh")
    st.markdown(_("Or look around first with a simulated panel:"))
    st.code("flushline demo --out demo\nflushline dashboard --store demo/store", language="sh")
    if st.button(_("Look again"), icon=":material/refresh:"):
        st.rerun()


def _context(name: str) -> str | None:
    """The browser's locale or time zone; a test has neither."""
    try:
        return cast("str | None", getattr(st.context, name))
    except Exception:  # Streamlit raises kinds of its own outside a browser session
        return None


def plain(text: object) -> str:
    """Text from the store or the URL for use in Markdown: shown as it is, never as markup."""
    return re.sub(r"([\\`*_{}\[\]()#+!|<>~$:-])", r"\\\1", " ".join(str(text).split()))


def told(problem: object) -> str:
    """A refusal, for use in Markdown: in the person's language, and never as markup."""
    return plain(worded(str(problem)))


def remember_pages(pages: dict[str, Any]) -> None:
    """Keep the pages by name, for `go`."""
    st.session_state[_PAGES] = pages


def go(page: str, **parameters: str | None) -> None:
    """Open another page with query parameters."""
    wanted = {name: value for name, value in parameters.items() if value is not None}
    pages = st.session_state.get(_PAGES)
    if pages:
        st.switch_page(pages[page], query_params=wanted)
    st.query_params.from_dict(wanted)


def link(page: str, label: str, icon: str | None = None, **parameters: str | None) -> None:
    """A link to another page."""
    wanted = {name: value for name, value in parameters.items() if value is not None}
    pages = st.session_state.get(_PAGES)
    if pages:
        st.page_link(pages[page], label=label, icon=icon, query_params=wanted)
