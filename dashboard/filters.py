"""Filter fields that several pages share; what is chosen stays in the URL."""

from __future__ import annotations

from datetime import datetime, timedelta

import streamlit as st

from dashboard.data import Archive
from dashboard.findings import PERIODS, Selection, start_of
from storage.archive.views import NEWEST_TIME


def names(archive: Archive, column: str, selection: Selection | None = None) -> list[str]:
    """The different values of a column of `scenes`."""
    condition, parameters = (selection or Selection()).where()
    rows = archive.rows(
        f"SELECT DISTINCT {column} AS name FROM scenes WHERE {column} IS NOT NULL AND {condition} ORDER BY 1",
        parameters,
    )
    return [str(name) for name in rows["name"]]


def newest_scan(archive: Archive) -> datetime | None:
    """When the newest scan was taken."""
    newest = archive.rows(f"SELECT {NEWEST_TIME} AS newest FROM scenes")["newest"][0]
    return None if newest is None or newest != newest else newest.to_pydatetime()


def scene_filters(archive: Archive, more: bool = False, period: str = "any time") -> Selection:
    """Fields for aircraft, panel and period; with `more` also station and rig.

    Parameters
    ----------
    period : str
        Chosen at first.
    """
    columns = st.columns(5 if more else 3)
    aircraft = columns[0].multiselect(
        "Aircraft", names(archive, "aircraft_serial"), key="aircraft", bind="query-params", placeholder="all"
    )
    panels = columns[1].multiselect(
        "Panel", names(archive, "panel"), key="panel", bind="query-params", placeholder="all"
    )
    chosen = columns[2].selectbox(
        "Scanned",
        list(PERIODS),
        index=list(PERIODS).index(period),
        key="period",
        bind="query-params",
        help="Counted back from the newest scan in the store.",
    )
    stations, rigs = [], []
    if more:
        stations = columns[3].multiselect(
            "Station", names(archive, "station"), key="station", bind="query-params", placeholder="all"
        )
        rigs = columns[4].multiselect(
            "Rig", names(archive, "rig_id"), key="rig", bind="query-params", placeholder="all"
        )
    since = start_of(chosen, newest_scan(archive))
    # A whole second, so that the same filter is the same query.
    since = since.replace(microsecond=0) - timedelta(seconds=1) if since else None
    return Selection(tuple(aircraft), tuple(panels), tuple(stations), tuple(rigs), since)
