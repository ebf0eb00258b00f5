"""First-pass yield, as the trends page shows it."""

from __future__ import annotations

from datetime import datetime

import pandas as pd
import streamlit as st

from dashboard.address import one_of
from dashboard.figures.trends import yield_figure
from dashboard.first_pass import YIELD_BY, Yield, first_pass
from dashboard.frame import PageContext
from dashboard.locale import Locale
from dashboard.room import show_chart
from dashboard.tables import show_table
from dashboard.words import _
from storage.wording import capital


def show_first_pass(context: PageContext, since: datetime | None) -> None:
    """Yield by panel, aircraft or period, of panels first scanned since then."""
    by = st.segmented_control(_("Yield by"), list(YIELD_BY), format_func=_, **one_of("yield", list(YIELD_BY)))
    by = str(by or next(iter(YIELD_BY)))
    yields = first_pass(context.archive, by, since, context.settings.not_aircraft)
    if not yields:
        st.info(_("No panel was scanned for the first time in that time. Choose a longer one."))
        return
    left, right = st.columns([3, 2])
    with left:
        show_chart(yield_figure(yields, context.locale, 340), "yield-chart", above=440)
    with right:
        _table(yields, by, context.locale)
    st.caption(
        _(
            "Panels of aircraft by the first scan of each of their stations. Passed: nothing is outside its limits and "
            "everything was judged. Undecided: something was not measured, is unconfirmed or missing, or the rig could "
            "not be judged; that is not counted as passed. Lines on the bars: where the yield lies in 95 of 100 cases."
        )
    )


def _table(yields: list[Yield], by: str, locale: Locale) -> None:
    worst_first = sorted(yields, key=lambda one: one.share) if by in list(YIELD_BY)[:2] else yields
    rows = pd.DataFrame(
        {
            "name": [one.name for one in worst_first],
            "n_panels": [one.n for one in worst_first],
            "n_passed": [one.passed for one in worst_first],
            "n_failed": [one.failed for one in worst_first],
            "n_undecided": [one.undecided for one in worst_first],
            "share": [locale.percent(one.share) for one in worst_first],
        }
    )
    columns = {
        "name": capital(_(by)),
        "n_panels": _("Panels"),
        "n_passed": _("Passed"),
        "n_failed": _("Failed"),
        "n_undecided": _("Undecided"),
        "share": _("Yield"),
    }
    show_table(rows, columns, locale, key="yields", height=340, above=440)
