"""Filter fields that several pages share; what is chosen stays in the URL."""

from __future__ import annotations

import re
from collections import Counter
from datetime import datetime, timedelta
from typing import Any

import streamlit as st

from dashboard.address import one_of, some_of
from dashboard.data import Archive
from dashboard.findings import PERIODS, Selection, start_of
from dashboard.frame import plain
from dashboard.words import _
from storage.archive.views import NEWEST_TIME

_MOST_ODD = 3


def names(archive: Archive, column: str, selection: Selection | None = None) -> list[str]:
    """The different values of a column of `scenes`."""
    condition, parameters = (selection or Selection()).where()
    rows = archive.rows(
        f"SELECT DISTINCT {column} AS name FROM scenes WHERE {column} IS NOT NULL AND {condition} ORDER BY 1",
        parameters,
    )
    return [str(name) for name in rows["name"]]


def odd_serials(archive: Archive) -> list[str]:
    """Patterns such as STD-* of serial numbers that begin otherwise than most do, at most three."""
    begins = Counter(re.split("[0-9]", serial)[0] for serial in names(archive, "aircraft_serial"))
    (__, n), *others = begins.most_common() or [("", 0)]
    return [f"{begin}*" for begin, count in others if begin and count < n][:_MOST_ODD]


def ask_about_gauges(archive: Archive) -> None:
    """Where the settings name no gauges: which serial numbers may be some, and how to name them."""
    if odd := odd_serials(archive):
        st.caption(
            _("{names}: gauges?", names=plain(", ".join(odd))),
            help=_(
                "These serial numbers begin otherwise than most. If they are gauges or standard parts, name them "
                "in the settings (dashboard.toml in the store): `not_aircraft = [{names}]`. Overview, review and "
                "yield then leave them out.",
                names=", ".join(f'"{name}"' for name in odd),
            ),
        )


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
    aircraft = _several(columns[0], archive, _("Aircraft"), "aircraft", "aircraft_serial")
    panels = _several(columns[1], archive, _("Panel"), "panel", "panel")
    chosen = columns[2].selectbox(
        _("Scanned"),
        list(PERIODS),
        format_func=_,
        help=_("Counted back from the newest scan in the store."),
        **one_of("period", list(PERIODS), period),
    )
    stations, rigs = [], []
    if more:
        stations = _several(columns[3], archive, _("Station"), "station", "station")
        rigs = _several(columns[4], archive, _("Rig"), "rig", "rig_id")
    since = began(archive, chosen)
    return Selection(tuple(aircraft), tuple(panels), tuple(stations), tuple(rigs), since)


def began(archive: Archive, period: str) -> datetime | None:
    """When a period began, counted back from the newest scan."""
    since = start_of(period, newest_scan(archive))
    # A whole second, so that the same filter is the same query.
    return since.replace(microsecond=0) - timedelta(seconds=1) if since else None


def _several(box: Any, archive: Archive, title: str, name: str, column: str) -> list[str]:
    known = names(archive, column)
    return list(box.multiselect(title, known, placeholder=_("all"), **some_of(name, known)))
