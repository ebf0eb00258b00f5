"""What stands at the end of the page that a browser loads: styles and scripts of all pages.

As parts of Streamlit's pages they would be sent, looked through and drawn anew with each of them.
"""

from __future__ import annotations

from dashboard.keys import KEYS_IN_ORDER, NAME_KEY
from dashboard.loading_ahead import script as loading_ahead

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
.st-key-take-back {display: none;}
.st-key-decisions button {padding: 0.25rem 0.5rem;}
</style>"""


# Where a page leads to another one with a query, Streamlit first writes the query behind the address of the page
# that is left: the browser's back button would lead there, to a page that nobody saw. This puts
# the next page in its place.
_ONE_STEP = """<script>
{
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


def page_end() -> str:
    """Styles, and scripts that watch keys and addresses. They lie behind Streamlit's own styles, and so prevail."""
    return "\n".join((_STYLE, _ONE_STEP, NAME_KEY, KEYS_IN_ORDER, loading_ahead()))
