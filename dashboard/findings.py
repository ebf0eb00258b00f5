"""Findings of the newest scans, as the pages list them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from typing import Any

import pandas as pd

from dashboard.data import NOTICED, Archive
from dashboard.locale import Locale
from dashboard.palette import OPEN_DECISIONS
from dashboard.words import N_, _
from metrology.kinds import BY_NAME, KINDS
from metrology.verdicts import OUTSIDE
from storage.archive.views import RANK_SQL
from storage.archive.work import DECIDED, OPEN_WORK, UNRESOLVED, Standing, findings_sql
from storage.review import Feature, ShownFinding

MOST_ROWS = 500
_MOST_NAMED = 12
LAST_NIGHT, LAST_WEEK = N_("last night"), N_("last 7 days")
PERIODS: dict[str, timedelta | None] = {
    N_("any time"): None,
    LAST_NIGHT: timedelta(hours=14),
    LAST_WEEK: timedelta(days=7),
    N_("last 30 days"): timedelta(days=30),
}
OPEN, ALL = N_("open"), N_("all")
STATES = (OPEN, OPEN_WORK, DECIDED, ALL)
"""What the list may be narrowed to; open is what waits and what has open work."""

_ORDER = f"{RANK_SQL}, severity = 'red' DESC NULLS LAST, abs(value_mm) DESC NULLS LAST, scene_id, feature_id"


@dataclass(frozen=True)
class Selection:
    """Which scenes are meant; empty means all."""

    aircraft: tuple[str, ...] = ()
    panels: tuple[str, ...] = ()
    stations: tuple[str, ...] = ()
    rigs: tuple[str, ...] = ()
    since: datetime | None = None
    until: datetime | None = None
    """since, until: of the scan."""
    without: tuple[str, ...] = ()
    """Patterns of serial numbers that are left out, such as STD-*."""

    def where(self) -> tuple[str, list[Any]]:
        """A SQL condition on a table's key columns, and its parameters."""
        conditions, parameters = ["true"], list[Any]()
        for column, wanted in (
            ("aircraft_serial", self.aircraft),
            ("panel", self.panels),
            ("station", self.stations),
            ("rig_id", self.rigs),
        ):
            if wanted:
                conditions.append(f"{column} IN ({', '.join('?' * len(wanted))})")
                parameters += wanted
        for column, moment in (("captured_at >=", self.since), ("captured_at <=", self.until)):
            if moment is not None:
                conditions.append(f"{column} ?")
                parameters.append(moment)
        for pattern in self.without:
            conditions.append("NOT aircraft_serial GLOB ?")
            parameters.append(pattern)
        return " AND ".join(conditions), parameters


def start_of(period: str, newest: datetime | None) -> datetime | None:
    """When a period begins. It counts back from the newest scan, so that it is never empty after a quiet week."""
    span = PERIODS.get(period)
    return newest - span if span and newest is not None else None


@dataclass(frozen=True)
class Wanted:
    """Which findings of a selection are listed."""

    decisions: tuple[str, ...] = OPEN_DECISIONS
    kinds: tuple[str, ...] = tuple(BY_NAME)
    """Their names."""
    state: str = "open"
    """"open", "open work", "decided" or "all": open: waiting for a decision, or with open work."""
    selection: Selection = field(default_factory=Selection)


def findings(archive: Archive, wanted: Wanted, most: int = MOST_ROWS) -> pd.DataFrame:
    """Findings, the gravest first, then by size; at most `most`.

    Columns: those of `findings_sql`, and total: how many there are without the limit.
    """
    if wanted.state == OPEN_WORK and not archive.review().work():
        wanted, most = replace(wanted, kinds=()), 0  # nothing needs to be looked through
    candidates, parameters = _candidates(wanted)
    return archive.rows_with_review(
        f"WITH c AS MATERIALIZED ({candidates}) SELECT *, (SELECT count(*) FROM c) AS total FROM c "
        f"ORDER BY {_ORDER} LIMIT {int(most)}",
        parameters,
    )


def _candidates(wanted: Wanted) -> tuple[str, list[Any]]:
    """All findings that are wanted."""
    scenes, selected = wanted.selection.where()
    # The selection stands in all tables: in those of features it lets DuckDB pass over most rows.
    near, near_selected = replace(wanted.selection, rigs=()).where()
    decisions = list(wanted.decisions) or [""]
    # A stretch is listed by its gravest verdict, with all of its positions.
    of_rows = [*decisions, *(OUTSIDE if set(decisions) & set(OUTSIDE) else ())]
    # Open work is listed whatever a later run of its scan says, unless verdicts are chosen.
    every = set(decisions) == set(OPEN_DECISIONS)
    worked, worked_decisions = ("true", list[str]()) if every else (_among("decision", of_rows), of_rows)
    kinds = [BY_NAME[name] for name in wanted.kinds]
    sql = findings_sql(kinds, _among("decision", of_rows), worked, near, scenes, noticed=NOTICED)
    of_features = [*of_rows, *near_selected, *near_selected, *worked_decisions, *of_rows]
    states = {OPEN: UNRESOLVED, ALL: ()}.get(wanted.state, (wanted.state,))
    chosen: list[tuple[str, Sequence[str]]] = [("state", states)] if states else []
    chosen += [] if every else [("decision", decisions)]
    conditions = " AND ".join(_among(name, values) for name, values in chosen) or "true"
    parameters = [*selected, *of_features, *(value for __, values in chosen for value in values)]
    return f"FROM ({sql}) WHERE {conditions}", parameters


def _among(column: str, values: Sequence[str]) -> str:
    return f"{column} IN ({', '.join('?' * len(values))})"


def feature_of(row: Any) -> Feature:
    """The feature that a row of `findings` is about."""
    return Feature(row.feature_kind, str(row.feature_id))


def feature_words(feature_id: str, locale: Locale) -> str:
    """A feature as people read it: R04, M1 at 8 mm, M1 136–200 mm."""
    return locale.positions(feature_id)


def name_of(shown: ShownFinding, locale: Locale) -> str:
    """A finding in full: rivet or position, aircraft, panel, station."""
    return f"{feature_words(shown.feature.id, locale)} ({place_of(shown)})"


def place_of(shown: ShownFinding) -> str:
    """Aircraft, panel and station of a finding."""
    return " ".join(str(shown.values[name]) for name in ("aircraft_serial", "panel", "station"))


def names_of(shown: Sequence[ShownFinding], locale: Locale) -> str:
    """Several findings in a line; with their places where these differ."""
    places = {place_of(finding) for finding in shown}
    alike = len(places) == 1
    names = [feature_words(s.feature.id, locale) if alike else name_of(s, locale) for s in shown[:_MOST_NAMED]]
    more = " " + _("and {n} more", n=len(shown) - _MOST_NAMED) if len(shown) > _MOST_NAMED else ""
    return ", ".join(names) + more + (f" ({places.pop()})" if alike else "")


def standings_words(standings: Iterable[Standing]) -> str:
    """How many findings stand how: "18 waiting, 1 open work, 1 decided"."""
    counts = Counter(standing.state for standing in standings)
    said = [f"{counts[state]} {_(state)}" for state in (*UNRESOLVED, DECIDED) if counts[state]]
    return ", ".join(said) or _("no findings")


def feature_parameter(feature: Feature) -> str:
    """A feature as the URL has it."""
    return f"{BY_NAME[feature.kind].parameter}:{feature.id}"


def feature_from_parameter(text: str | None) -> Feature | None:
    """The feature that a URL names; None where it names none."""
    parameter, __, name = (text or "").partition(":")
    kind = next((kind for kind in KINDS if kind.parameter == parameter), None)
    return Feature(kind.name, name) if kind and name else None
