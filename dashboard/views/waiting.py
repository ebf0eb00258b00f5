"""Where work waits: aircraft × panels, when they were last scanned, how they stand, and what waits for a person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pandas as pd
import streamlit as st
from streamlit.delta_generator import DeltaGenerator

from dashboard.data import NOTICED, Archive
from dashboard.figures.overview import decision_bar, panel_matrix
from dashboard.filters import newest_scan, scene_filters
from dashboard.findings import Selection
from dashboard.frame import PageContext, go, link
from dashboard.locale import Locale
from dashboard.palette import DECISION_SIGNS, OPEN_DECISIONS, decision_words
from dashboard.picking import clickable_chart
from dashboard.tables import show_table
from dashboard.words import _
from metrology.kinds import KINDS, RIVET, SEAM_STATION, Kind
from storage.archive.views import NEWEST_TIME
from storage.archive.work import DECIDED, OPEN_WORK, findings_sql

_MOST_ROWS = 200
# The column of each open decision's count.
_COLUMNS = {decision: decision.replace(" ", "_") for decision in OPEN_DECISIONS}
_ALONG = f"feature_kind IN ({', '.join(repr(kind.name) for kind in KINDS if kind.is_course)})"
_NAMED = f"""(scene_id, feature_kind, CASE WHEN {_ALONG} THEN split_part(feature_id, '@', 1) ELSE feature_id END)"""
"""What a finding is of: a rivet, a seam."""


def where_work_waits(context: PageContext, beside: DeltaGenerator) -> None:
    """What waits, by aircraft and panel.

    Parameters
    ----------
    beside : DeltaGenerator
        Left free.
    """
    selection = replace(scene_filters(context.archive), without=context.settings.not_aircraft)
    panels = panel_states(context.archive, selection)
    if panels.empty:
        st.info(_("No scan matches these filters. Clear one of them to see more."))
        return
    _totals(context, panels)
    left, right = st.columns([3, 2])
    with left:
        _waiting(context, panels, selection)
    with right:
        _matrix(context.locale, panels)


def panel_states(archive: Archive, selection: Selection) -> pd.DataFrame:
    """One row per panel of each aircraft, from the newest scan of each station; the most work first."""
    condition, selected = selection.where()
    features = " + ".join(f"coalesce({_counted_as(kind)}, 0)" for kind in KINDS)
    by_decision = ", ".join(
        f"count(*) FILTER (newest AND decision = '{decision}') AS {column}" for decision, column in _COLUMNS.items()
    )
    found = findings_sql(near=condition, scenes=condition, noticed=NOTICED)
    sql = f"""
WITH s AS (
    SELECT scene_id, aircraft_serial, panel, captured_at, first_stored_at, processed_at, rig_verdict,
        {features} AS features
    FROM latest_scenes WHERE {condition}
), f AS (
    SELECT *, scene_id IN (SELECT scene_id FROM s) AS newest FROM ({found})
), per_panel AS (
    SELECT aircraft_serial, panel,
        {by_decision},
        count(DISTINCT {_NAMED}) FILTER (newest AND ({_ALONG} OR decision <> 'unconfirmed')) AS noticed,
        max(abs(value_mm)) FILTER (newest AND feature_kind IN ('{RIVET.name}', '{SEAM_STATION.name}')) AS worst_mm,
        count(*) FILTER (state <> '{DECIDED}') AS waiting,
        count(*) FILTER (state = '{OPEN_WORK}') AS open_work
    FROM f GROUP BY ALL
), panels AS (
    SELECT aircraft_serial, panel, sum(features) AS features, count(*) AS scenes,
        count(*) FILTER (rig_verdict = 'unjudged') AS unjudged, {NEWEST_TIME} AS last_scan
    FROM s GROUP BY ALL
)
SELECT aircraft_serial, panel, {_counted("waiting", "open_work", *_COLUMNS.values(), "noticed", "features")},
    worst_mm, scenes, unjudged, last_scan
FROM panels LEFT JOIN per_panel USING (aircraft_serial, panel)
ORDER BY waiting DESC, fail DESC, last_scan DESC, aircraft_serial, panel
"""
    return archive.rows_with_review(sql, selected * 4)


def _counted_as(kind: Kind) -> str:
    """The column of `scenes` that counts a kind's features: seams, not the positions along them."""
    return next((count.column for count in kind.counts if count.of == "names"), kind.counts[0].column)


def _counted(*columns: str) -> str:
    return ", ".join(f"coalesce({name}, 0)::BIGINT AS {name}" for name in columns)


def _totals(context: PageContext, panels: pd.DataFrame) -> None:
    locale = context.locale
    boxes = st.columns([1.3, 0.9, 0.7, 0.7, 0.7, 2.1, 2.9], vertical_alignment="center")
    boxes[0].metric(
        _("Waiting for a person"),
        locale.whole(panels["waiting"].sum()),
        help=_(
            "Rivets, stretches of seams and the like that do not simply pass on the newest scans and have no "
            "disposition, on scans that are not signed off; and open work."
        ),
    )
    boxes[1].metric(
        _("Open work"),
        locale.whole(panels["open_work"].sum()),
        help=_(
            "Rework, repair or re-scan was asked for. It is done when the feature passes on a later scan of its "
            "station, or when a person closes it with a reason."
        ),
    )
    boxes[2].metric(_("Aircraft"), locale.whole(panels["aircraft_serial"].nunique()))
    boxes[3].metric(_("Panels"), locale.whole(len(panels)), help=_("Panels counted on each aircraft."))
    boxes[4].metric(_("Scans"), locale.whole(panels["scenes"].sum()), help=_("The newest scan of each station."))
    boxes[5].metric(_("Last scan"), locale.time(newest_scan(context.archive)))
    with boxes[6]:
        counts = _counts(panels)
        st.html(decision_bar(counts, locale))
        said = " · ".join(f"{decision_words(name)} {locale.whole(count)}" for name, count in counts.items())
        st.markdown(f":small[{said}]")
    if unjudged := int(panels["unjudged"].sum()):
        st.markdown(
            ":orange[:material/help: "
            + _(
                "Scans whose rig could not be judged: {n}. Nobody can vouch for their values, passes included; "
                "scan them again.",
                n=locale.whole(unjudged),
            )
            + "]"
        )


def _counts(panels: pd.DataFrame) -> dict[str, int]:
    """Findings by verdict, a stretch of a seam as one, and the features that have none."""
    counts: dict[str, int] = {decision: int(panels[column].sum()) for decision, column in _COLUMNS.items()}
    return {**counts, "pass": max(0, int(panels["features"].sum()) - int(panels["noticed"].sum()))}


def _waiting(context: PageContext, panels: pd.DataFrame, selection: Selection) -> None:
    shown = panels.head(_MOST_ROWS)
    more, whole = len(panels) - len(shown), context.locale.whole
    st.markdown(
        _("**Where work waits** · select a row to review that panel")
        + (" · " + _("{n} of {all} panels", n=whole(len(shown)), all=whole(len(panels))) if more else "")
    )
    show_table(
        shown,
        {
            "aircraft_serial": _("Aircraft"),
            "panel": _("Panel"),
            "waiting": _("Waiting"),
            "open_work": _("Open work"),
            **({"unjudged": _("Rig not judged")} if shown["unjudged"].any() else {}),
            "fail": DECISION_SIGNS["fail"] + " " + _("Fail"),
            "conditional_fail": DECISION_SIGNS["conditional fail"] + " " + _("Cond. fail"),
            "not_measured": "? " + _("Not measured"),
            "worst_mm": _("Worst, mm"),
            "last_scan": _("Last scan"),
        },
        context.locale,
        key="panels",
        height=430,
        names=list(zip(shown["aircraft_serial"].astype(str), shown["panel"].astype(str), strict=True)),
        picked=_review,
        above=440,
    )
    if panels["waiting"].sum() == 0:
        st.success(
            _("Nothing waits: every finding of these panels has a disposition, and no work is open."),
            icon=":material/check:",
        )
    elif not selection.aircraft and not selection.panels:
        link("review", _("Review what waits, the worst first"), icon=":material/fact_check:")


def _matrix(locale: Locale, panels: pd.DataFrame) -> None:
    aircraft = panels.groupby("aircraft_serial")["last_scan"].max().sort_values(ascending=False)
    fig, shown = panel_matrix(panels, list(aircraft.index), locale)
    note = " · " + _("the newest {n} of {all} aircraft", n=shown, all=len(aircraft)) if shown < len(aircraft) else ""
    st.markdown(_("**Aircraft × panels** · findings waiting, click to review") + note)
    clickable_chart(fig, "matrix", _review, {"displayModeBar": False})


def _review(panel: Sequence[str]) -> None:
    """Open the review of a panel of an aircraft."""
    go("review", aircraft=str(panel[0]), panel=str(panel[1]))
