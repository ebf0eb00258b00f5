"""Trends: is the process steady, and can it hold its limits?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import streamlit as st

from dashboard.address import one_of, put
from dashboard.figures.trends import control_figure, histogram, layout_figure, pareto_figure
from dashboard.filters import names, newest_scan
from dashboard.findings import PERIODS, Selection, start_of
from dashboard.frame import PageContext, go, plain
from dashboard.locale import Locale
from dashboard.palette import quantity_words
from dashboard.picking import clickable_chart
from dashboard.room import show_chart
from dashboard.standard import has_capability, standard_of
from dashboard.trends import (
    BY_SUBJECT,
    FASTENER_TYPE,
    PARETO,
    QUANTITIES,
    SUBJECTS,
    Quantity,
    Subject,
    capability_of,
    events,
    layout,
    limit_groups,
    options,
    outside_by,
    series,
    spread,
)
from dashboard.views.first_pass import show_first_pass
from dashboard.words import N_, _
from metrology.statistics import (
    NELSON_RULES,
    WESTERN_ELECTRIC_RULES,
    Capability,
    Index,
    RunRule,
    individuals_chart,
    pareto,
    rule_violations,
)
from metrology.tolerance import Limit
from storage.wording import capital

TITLE = N_("Trends")
_RULES = {"Nelson": NELSON_RULES, "Western Electric": WESTERN_ELECTRIC_RULES}
_VIEWS = (N_("Control chart and capability"), N_("Pareto of panels"), N_("Map of the panel"), N_("First-pass yield"))
# Points from which control limits are usually taken as settled (Montgomery, Statistical Quality Control).
_SETTLED = 20
CAUSES = (
    N_("wrong fastener"), N_("perhaps a wrong fastener"), N_("missing fastener"), N_("missing"),
    N_("temporary fastener"), N_("open hole"), N_("filled hole"), N_("lap joint"), N_("dent"), N_("bump"),
    N_("scratch"), N_("something lies on the skin"),
)  # fmt: skip
"""What reasons of findings begin with, beside quantities."""
_MEASURES = {N_("mean value"): "mean", N_("share outside"): "outside"}


def render(context: PageContext) -> None:
    """Show the page."""
    view = st.segmented_control(
        _("View"),
        _VIEWS,
        format_func=lambda name: _("Pareto") if name == _VIEWS[1] else _(name),
        label_visibility="collapsed",
        **one_of("view", _VIEWS),
    )
    boxes = st.columns([1.2, 1.2, 1, 1.2, 1.2, 1.2, 1.2])
    # Fields stand only where they change what is shown: these two are of all panels and all that was measured.
    if view == _VIEWS[1]:
        _pareto(context, replace(_period(context, boxes[0]), without=context.settings.not_aircraft))
        return
    if view == _VIEWS[3]:
        show_first_pass(context, _period(context, boxes[0]).since)
        return
    of_map = view == _VIEWS[2]
    subject, quantity = _choose(context, boxes, of_map)
    selection = _period(context, boxes[5])
    if of_map:
        _map(context, subject, quantity, selection)
        return
    rules = boxes[6].selectbox(_("Run rules"), list(_RULES), **one_of("rules", list(_RULES)))
    if subject is None:
        st.info(_("There is nothing of this kind on that panel and station."))
    else:
        _control(context, subject, quantity, selection, rules)


def _period(context: PageContext, box: Any) -> Selection:
    period = box.selectbox(_("Scanned"), list(PERIODS), format_func=_, **one_of("period", list(PERIODS)))
    return Selection(since=start_of(period, newest_scan(context.archive)))


def _choose(context: PageContext, boxes: Sequence[Any], of_map: bool) -> tuple[Subject | None, Quantity]:
    """What is followed, and its quantity; a map is of a whole panel, whatever is followed on it."""
    archive = context.archive
    kind = boxes[0].selectbox(_("Trend of"), list(SUBJECTS), format_func=_, **one_of("what", list(SUBJECTS)))
    panel = station = name = ""
    if kind != FASTENER_TYPE:
        panels = names(archive, "panel")
        panel = boxes[1].selectbox(_("Panel"), panels, **one_of("panel", panels)) or ""
    if kind in BY_SUBJECT and not of_map:
        within = Selection(panels=(panel,))
        stations = names(archive, "station", within)
        station = boxes[2].selectbox(_("Station"), stations, **one_of("station", stations)) or ""
    if kind != "panel" and not of_map:
        title = _("Head Ø, mm") if kind == FASTENER_TYPE else capital(_(kind))
        known = options(archive, kind, panel, station)
        name = boxes[3].selectbox(title, known, **one_of("name", known)) or "" if known else ""
    quantity = boxes[4].selectbox(
        _("Quantity"), SUBJECTS[kind], format_func=quantity_words, **one_of("quantity", SUBJECTS[kind])
    )
    subject = Subject(kind, panel, station, name) if kind == "panel" or name or of_map else None
    return subject, QUANTITIES[quantity]


def _control(
    context: PageContext,
    subject: Subject,
    quantity: Quantity,
    selection: Selection,
    rules: str,
) -> None:
    groups = limit_groups(context.archive, subject, quantity, selection)
    standard = standard_of(groups)
    limit = standard.limit
    rows = series(context.archive, subject, quantity, selection, standard)
    rows = rows[rows["n"] > 0].reset_index(drop=True)
    if rows.empty:
        st.info(_("Nothing was measured here in that time. Choose a longer one, or another feature."))
        return
    chart = individuals_chart(rows["value"].to_numpy(float))
    tests = _RULES[rules]
    violations = rule_violations(chart, tests)
    values = spread(context.archive, subject, quantity, selection, standard)
    shown = quantity.against(standard)
    if standard.note:
        st.caption(context.locale.reason(standard.note))
    left, right = st.columns([7, 4])
    # The numbers come first: they are there while the figures are still being drawn.
    with right:
        distribution = st.container()
        if values is None:
            st.info(_("A distribution needs at least two values."))
        else:
            judged = limit if has_capability(groups) else None
            _capability(capability_of(subject, rows, values, judged), subject, judged, context.locale)
    with left:
        fig = control_figure(rows, chart, violations, shown, limit, events(rows), context.locale)
        clickable_chart(fig, "control", lambda scene: go("scene", scene=scene), {"displaylogo": False}, above=345)
        each = (
            _("the mean over one scan of each station of an aircraft")
            if subject.kind in ("panel", FASTENER_TYPE)
            else _("one scan")
        )
        st.caption(_("Each point is {each}; click one to open the scan. Dashed: tolerance limits.", each=each))
        _rules(rules, tests, violations, len(rows))
    if values is not None:
        distribution.plotly_chart(
            histogram(values, shown, limit, context.locale), key="histogram", config={"displaylogo": False}
        )


def _rules(title: str, tests: tuple[RunRule, ...], violations: dict[str, Any], n: int) -> None:
    if not violations:
        if n < _SETTLED:
            st.markdown(
                ":gray[○] "
                + _(
                    "No point breaks a {rules} rule, but control limits from {n} points say little yet; "
                    "{settled} are needed.",
                    rules=title,
                    n=n,
                    settled=_SETTLED,
                )
            )
            return
        st.markdown(":green[●] " + _("Steady: no point breaks a {rules} rule ({n} points).", rules=title, n=n))
        return
    said = "; ".join(
        f"**{t.name}** {_(t.meaning)} (" + _("points: {n}", n=len(violations[t.name])) + ")"
        for t in tests
        if t.name in violations
    )
    st.markdown(":red[▲] " + _("Not steady by {rules} rules: {broken}.", rules=title, broken=said))


def _capability(found: Capability | None, subject: Subject, limit: Limit | None, locale: Locale) -> None:
    if found is None:
        st.caption(_("Without a limit that holds for all of these values nothing says how capable the process is."))
        return
    boxes = st.columns(4)
    for box, (name, index) in zip(
        boxes, (("Cp", found.cp), ("Cpk", found.cpk), ("Pp", found.pp), ("Ppk", found.ppk)), strict=True
    ):
        box.metric(name, locale.number(index.value, 2) if index else "–")
        box.caption(_interval(index, locale))
    if subject.averaged:
        st.caption(_("Cp and Cpk use the spread within a point of the chart, Pp and Ppk that of all values."))
    elif found.cp is None and limit is not None and (limit.lower is None or limit.upper is None):
        st.caption(_("Cp and Pp need both limits."))
    st.caption(
        _(
            "{n} values, mean {mean}, standard deviation {sigma}; {outside} expected outside the limits {limits}. "
            "Below each number: where it lies in 95 of 100 cases.",
            n=locale.whole(found.n),
            mean=locale.number(found.mean, sign=True),
            sigma=locale.number(found.sigma_overall, 4),
            outside=locale.percent(found.outside_fraction, 2),
            limits=_limits(limit, locale),
        )
    )


def _limits(limit: Limit | None, locale: Locale) -> str:
    if limit is None:
        return "–"
    low = "−∞" if limit.lower is None else locale.number(limit.lower, sign=True)
    high = "+∞" if limit.upper is None else locale.number(limit.upper, sign=True)
    origin = " ".join(part for part in (limit.source, limit.revision) if part)
    return f"{low} … {high}" + (f" ({plain(origin)})" if origin else "")


def _interval(index: Index | None, locale: Locale) -> str:
    return f"{locale.number(index.low, 2)} … {locale.number(index.high, 2)}" if index else "–"


def _pareto(context: PageContext, selection: Selection) -> None:
    by = st.segmented_control(_("Findings by"), list(PARETO), format_func=_, **one_of("by", list(PARETO)))
    by = str(by or next(iter(PARETO)))
    counts = outside_by(context.archive, selection, by)
    named: Counter[str] = Counter()
    for name, n in counts.items():
        named[_named(by, name)] += n
    bars = pareto(named)
    if not bars:
        st.success(_("No finding of the newest scans is outside its limits."))
        return
    show_chart(pareto_figure(bars, context.locale, 380), "pareto", above=440)
    st.caption(
        _(
            "Findings outside their limits on the newest scan of every station, all aircraft together; a stretch of a "
            "seam is one."
        )
    )


def _named(by: str, name: str) -> str:
    """What a bar of the Pareto chart stands for."""
    if not name:
        return _("not stated")
    if by != "cause":
        return name
    cause = name.split(" without ")[0].split(" for a ")[0].removesuffix(" of")
    return quantity_words(next((known for known in QUANTITIES if cause.startswith(known)), cause))


def _follow(panel: str, subject: str, place: list[str]) -> None:
    """The control chart of a place that was clicked on the map."""
    station, name = place
    put(what=subject, panel=panel, station=station, name=name, view=None)


def _map(context: PageContext, subject: Subject | None, quantity: Quantity, selection: Selection) -> None:
    if subject is None or not subject.panel:
        st.info(_("Choose a rivet, a seam or a panel to see its map."))
        return
    measure = st.segmented_control(_("Colour"), list(_MEASURES), format_func=_, **one_of("measure", list(_MEASURES)))
    standard = standard_of(limit_groups(context.archive, Subject("panel", subject.panel), quantity, selection))
    rows = layout(context.archive, subject.panel, quantity, selection, standard)
    if rows.empty:
        st.info(_("Nothing was measured on this panel in that time."))
        return
    fig = layout_figure(rows, _MEASURES.get(str(measure), "mean"), quantity.against(standard), context.locale)
    clickable_chart(fig, "layout", partial(_follow, subject.panel, quantity.kind.subject), {"displaylogo": False}, 385)
    frame = (
        _("in the panel's frame")
        if rows.attrs.get("registered")
        else _("as each station's picture shows them, side by side")
    )
    st.caption(
        _(
            "{quantity} of panel {panel}, over all aircraft; places {frame}.",
            quantity=_(quantity.title),
            panel=plain(subject.panel),
            frame=frame,
        )
    )
    if standard.relative:
        st.caption(context.locale.reason(standard.note))
