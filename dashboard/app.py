"""Entry of the dashboard: `streamlit run` of this file, which `flushline dashboard` does."""

from __future__ import annotations

import streamlit as st

from dashboard import frame
from dashboard.keys import NAME_KEY
from dashboard.loading_ahead import load_ahead
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

# Less air above the title and between blocks: the pages must do with 1366 × 768. With touch a chart's tools would
# always lie over its legend; fingers do what they do.
_STYLE = """<style>
.stMainBlockContainer {padding: 3.4rem 1.6rem 1rem 1.6rem;}
[data-testid="stMetricValue"] {font-size: 1.5rem;}
[data-testid="stVerticalBlock"] {gap: 0.6rem;}
.st-key-finding {max-height: max(230px, calc(100vh - 490px)); overflow-y: auto;}
.st-key-panel-warnings {max-height: 3.2rem; overflow-y: auto; flex: none;}
.st-key-questions {gap: 0.3rem 0.4rem;}
.st-key-questions button {min-height: 1.9rem; padding: 0.1rem 0.6rem;}
.st-key-questions button p {font-size: 0.875rem;}
.st-key-tables.st-key-tables {max-height: max(480px, calc(100vh - 165px)); overflow-y: auto; flex: none;}
@media (max-width: 1100px) {
  [data-testid="stMetricValue"] {font-size: 1.1rem;}
  [data-testid="stMetricLabel"] p {font-size: 0.7rem; white-space: normal;}
  .st-key-finding.st-key-finding {max-height: max(175px, calc(100vh - 565px));}
  [data-testid="stTopNavLink"][data-testid="stTopNavLink"] {padding: 4px 5px;}
  [data-testid="stTopNavLink"] span {font-size: 13px;}
  [data-testid="stButtonGroup"] > div {flex-wrap: wrap; mask-image: none; -webkit-mask-image: none;}
}
@media (hover: none) {.modebar-container {display: none;}}
.st-key-decisions {gap: 0.4rem;}
.st-key-decisions button {padding: 0.25rem 0.5rem;}
</style>"""


# Where a page leads to another one with a query, Streamlit first writes the query behind the address of the page
# that is left: the browser's back button would lead there, to a page that nobody saw. This puts
# the next page in its place.
_ONE_STEP = """<script>
if (!window.flushlineOneStep) {
  window.flushlineOneStep = true;
  const push = history.pushState.bind(history);
  let pushed = 0;
  history.pushState = (state, title, url) => {
    const next = new URL(url ?? location.href, location.href);
    const onlyPath = next.search && next.search === location.search && next.pathname !== location.pathname;
    if (onlyPath && Date.now() - pushed < 10000) history.replaceState(state, title, url);
    else push(state, title, url);
    pushed = next.pathname === location.pathname ? Date.now() : 0;
  };
}
</script>"""

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
    st.html(_STYLE)
    st.html(_ONE_STEP + NAME_KEY, unsafe_allow_javascript=True)
    load_ahead()
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
