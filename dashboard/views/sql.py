"""SQL: questions to the archive that no page answers, read-only."""

from __future__ import annotations

import streamlit as st
from streamlit.delta_generator import DeltaGenerator

from dashboard.address import one_of
from dashboard.frame import PageContext, plain
from dashboard.review_report import csv_report
from dashboard.sql_runner import AT_ONCE, MOST_ROWS, MOST_SECONDS, run_query
from metrology.errors import FlushlineError, UsageError
from storage.archive.decision_tables import DECISIONS_COLUMNS, DISPOSITIONS_COLUMNS
from storage.archive.schema import TABLES
from storage.archive.views import VIEWS
from storage.evidence.rig_tables import RIGS_COLUMNS, VERIFICATIONS_COLUMNS
from storage.saved_queries import SavedQueries

TITLE = "SQL"
_EXAMPLES = {
    "Worst rivets of the newest scans": "SELECT * FROM worst_rivets LIMIT 100",
    "How each panel stands": "SELECT * FROM panel_summary\n"
    "ORDER BY n_rivets_failing + n_seam_stations_failing DESC\nLIMIT 200",
    "Steps of each seam": "SELECT * FROM seam_summary ORDER BY step_abs_p95_mm DESC LIMIT 200",
    "What could not be measured, and why": "SELECT reason, count(*) AS n\nFROM rivets WHERE decision = 'not measured'\n"
    "GROUP BY reason ORDER BY n DESC",
    "Rivets that people let pass": "SELECT r.*, d.who, d.comment\nFROM rivets r JOIN dispositions d\n"
    "ON r.scene_id = d.scene_id AND r.rivet_id = d.feature_id\nWHERE d.disposition = 'use as is'",
    "Open work": "SELECT scene_id, feature_id, disposition, who, decided_at\nFROM dispositions "
    "WHERE open_work ORDER BY decided_at",
    "Seconds per scene and rig": "SELECT rig_id, count(*) AS scenes, median(seconds_total) AS seconds\n"
    "FROM scenes GROUP BY rig_id ORDER BY scenes DESC",
}


def render(context: PageContext) -> None:
    """Show the page."""
    saved = SavedQueries(context.archive.root)
    kept = _saved(saved)
    # An older version let a saved query take an example's name: both are there, and that one can be forgotten.
    names = {(f"{name} (saved)" if name in _EXAMPLES else name): name for name in kept}
    known = {**_EXAMPLES, **{shown: kept[name] for shown, name in names.items()}}
    left, right = st.columns([9, 4])
    with right:
        _describe_tables()
    with left:
        _ask(context, known, names, saved)


def _saved(saved: SavedQueries) -> dict[str, str]:
    try:
        return saved.read()
    except FlushlineError as problem:
        st.warning(plain(problem), icon=":material/warning:")
        return {}


def _ask(context: PageContext, known: dict[str, str], names: dict[str, str], saved: SavedQueries) -> None:
    name = st.selectbox("Examples and saved queries", list(known), **one_of("query", list(known)))
    if st.session_state.get("sql_of") != name:
        st.session_state["sql_of"], st.session_state["sql"] = name, known.get(str(name), "")
    sql = st.text_area(
        "Query", key="sql", height=150, help="DuckDB SQL. Ctrl+Enter takes the text over; it can not change anything."
    )
    with st.container(horizontal=True, vertical_alignment="bottom"):
        run = st.button("Run", type="primary", icon=":material/play_arrow:", shortcut="Ctrl+Enter")
        _keep(context, names, saved, str(name), sql)
        st.caption(f"at most {context.locale.whole(MOST_ROWS)} rows and {MOST_SECONDS:g} s")
    if run:
        st.session_state["answer"] = None
        try:
            queue = st.empty()
            with st.spinner("Asking the archive …"):
                st.session_state["answer"] = run_query(context.archive.root, sql, on_wait=lambda: _say_waiting(queue))
            queue.empty()
        except FlushlineError as problem:
            st.error(plain(problem), icon=":material/error:")
    answer = st.session_state.get("answer")
    if answer is not None:
        note = f", the first {context.locale.whole(len(answer.rows))} shown" if answer.truncated else ""
        st.caption(f"{'more than ' if answer.truncated else ''}{context.locale.whole(len(answer.rows))} rows{note}")
        st.dataframe(answer.rows, hide_index=True, height=330)
        st.download_button(
            "Download CSV",
            lambda: csv_report(answer.rows, context.locale),
            "query.csv",
            "text/csv",
            on_click="ignore",
            icon=":material/download:",
        )


def _say_waiting(place: DeltaGenerator) -> None:
    place.caption(f"{AT_ONCE} queries of others are running; this one starts when one of them ends.")


def _keep(context: PageContext, names: dict[str, str], saved: SavedQueries, chosen: str, sql: str) -> None:
    """Save this query for everyone, or forget a saved one (`names`: what is shown, and the name it is kept by)."""
    if not context.person.may_review:
        return
    with st.popover("Save", icon=":material/bookmark:"):
        name = st.text_input("Name", key="query_name", max_chars=80)
        try:
            if st.button("Save this query", disabled=not (name or "").strip() or not sql.strip()):
                if str(name).strip() in _EXAMPLES:
                    raise UsageError(f"queries: found the name of an example, {str(name).strip()!r}, expected another")
                saved.save(str(name), sql)
                st.rerun()
            if chosen in names and st.button(f"Forget {plain(chosen)}"):
                saved.save(names[chosen], None)
                st.rerun()
        except FlushlineError as problem:
            st.error(plain(problem))


def _describe_tables() -> None:
    st.markdown("**Tables and views**")
    with st.container(height=560, border=False):
        for table in TABLES:
            with st.expander(f"`{table.name}`"):
                st.caption(plain(table.comment))
                _columns([(c.name, c.sql_type, c.comment) for c in table.columns])
        for name, what, columns in (
            ("decisions", "Everything that people decided, from the first entry on", DECISIONS_COLUMNS),
            ("dispositions", "The last disposition of each feature that has one", DISPOSITIONS_COLUMNS),
            ("rigs", "Each calibration with its last verification, and what is due when", RIGS_COLUMNS),
            ("verifications", "Each measure of each verification of a rig", VERIFICATIONS_COLUMNS),
        ):
            with st.expander(f"`{name}`"):
                st.caption(what)
                _columns([(column, "", comment) for column, comment in columns.items()])
        for view in VIEWS:
            with st.expander(f"`{view.name}`"):
                st.caption(plain(view.comment))


def _columns(columns: list[tuple[str, str, str]]) -> None:
    st.markdown("\n".join(f"- `{name}` :gray[:small[{kind}]] {plain(comment)}" for name, kind, comment in columns))
