"""First-pass yield: the share of panels that nothing is outside of its limits on, by the first scan of each station."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from scipy.stats import beta

from dashboard.data import Archive
from dashboard.findings import Selection
from dashboard.words import N_
from metrology.kinds import KINDS
from storage.archive.views import OUTSIDE_SQL, TAKEN_AT

YIELD_BY = {
    N_("panel"): "panel",
    N_("aircraft"): "aircraft_serial",
    N_("month"): "strftime(began AT TIME ZONE 'UTC', '%Y-%m')",
    N_("week"): "strftime(began AT TIME ZONE 'UTC', '%G-W%V')",
}
"""What panels of aircraft are counted by, and its SQL; months and weeks (ISO 8601) are those of the first scan, UTC."""
_UNKNOWN = "decision IN ('not measured', 'unconfirmed')"


@dataclass(frozen=True)
class Yield:
    """What became of the panels of one name, aircraft or period on their first scans."""

    name: str
    passed: int
    """Nothing outside, and everything judged."""
    failed: int
    """Something outside its limits."""
    undecided: int
    """Nothing outside, but something not measured or unconfirmed, or a rig that could not be judged."""

    @property
    def n(self) -> int:
        """Panels."""
        return self.passed + self.failed + self.undecided

    @property
    def share(self) -> float:
        """Passed, of all: what is undecided did not pass."""
        return self.passed / self.n

    @property
    def interval(self) -> tuple[float, float]:
        """Where the share of the process lies in 95 of 100 cases (C. J. Clopper and E. S. Pearson, Biometrika 1934)."""
        k, n = self.passed, self.n
        low = beta.ppf(0.025, k, n - k + 1) if k else 0.0
        high = beta.ppf(0.975, k + 1, n - k) if k < n else 1.0
        return float(low), float(high)


def first_pass(archive: Archive, by: str, since: datetime | None = None, without: tuple[str, ...] = ()) -> list[Yield]:
    """The yield of each panel, aircraft or period (`YIELD_BY`), by name.

    Parameters
    ----------
    since : datetime, optional
        Panels that were first scanned before it are left out; a re-scan does not bring them back.
    without : tuple of str
        Patterns of serial numbers that are no aircraft.
    """
    condition, parameters = Selection(without=without).where()
    judged = " UNION ALL ".join(
        f"SELECT scene_id, {OUTSIDE_SQL} AS outside FROM {kind.table} WHERE {OUTSIDE_SQL} OR {_UNKNOWN}"
        for kind in KINDS
    )
    rows = archive.rows(
        f"""WITH firsts AS (
    SELECT scene_id, aircraft_serial, panel, rig_verdict, n_missing, {TAKEN_AT} AS taken_at FROM scenes
    WHERE {condition}
    QUALIFY row_number() OVER (PARTITION BY aircraft_serial, panel, station ORDER BY {TAKEN_AT}, scene_id) = 1
), of_scene AS (SELECT scene_id, bool_or(outside) AS outside FROM ({judged}) GROUP BY 1
), units AS (
    SELECT aircraft_serial, panel, min(taken_at) AS began, bool_or(coalesce(outside, false)) AS failed,
        bool_or(outside IS NOT NULL OR rig_verdict = 'unjudged' OR n_missing > 0) AS noticed
    FROM firsts LEFT JOIN of_scene USING (scene_id) GROUP BY ALL
)
SELECT {YIELD_BY[by]} AS name, count(*) FILTER (failed) AS failed,
    count(*) FILTER (NOT failed AND coalesce(noticed, false)) AS undecided, count(*) AS n
FROM units WHERE {"began >= ?" if since else "true"} GROUP BY 1 ORDER BY 1""",
        [*parameters, *([since] if since else [])],
    )
    return [
        Yield(str(row.name), int(row.n - row.failed - row.undecided), int(row.failed), int(row.undecided))
        for row in rows.itertuples(index=False)
    ]
