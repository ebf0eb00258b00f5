"""What is new since a moment: what changed on the newest scans, what drifts, what was not inspected, rigs due."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from dashboard.data import Archive
from dashboard.findings import Selection
from dashboard.quarantine import put_aside
from dashboard.reasons import SEPARATOR
from dashboard.words import N_, _
from storage.archive.changes import changes_sql, drift_sql
from storage.export.events import rigs_due

_FEWEST = 6  # scans that a drift is told from
_CHANCE = 0.05  # that one of all places that are watched is said to drift although it does not


@dataclass(frozen=True)
class Since:
    """Which scans are new: those stored after a moment, or those of a selection."""

    stored: datetime | None = None
    selection: Selection = field(default_factory=Selection)

    def where(self) -> tuple[str, list[Any]]:
        """A condition on `latest_scenes`, and its parameters."""
        condition, parameters = self.selection.where()
        if self.stored is None:
            return condition, parameters
        return f"{condition} AND coalesce(first_stored_at, processed_at) > ?", [*parameters, self.stored]


def changes(archive: Archive, since: Since) -> pd.DataFrame:
    """Findings of the new scans, compared with the scans before them (see `changes_sql`)."""
    condition, parameters = since.where()
    return archive.rows(changes_sql(condition), parameters)


def new_scans(archive: Archive, since: Since) -> pd.DataFrame:
    """The new scans: key, warnings, rig_verdict."""
    condition, parameters = since.where()
    return archive.rows(
        "SELECT aircraft_serial, panel, station, captured_at, scene_id, rig_verdict, warnings FROM latest_scenes "
        f"WHERE {condition} ORDER BY captured_at DESC, scene_id",
        parameters,
    )


def drifts(archive: Archive, since: Since) -> pd.DataFrame:
    """Places whose values move from scan to scan by more than chance allows, the steepest first (see `drift_sql`).

    A line through the values of a place against the order of its scans has a slope that Student's t tells from none.
    So many places are watched that some always look like it: the level is shared among all of them (Bonferroni).
    """
    # Of all stations, whatever is new: so it is asked once for every choice of what counts as new.
    scanned = new_scans(archive, since)[["panel", "station"]].drop_duplicates()
    watched = archive.shared_rows(drift_sql("true")).merge(scanned, on=["panel", "station"])
    watched = watched[watched["n"] >= _FEWEST]
    r, n = watched["r"].to_numpy(float), watched["n"].to_numpy(float)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.abs(r) * np.sqrt((n - 2) / np.maximum(1 - r**2, 0))
    found = watched[np.nan_to_num(t) > stats.t.isf(_CHANCE / 2 / max(1, len(watched)), np.maximum(n - 2, 1))]
    return found.sort_values("slope", key=abs, ascending=False).reset_index(drop=True)


def not_inspected(inboxes: Sequence[str], scans: pd.DataFrame, since: datetime | None) -> pd.DataFrame:
    """What there is no sound result of: scans put aside with the reason, and scans whose rig could not be judged."""
    aside = put_aside(inboxes)
    if since is not None and len(aside):
        aside = aside[aside["at"] > since]
    aside = aside.assign(what=N_("put aside"), scene_id=None)[["at", "scene", "what", "why", "scene_id"]]
    doubtful = scans[scans["rig_verdict"] == "unjudged"]
    unjudged = pd.DataFrame(
        {"at": row.captured_at, "scene": row.scene_id, "what": N_("rig not judged"), "scene_id": row.scene_id,
         "why": SEPARATOR.join(map(str, row.warnings)) or _("the scan cannot tell whether its rig fits")}
        for row in doubtful.itertuples()
    )  # fmt: skip
    return pd.concat([part for part in (aside, unjudged) if len(part)] or [aside], ignore_index=True)


def due_rigs(archive: Archive, now: datetime) -> pd.DataFrame:
    """Rigs in use whose calibration or verification is due within a week or overdue: rig_id, what, due_at, late."""
    rows = [
        {"rig_id": event.data["rig_id"], "what": event.data["due"], "due_at": pd.Timestamp(event.at),
         "late": event.at < now}
        for event in rigs_due(archive.store, now)
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=["rig_id", "what", "due_at", "late"])
