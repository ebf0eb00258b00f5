"""Entry of the dashboard: `streamlit run` of this file, which `flushline dashboard` does."""

from __future__ import annotations

import streamlit as st

from dashboard import frame
from dashboard.views import archive, overview, review, runs, scene, sql, trends

# Title, icon and body of each page by its place in the URL.
PAGES = {
    "overview": (overview.TITLE, ":material/dashboard:", frame.guarded(overview.TITLE, overview.render)),
    "archive": (archive.TITLE, ":material/inventory_2:", frame.guarded(archive.TITLE, archive.render)),
    "scene": (scene.TITLE, ":material/center_focus_strong:", frame.guarded(scene.TITLE, scene.render)),
    "review": (review.TITLE, ":material/fact_check:", frame.guarded(review.TITLE, review.render)),
    "trends": (trends.TITLE, ":material/show_chart:", frame.guarded(trends.TITLE, trends.render)),
    "runs": (runs.TITLE, ":material/precision_manufacturing:", frame.guarded(runs.TITLE, runs.render)),
    "sql": (sql.TITLE, ":material/database:", frame.guarded(sql.TITLE, sql.render)),
}

# Less air above the title and between blocks: the pages must do with 1366 × 768.
_STYLE = """<style>
.stMainBlockContainer {padding: 3.4rem 1.6rem 1rem 1.6rem;}
[data-testid="stMetricValue"] {font-size: 1.5rem;}
[data-testid="stVerticalBlock"] {gap: 0.6rem;}
</style>"""


def main() -> None:
    """Build the pages and run the one that the URL names."""
    st.set_page_config("Flushline", ":material/flare:", layout="wide", initial_sidebar_state="collapsed")
    st.html(_STYLE)
    pages = {
        name: st.Page(body, title=title, icon=icon, url_path=name, default=name == "overview")
        for name, (title, icon, body) in PAGES.items()
    }
    frame.remember_pages(pages)
    st.navigation(list(pages.values()), position="top").run()


if __name__ == "__main__":
    main()
