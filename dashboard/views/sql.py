"""SQL: questions to the archive that no page answers, read-only."""

from __future__ import annotations

import pandas as pd
import streamlit as st
from streamlit.delta_generator import DeltaGenerator

from dashboard.address import one_of, put
from dashboard.figures.answer import answer_figure
from dashboard.frame import PageContext, plain, told
from dashboard.meanings import meaning
from dashboard.questions import MORE, QUESTIONS
from dashboard.review_report import csv_report
from dashboard.room import room, show_chart
from dashboard.sql_runner import AT_ONCE, MOST_ROWS, MOST_SECONDS, run_query
from dashboard.suggestions import suggest_names
from dashboard.tables import fitting
from dashboard.words import N_, _
from metrology.errors import FlushlineError, UsageError
from storage.archive.beside import TABLES_BESIDE
from storage.archive.schema import TABLES
from storage.archive.views import VIEWS
from storage.saved_queries import SavedQueries
from storage.templates import rendered

TITLE = N_("SQL")
_EXAMPLES = {**QUESTIONS, **MORE}
_MOST_KEPT = 20
_LONGEST_LINK = 4000
_ANY_HEIGHT = 10_000
_TEXT, _NAME, _ANSWER, _HISTORY = "sql_text", "sql_of", "answer", "sql_history"  # kept while one looks at other pages
_RUN = "sql_run"


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
        st.warning(told(problem), icon=":material/warning:")
        return {}


def _ask(context: PageContext, known: dict[str, str], names: dict[str, str], saved: SavedQueries) -> None:
    _questions()
    kept = st.session_state.get(_NAME)
    name = st.selectbox(
        _("Examples and saved queries"), list(known), format_func=_, **one_of("query", list(known), kept)
    )
    sql = _text(known, str(name))
    with st.container(horizontal=True, vertical_alignment="bottom"):
        if st.button(_("Run"), type="primary", icon=":material/play_arrow:", shortcut="Ctrl+Enter"):
            st.session_state[_RUN] = True
        if st.session_state.get(_RUN) and sql.strip():
            _remember(sql)
        _keep(context, names, saved, str(name), sql)
        _history()
        st.caption(
            _(
                "at most {rows} rows and {seconds} s; the address of this page holds the query: pass it on",
                rows=context.locale.whole(MOST_ROWS),
                seconds=context.locale.number(MOST_SECONDS, 0),
            )
        )
    if st.session_state.get(_RUN):  # also where the page was drawn anew before the answer had come
        _run(context, sql)
    _show(context)


def _questions() -> None:
    """A button for each of the questions asked most, which answers it."""
    with st.container(horizontal=True, gap="small", key="questions"):
        for question in QUESTIONS:
            st.button(
                _(question), key=f"question-{question}", on_click=_take_over, args=(question, QUESTIONS[question])
            )


def _take_over(name: str | None, sql: str) -> None:
    """Put a query into the field and run it."""
    st.session_state[_TEXT], st.session_state[_RUN] = sql, True
    if name:
        st.session_state[_NAME] = name
        put(query=name, sql=None)
    else:
        put(sql=sql[:_LONGEST_LINK])


def _text(known: dict[str, str], name: str) -> str:
    """The query's field: what the address holds, what was chosen, or what was typed before."""
    held = st.query_params.get("sql")
    opened = _NAME not in st.session_state
    if st.session_state.get(_NAME) != name:
        st.session_state[_NAME] = name
        st.session_state[_TEXT] = held or known.get(name, "")
        # Who follows a link to a query that has a name asks it; choosing another one here does not.
        st.session_state[_RUN] = opened and not held and st.query_params.get("query") == name
    elif held and _TEXT not in st.session_state:
        st.session_state[_TEXT] = held
    st.session_state["sql"] = st.session_state.get(_TEXT, "")
    sql = st.text_area(
        _("Query"), key="sql", height=130, on_change=_typed, args=(known.get(name, ""),),
        help=_("DuckDB SQL. Ctrl+Enter takes the text over; it cannot change anything."),
    )  # fmt: skip
    suggest_names(_columns())
    return str(sql or "")


def _columns() -> dict[str, list[str]]:
    """Of each table, and of the views."""
    columns = {table.name: [column.name for column in table.columns] for table in (*TABLES, *TABLES_BESIDE)}
    return columns | {view.name: [] for view in VIEWS}


def _typed(example: str) -> None:
    sql = str(st.session_state.get("sql") or "")
    st.session_state[_TEXT] = sql
    put(sql=sql if sql != example and len(sql) <= _LONGEST_LINK else None)


def _run(context: PageContext, sql: str) -> None:
    st.session_state[_ANSWER] = None
    try:
        queue = st.empty()
        with st.spinner(_("Asking the archive …")):
            st.session_state[_ANSWER] = run_query(context.archive.root, sql, on_wait=lambda: _say_waiting(queue))
        queue.empty()
    except FlushlineError as problem:
        st.session_state[_RUN] = False
        st.error(told(problem), icon=":material/error:")
        return
    st.session_state[_RUN] = False


def _remember(sql: str) -> None:
    """Keep what is asked, also what turns out to be wrong: it can be taken up and mended."""
    asked = [sql, *(earlier for earlier in st.session_state.get(_HISTORY, []) if earlier != sql)]
    st.session_state[_HISTORY] = asked[:_MOST_KEPT]


def _history() -> None:
    """What was asked in this session, the last first."""
    asked: list[str] = st.session_state.get(_HISTORY, [])
    with st.popover(_("History"), icon=":material/history:", disabled=not asked):
        for number, sql in enumerate(asked):
            line = " ".join(sql.split())
            short = line if len(line) <= 70 else f"{line[:70]}…"
            st.button(plain(short), key=f"asked-{number}-{hash(sql)}", on_click=_take_over, args=(None, sql),
                      type="tertiary")  # fmt: skip


def _show(context: PageContext) -> None:
    answer = st.session_state.get(_ANSWER)
    if answer is None:
        return
    n = context.locale.whole(len(answer.rows))
    said = _("1 row") if len(answer.rows) == 1 else _("{n} rows", n=n)
    if answer.truncated:
        said = _("more than {n} rows, the first {n} shown", n=n)
    with st.container(horizontal=True, vertical_alignment="center"):
        st.caption(said)
        numbers = [name for name in answer.rows.columns if pd.api.types.is_numeric_dtype(answer.rows[name])]
        chart = bool(numbers) and st.toggle(_("Chart"), key="sql_chart")
        st.download_button(
            _("Download CSV"),
            lambda: csv_report(answer.rows, context.locale),
            "query.csv",
            "text/csv",
            on_click="ignore",
            icon=":material/download:",
        )
    if chart:
        _chart(context, answer.rows, numbers)
    else:
        least, most = (fitting(height, len(answer.rows)) for height in (330, _ANY_HEIGHT))
        with room("answer", least, most, above=550):
            st.dataframe(answer.rows, hide_index=True, height="stretch")


def _chart(context: PageContext, rows: pd.DataFrame, numbers: list[str]) -> None:
    """A number of the answer for each of its rows: bars by a name, else a line by a number or a time."""
    left, right = st.columns(2)
    x = left.selectbox(_("Along"), list(rows.columns), key="sql_x")
    y = right.selectbox(_("Number"), numbers, index=len(numbers) - 1, key="sql_y")
    show_chart(answer_figure(rows, str(x), str(y), context.locale), "sql-figure", above=640)


def _say_waiting(place: DeltaGenerator) -> None:
    place.caption(_("{n} queries of others are running; this one starts when one of them ends.", n=AT_ONCE))


def _keep(context: PageContext, names: dict[str, str], saved: SavedQueries, chosen: str, sql: str) -> None:
    """Save this query for everyone, or forget a saved one (`names`: what is shown, and the name it is kept by)."""
    if not context.person.may_review:
        return
    with st.popover(_("Save"), icon=":material/bookmark:"):
        name = st.text_input(_("Name"), key="query_name", max_chars=80)
        try:
            if st.button(_("Save this query"), disabled=not (name or "").strip() or not sql.strip()):
                if str(name).strip() in _EXAMPLES:
                    raise UsageError(f"queries: found the name of an example, {str(name).strip()!r}, expected another")
                saved.save(str(name), sql)
                st.rerun()
            if chosen in names and st.button(_("Forget {name}", name=plain(chosen))):
                saved.save(names[chosen], None)
                st.rerun()
        except FlushlineError as problem:
            st.error(told(problem))


def _describe_tables() -> None:
    """What there is to ask of: plain HTML, for hundreds of columns of Markdown take a browser most of a second."""
    st.markdown(_("**Tables and views**"))
    tables = [
        {"name": table.name, "meaning": meaning(table.comment), "columns": [
            (column.name, column.sql_type, meaning(column.comment)) for column in table.columns
        ]}
        for table in (*TABLES, *TABLES_BESIDE)
    ]  # fmt: skip
    tables += [{"name": view.name, "meaning": meaning(view.comment), "columns": []} for view in VIEWS]
    with st.container(border=False, key="tables"):  # as high as the screen, see the style of the pages
        st.html(rendered("dashboard", "tables.html", tables=tables))
