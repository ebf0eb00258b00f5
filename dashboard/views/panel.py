"""Panel: one panel of one aircraft, put together from its scans: map, verdict, findings, coverage, sign-off."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import streamlit as st
from streamlit.delta_generator import DeltaGenerator

from dashboard.address import one_of
from dashboard.deciding import ask_who, say_outcome
from dashboard.figures.panel import panel_figure
from dashboard.findings import feature_from_parameter, feature_words
from dashboard.frame import PageContext, plain
from dashboard.locale import Locale
from dashboard.panels import (
    PanelView,
    airflows,
    in_scan,
    load_panel,
    locations,
    panel_names,
    stitched_pictures,
    with_courses,
)
from dashboard.picking import clickable_chart
from dashboard.reasons import SEPARATOR
from dashboard.reports import offer_report
from dashboard.scenes import load_scene_rows, worst_feature
from dashboard.seam_course import seam_names
from dashboard.signing import offer_sign_off_of
from dashboard.views.other_scans import show_at_place
from dashboard.views.panel_tables import (
    look_at,
    show_changes,
    show_coverage,
    show_findings,
    show_rework,
    show_rules,
    show_scans,
)
from dashboard.views.rework import show_before_after
from dashboard.views.seam import show_seam
from dashboard.words import N_, _
from metrology.kinds import BY_NAME, KINDS
from metrology.results import PanelKey
from storage.report import panel_report
from storage.review import Entry, Feature
from storage.review_details import PANEL_RELEASED, PANEL_RELEASED_ONE, remarks
from storage.wording import capital

TITLE = N_("Panel")
_NAME_PX = 150
_BADGES = {
    "accepted": ("green", ":material/check:"),
    "accepted with conditions": ("orange", ":material/rule:"),
    "rejected": ("red", ":material/block:"),
    "incomplete": ("gray", ":material/pending:"),
    "no rules": ("gray", ":material/help:"),
}
_PICTURE, _DEVIATION, _PLAIN = N_("Picture"), N_("Deviation map"), N_("Marks only")
_CLOSE_UP, _FINDINGS, _CHANGES, _RULES = N_("Close-up"), N_("Findings"), N_("Changes"), N_("Rules")
_COVERAGE, _SCANS, _SEAM = N_("Coverage"), N_("Scans"), N_("Seam")


def render(context: PageContext) -> None:
    """Show the page."""
    left, middle, beside = st.columns([1, 1, 4], vertical_alignment="bottom")
    aircraft, panel = _choose(context, left, middle)
    view = load_panel(context.archive, aircraft, panel)
    scenes = _newest(context, aircraft, panel)
    say_outcome(context, (aircraft, panel))
    if view is None:
        _not_assembled(context, scenes, aircraft, panel)
        return
    chosen = _chosen(view)
    with beside:
        _headline(context, view, scenes)
    left, right = st.columns([21, 19])
    with left:
        _map(context, view, chosen)
        with st.container(horizontal=True, vertical_alignment="center", gap="small"):
            row = view.row
            _sign(context, scenes, aircraft, panel, f"{row.verdict}: {row.verdict_reason}")
    with right:
        _beside(context, view, scenes, chosen)


def _choose(context: PageContext, left: DeltaGenerator, right: DeltaGenerator) -> tuple[str, str]:
    known = panel_names(context.archive)
    first, second = known.iloc[0][["aircraft_serial", "panel"]]
    aircraft = list(dict.fromkeys(known["aircraft_serial"].astype(str)))
    serial = left.selectbox(
        _("Aircraft"), aircraft, help=_("The feature that is looked at stays when you change it."),
        **one_of("aircraft", aircraft, str(first)),
    )  # fmt: skip
    panels = sorted(known[known["aircraft_serial"] == serial]["panel"].astype(str))
    name = right.selectbox(_("Panel"), panels, **one_of("panel", panels, str(second)))
    return str(serial), str(name)


def _newest(context: PageContext, aircraft: str, panel: str) -> list[Any]:
    rows = context.archive.rows(
        "SELECT scene_id FROM latest_scenes WHERE aircraft_serial = ? AND panel = ? ORDER BY station",
        [aircraft, panel],
    )
    return load_scene_rows(context.archive, [str(name) for name in rows["scene_id"]])


def _not_assembled(context: PageContext, scenes: Sequence[Any], aircraft: str, panel: str) -> None:
    st.info(
        _(
            "The scans of {aircraft} {panel} were not put together yet, so there is no map of the panel. "
            "`flushline panel assemble` does it; it follows each inspection of a panel by itself where a panel has "
            "several stations or a pattern.",
            aircraft=plain(aircraft),
            panel=plain(panel),
        ),
        icon=":material/grid_off:",
    )
    show_scans(context, scenes)
    with st.container(horizontal=True, vertical_alignment="center", gap="small"):
        _report(context, aircraft, panel)
        _sign(context, scenes, aircraft, panel, "not put together")


def _chosen(view: PanelView) -> Feature | None:
    """The feature that the address names, else the gravest."""
    named = feature_from_parameter(st.query_params.get("feature"))
    if named and (view.features[named.kind]["feature_id"] == named.id).any():
        return named
    return worst_feature(view.features)


def _headline(context: PageContext, view: PanelView, scenes: Sequence[Any]) -> None:
    row, locale = view.row, context.locale
    colour, icon = _BADGES.get(str(row.verdict), ("gray", ":material/help:"))
    with st.container(horizontal=True, vertical_alignment="center"):
        st.badge(plain(_(str(row.verdict))), color=colour, icon=icon)  # type: ignore[arg-type]
        st.markdown(f":small[{plain(locale.reason(row.verdict_reason))}]")
        signed = context.archive.review().sign_offs()
        entries = [signed[s.scene_id] for s in scenes if s.scene_id in signed]
        names = {_in_role(entry) for entry in entries}
        if scenes and all(s.scene_id in signed for s in scenes):
            who = plain(", ".join(sorted(names)))
            says = "; ".join(dict.fromkeys(plain(remarks(entry, _, context.locale.reason)) for entry in entries))
            st.badge(_("signed off by {names}", names=who), color="green", icon=":material/lock:", help=says or None)
        elif names:
            count = sum(s.scene_id in signed for s in scenes)
            part = _("{n} of {all} scans signed off", n=count, all=len(scenes))
            st.badge(part, color="gray", icon=":material/lock_open:")
    counted = [
        f"{_(kind.counts[0].column.removeprefix('n_'))}: {locale.whole(_number(view, kind))}"
        for kind in KINDS
        if _number(view, kind)
    ]
    said = [
        _("{n} scans, the newest {time}", n=locale.whole(row.n_scenes), time=locale.time(row.captured_at)),
        ", ".join(counted),
        _("{area} cm² of skin seen", area=locale.whole(row.area_cm2)),
        _covered(row, locale),
    ]
    if isinstance(row.next_station, str):
        said.append(_("scan next: {station}", station=plain(row.next_station)))
    st.caption(" · ".join(said))
    texts = [str(text) for text in (row.warnings if row.warnings is not None else ())]
    if texts:
        with st.container(key="panel-warnings"):  # many scroll: the sign-off below stays on the screen
            st.markdown(f":small[:orange[:material/warning:] {plain(locale.reason(SEPARATOR.join(texts)))}]")


def _in_role(signed: Entry) -> str:
    """Who signed, and as what where the signature says it."""
    return f"{signed.who} ({_(signed.signature.role)})" if signed.signature else signed.who


def _covered(row: Any, locale: Locale) -> str:
    """How much of what there should be was measured."""
    if not (row.n_expected == row.n_expected and row.n_expected):
        return _("expected places: not known")
    missing = [
        f"{locale.whole(n)} {_(words)}"
        for n, words in ((row.n_not_measured, "not measured"), (row.n_not_seen, "not seen"))
        if n == n and n
    ]
    everything = _("all measured")
    places = _("of {n} expected places", n=locale.whole(row.n_expected))
    return f"{places} {', '.join(missing) if missing else everything}"


def _number(view: PanelView, kind: Any) -> int:
    return int(view.features[kind.name][kind.id_columns[0]].nunique())


def _map(context: PageContext, view: PanelView, chosen: Feature | None) -> None:
    number, shown = 1, None
    with st.container(horizontal=True, vertical_alignment="center", gap="small"):
        if len(view.parts) > 1:
            parts = view.parts
            of_chosen = _part_of(view, chosen)
            part = st.segmented_control(_("Part"), parts, format_func=_part_words, label_visibility="collapsed",
                                        **one_of("part", parts, parts[of_chosen - 1]))  # fmt: skip
            number = parts.index(str(part or parts[0])) + 1
            view = view.of_part(number)
        picture = stitched_pictures(context.archive, view).get(number)
        if picture is not None:
            grounds = [_PICTURE, _DEVIATION, _PLAIN]
            shown = st.segmented_control(
                _("Ground"), grounds, format_func=_, label_visibility="collapsed", **one_of("map", grounds)
            )
            picture = None if shown == _PLAIN else picture
        _report(context, str(view.row.aircraft_serial), str(view.row.panel))
    view = with_courses(context.archive, view)
    fig = panel_figure(view, chosen, context.locale, picture, shown == _DEVIATION, airflows(context.archive, view))
    clickable_chart(fig, "panel-map", look_at, {"scrollZoom": True, "displaylogo": False}, above=560)
    st.caption(_("In the panel's own frame. Click a feature for its close-up; scroll to zoom, drag to move."))


def _part_words(part: str) -> str:
    """A part as people call it; the address has its English name."""
    number, __, stations = part.removeprefix("part ").partition(" ")
    return _("part {number} {stations}", number=number, stations=stations)


def _part_of(view: PanelView, chosen: Feature | None) -> int:
    if chosen is None:
        return 1
    rows = view.features[chosen.kind]
    found = rows[rows["feature_id"] == chosen.id]["part"].dropna()
    return int(found.iloc[0]) if len(found) else 1


def _report(context: PageContext, aircraft: str, panel: str) -> None:
    store, key = context.archive.store, PanelKey(aircraft, panel)
    offer_report(f"{aircraft}~{panel}", context.locale, lambda words: panel_report(store, key, wording=words))


def _sign(context: PageContext, scenes: Sequence[Any], aircraft: str, panel: str, verdict: str) -> None:
    if all(s.scene_id in context.archive.review().sign_offs() for s in scenes):
        return
    ask_who(context, _NAME_PX)
    name = f"{aircraft} {panel}"
    released = PANEL_RELEASED_ONE if len(scenes) == 1 else PANEL_RELEASED
    meaning = released.format(panel=name, n=len(scenes), verdict=verdict)
    offer_sign_off_of(context, scenes, _("panel {name}", name=plain(name)), meaning)


def _beside(context: PageContext, view: PanelView, scenes: Sequence[Any], chosen: Feature | None) -> None:
    seams = seam_names(view)
    names = [_CLOSE_UP, *([_SEAM] if seams else []), _FINDINGS, _CHANGES, _RULES, _COVERAGE, _SCANS]
    shown = st.segmented_control(_("View"), names, format_func=_, label_visibility="collapsed", **one_of("view", names))
    if shown == _FINDINGS:
        show_findings(context, view)
    elif shown == _CHANGES:
        show_changes(context, view)
        show_rework(context, view)
    elif shown == _RULES:
        show_rules(context, view)
    elif shown == _COVERAGE:
        show_coverage(context, view)
    elif shown == _SCANS:
        show_scans(context, scenes)
    elif shown == _SEAM and seams:
        show_seam(context, view, seams, chosen)
    elif chosen is None:
        st.info(_("Nothing was found on this panel."))
    else:
        _feature(context, view, chosen)


def _feature(context: PageContext, view: PanelView, chosen: Feature) -> None:
    """The close-up of the scan that measured it best, and of others of its place."""
    found = in_scan(context.archive, view, chosen)
    kind = BY_NAME[chosen.kind]
    location = locations(context.archive, view).get(chosen.id.split("@")[0] if kind.is_course else chosen.id)
    where = f" · {plain(location)}" if location else ""
    name = f"**{capital(_(kind.subject))} {plain(feature_words(chosen.id, context.locale))}**"
    st.markdown(_("{name} of the panel", name=name) + where)
    show_before_after(context, view, chosen)
    if found is None:
        st.info(_("No scan in the panel has this feature at this place."))
        return
    show_at_place(context, found)
