"""Entry of the dashboard: `streamlit run` of this file, which `flushline dashboard` does."""

from __future__ import annotations

import streamlit as st

from dashboard import frame
from dashboard.views import archive, overview, panel, review, runs, scene, sql, trends
from dashboard.words import _

# Title, icon and body of each page by its place in the URL.
PAGES = {
    "overview": (overview.TITLE, ":material/dashboard:", frame.guarded(overview.TITLE, overview.render)),
    "archive": (archive.TITLE, ":material/inventory_2:", frame.guarded(archive.TITLE, archive.render)),
    "panel": (panel.TITLE, ":material/grid_on:", frame.guarded(panel.TITLE, panel.render)),
    "scene": (scene.TITLE, ":material/center_focus_strong:", frame.guarded(scene.TITLE, scene.render)),
    "review": (review.TITLE, ":material/fact_check:", frame.guarded(review.TITLE, review.render)),
    "trends": (trends.TITLE, ":material/show_chart:", frame.guarded(trends.TITLE, trends.render)),
    "runs": (runs.TITLE, ":material/precision_manufacturing:", frame.guarded(runs.TITLE, runs.render)),
    "sql": (sql.TITLE, ":material/database:", frame.guarded(sql.TITLE, sql.render)),
}

# A rivet in a skin. Drawn here: a symbol's name would make the browser ask a server on the internet for it.
_ICON = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 24 24">
<rect width="24" height="24" rx="5" fill="#0072B2"/>
<circle cx="12" cy="12" r="7" fill="none" stroke="#fff" stroke-width="2"/>
<circle cx="12" cy="12" r="2.5" fill="#fff"/></svg>"""
_HOME = "overview"


def main() -> None:
    """Build the pages and run the one that the URL names."""
    frame.speak_their_language()
    st.set_page_config("Flushline", _ICON, layout="wide", initial_sidebar_state="collapsed")
    pages = {
        name: st.Page(body, title=_(title), icon=icon, url_path="" if name == _HOME else name, default=name == _HOME)
        for name, (title, icon, body) in PAGES.items()
    }
    frame.remember_pages(pages)
    # The home page's address is the server's; who types its name gets there, too.
    typed = st.Page(_go_home, title=_(PAGES[_HOME][0]), url_path=_HOME, visibility="hidden")
    st.navigation([*pages.values(), typed], position="top").run()


def _go_home() -> None:
    frame.go(_HOME, **st.query_params.to_dict())


if __name__ == "__main__":
    main()
