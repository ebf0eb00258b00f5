"""Reading ahead what the first look at a new index needs, so that nobody waits for it in the morning.

What is read of an index is kept until the next one is published (`dashboard.data`). Who looks first after a night of
inspections would wait for the findings of all aircraft and for what drifts, the two questions that take longest.
"""

from __future__ import annotations

import logging
import os
import threading
import time

from dashboard.data import Archive
from dashboard.filters import began, newest_scan
from dashboard.findings import PERIODS, Selection, Wanted, findings, start_of
from dashboard.margins import with_margins
from dashboard.news import Since, changes, new_scans
from dashboard.panels import load_panel, panel_names, stitched_pictures
from dashboard.settings import load_settings, store_root
from dashboard.views.waiting import panel_states
from storage.archive.changes import drift_sql

OFF_VARIABLE = "FLUSHLINE_NO_READ_AHEAD"
"""Set, nothing is read ahead."""
_EVERY_S = 2.0
_QUIET_S = 20.0  # an index that is replaced sooner is not read: inspections are running
_LOG = logging.getLogger("flushline.dashboard")


def keep_warm() -> None:
    """Read ahead in the background whenever an index stayed the newest for a while, and at once at the start."""
    if not os.environ.get(OFF_VARIABLE):
        threading.Thread(target=_watch, name="read-ahead", daemon=True).start()


def read_ahead(archive: Archive) -> None:
    """Read what the review and the overview show, at first and for each of their periods, and the newest panel."""
    without = load_settings(archive.root).not_aircraft
    archive.shared_rows(drift_sql("true"))
    panel_states(archive, Selection(without=without))
    for newest in panel_names(archive).head(1).itertuples():
        if view := load_panel(archive, str(newest.aircraft_serial), str(newest.panel)):
            stitched_pictures(archive, view)
    for period in PERIODS:  # any time, which is shown at first, is the first of them
        selection = Selection(since=began(archive, period), without=without)
        with_margins(archive, findings(archive, Wanted(selection=selection)))
        if start := start_of(period, newest_scan(archive)):
            since = Since(None, Selection(since=start, without=without))
            changes(archive, since)
            new_scans(archive, since)


def _watch() -> None:
    done, seen, since = "", "", 0.0
    while True:
        try:
            archive = Archive(store_root())
            now = archive.generation
            if now != seen:
                since, seen = (time.monotonic() if seen else 0.0), now
            if now and now != done and time.monotonic() - since >= _QUIET_S:
                done = now
                read_ahead(archive)
        except Exception as problem:  # the pages say what is wrong with a store
            _LOG.info("read ahead: %s", problem)
        time.sleep(_EVERY_S)
