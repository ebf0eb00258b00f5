"""What changed on a panel since an earlier night, and what became of its rework, as the page shows it."""

from __future__ import annotations

from dataclasses import asdict
from datetime import datetime

import pandas as pd
import streamlit as st

from dashboard.data import Archive
from dashboard.panels import PanelView
from metrology.assembly.rows import CHANGES
from metrology.results import PanelKey
from storage.archive.panel_changes import compared, earlier_shifts, runs_of_panel
from storage.archive.panel_rework import rework_sql


def earlier_nights(archive: Archive, view: PanelView) -> dict[str, datetime]:
    """The last assembly of each shift before the one that is shown, by their runs, the oldest first."""
    return _earlier(archive, archive.generation, str(view.row.aircraft_serial), str(view.row.panel))


def changes_since(archive: Archive, view: PanelView, run_id: str) -> pd.DataFrame:
    """The rows of `panel_changes` as they are against one of these, with `change` in order."""
    key = str(view.row.aircraft_serial), str(view.row.panel)
    return _changes(archive, archive.generation, *key, run_id)


def rework_of(archive: Archive, view: PanelView) -> pd.DataFrame:
    """Work that was decided, and what became of it (see `rework_sql`)."""
    return archive.rows_with_review(rework_sql(), [view.row.aircraft_serial, view.row.panel])


@st.cache_data(max_entries=50, show_spinner=False)
def _earlier(_archive: Archive, generation: str, aircraft: str, panel: str) -> dict[str, datetime]:
    runs = runs_of_panel(_archive.store, PanelKey(aircraft, panel))
    return {run.run_id: run.captured_at for run in earlier_shifts(runs[-1], runs)}


@st.cache_data(max_entries=50, show_spinner=False)
def _changes(_archive: Archive, generation: str, aircraft: str, panel: str, run_id: str) -> pd.DataFrame:
    *earlier, now = runs_of_panel(_archive.store, PanelKey(aircraft, panel))
    before = next(run for run in earlier if run.run_id == run_id)
    rows = sorted((asdict(row) for row in compared(now, before)), key=lambda row: CHANGES.index(row["change"]))
    return pd.DataFrame(rows).rename(
        columns={"value": "value_mm", "before_value": "before_mm", "difference": "difference_mm",
                 "difference_u95": "difference_u95_mm"}
    )  # fmt: skip
