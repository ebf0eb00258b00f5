"""The server's process: loads what the pages need before it answers, then it is Streamlit's.

Plotly, pandas and the pages take over a second to load; the first visitor would wait for them otherwise.
"""

from __future__ import annotations


def preload() -> None:
    """Import the pages and make the first figure and styled table, which load most of their libraries when used."""
    import logging

    import pandas as pd
    import plotly.graph_objects as go

    caches = logging.getLogger("streamlit.runtime.caching.cache_data_api")
    caches.disabled = True  # it warns of every cache that is declared before the server runs
    import dashboard.app  # noqa: F401
    import storage.review_database  # noqa: F401  what the review log is kept in
    from dashboard.reasons import worded

    caches.disabled = False
    worded("")  # compiles what stored reasons are recognised by

    go.Figure(go.Scatter(x=[0], y=[0])).to_json()
    pd.DataFrame({"x": [0.0]}).style.format("{:.1f}").to_html()


def main() -> None:
    """Take Streamlit's command line."""
    import gc

    from streamlit.web.cli import main as streamlit

    preload()
    gc.freeze()  # Streamlit collects after every run of a page; what was loaded once holds no waste
    from dashboard.warming import keep_warm

    keep_warm()
    streamlit(prog_name="streamlit")


if __name__ == "__main__":
    main()
