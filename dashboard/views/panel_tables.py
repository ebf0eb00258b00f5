"""Panel: its tables of findings, changes, rework, rules, coverage and scans."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pandas as pd
import streamlit as st

from dashboard.address import put
from dashboard.findings import feature_parameter, standings_words
from dashboard.frame import PageContext, go
from dashboard.panel_changes import changes_since, earlier_nights, rework_of
from dashboard.panels import PanelView, of_finding
from dashboard.reasons import SEPARATOR
from dashboard.tables import show_table
from dashboard.words import _
from metrology.verdicts import gravity
from storage.archive.changes import CURED
from storage.review import Feature
from storage.review_details import Numbers


def look_at(feature: str) -> None:
    """Choose a feature, on all of the panel."""
    put(feature=feature, view=None, part=None)


def show_findings(context: PageContext, view: PanelView) -> None:
    """What is beyond limits or doubtful, the gravest first."""
    rows = view.findings.rename(columns={"value": "value_mm", "value_u95": "u95_mm"})
    rows = rows.sort_values(["decision", "severity"], key=_gravest_first, kind="stable")
    if rows.empty:
        st.success(_("Every feature of the panel is within its limits."), icon=":material/check:")
        return
    names = [feature_parameter(of_finding(view, row)) for row in rows.itertuples()]
    columns = {
        "feature_id": _("Feature"), "quantity": _("Quantity"), "value_mm": _("Worst"), "u95_mm": _("± U95"),
        "length_mm": _("Length, mm"), "decision": _("Verdict"), "reason": _("Why"),
    }  # fmt: skip
    at = st.query_params.get("feature")
    show_table(rows, columns, context.locale, "panel-findings", 470, names, look_at, at, above=330)
    st.caption(_("A stretch of a seam is one finding. Select one to see its worst place."))


def _gravest_first(column: pd.Series) -> pd.Series:
    return column.map(gravity) if column.name == "decision" else column != "red"


def show_changes(context: PageContext, view: PanelView) -> None:
    """What changed since one of the nights before."""
    nights = {run: context.locale.time(at) for run, at in earlier_nights(context.archive, view).items()}
    if not nights:
        st.info(_("This is the first assembly of the panel: there is no other to compare it with."))
        return
    names = list(nights)
    since = names[-1]
    if len(names) > 1:
        since = st.select_slider(_("Since"), names, names[-1], format_func=nights.__getitem__, key=f"since-{names[-1]}")
    else:
        st.caption(_("since {time}", time=nights[since]))
    rows = changes_since(context.archive, view, since)
    if rows.empty:
        st.success(_("Neither then nor now is anything beyond its limits."), icon=":material/check:")
        return
    columns = {
        "change": _("Change"), "feature_id": _("Feature"), "value_mm": _("Now"), "before_mm": _("Then"),
        "difference_mm": _("Difference"), "difference_u95_mm": _("± U95"), "decision": _("Verdict"), "reason": _("Why"),
    }  # fmt: skip
    keys = [feature_parameter(of_finding(view, row)) for row in rows.itertuples()]
    # The same word as in the morning: there is nothing to find any more.
    rows["change"] = rows["change"].replace("gone", CURED)
    show_table(rows, columns, context.locale, "panel-changes", 330, keys, look_at, st.query_params.get("feature"))
    st.caption(
        _(
            "Both nights judged by today's limits. Worse and better: by more than the U95 of the difference. New: in "
            "order then, or not seen. Select one to look at it."
        )
    )


def show_rework(context: PageContext, view: PanelView) -> None:
    """What was to be done, and what became of it."""
    rows = rework_of(context.archive, view)
    if rows.empty:
        return
    st.markdown("**" + _("Rework, repair and re-scan") + "**")
    rows["feature"] = rows["panel_feature"].fillna(rows["name"])
    columns = {"feature": _("Feature"), "disposition": _("Decided"), "who": _("By"), "decided_at": _("When"),
               "state": _("Outcome"), "comment": _("Comment"), "concession": _("Concession or NCR number"),
               "part_number": _("Part number"), "work_order": _("Work order")}  # fmt: skip
    # Where nobody gives such numbers, no empty columns.
    columns = {
        name: title for name, title in columns.items() if name not in Numbers.model_fields or rows[name].notna().any()
    }
    keys = [
        feature_parameter(Feature(kind, str(name)))
        for kind, name in zip(rows["feature_kind"], rows["feature"], strict=True)
    ]
    show_table(rows, columns, context.locale, "panel-rework", 220, keys, look_at, st.query_params.get("feature"))


def show_rules(context: PageContext, view: PanelView) -> None:
    """Acceptance rules, and the verdicts so far."""
    if view.rules.empty:
        st.info(
            _("The specification that judged this panel has no acceptance rules: nothing says when it is accepted.")
        )
    else:
        shown = view.rules.assign(rule=view.rules["rule"].map(context.locale.reason))
        columns = {"rule": _("Rule"), "applies_to": _("Of"), "verdict": _("Outcome"), "reason": _("What was found")}
        show_table(shown, columns, context.locale, "panel-rules", 260)
    st.markdown("**" + _("Verdicts so far") + "**")
    columns = {"judged_at": _("Judged"), "panel_spec": _("By"), "verdict": _("Verdict"), "reason": _("Why")}
    show_table(view.verdicts.iloc[::-1], columns, context.locale, "panel-verdicts", 200)


def show_coverage(context: PageContext, view: PanelView) -> None:
    """What was expected and not measured."""
    missing = view.coverage[view.coverage["state"] != "measured"]
    if view.coverage.empty:
        st.info(
            _(
                "No pattern says what there should be, so nothing can be missing. A specification with nominal places "
                "(`flushline panel`) tells what was not looked at."
            )
        )
    elif missing.empty:
        st.success(_("Every expected fastener and stretch of seam was measured."), icon=":material/check:")
    else:
        columns = {"feature_id": _("Expected"), "state": _("State"), "from_mm": _("From, mm"), "to_mm": _("To, mm"),
                   "reason": _("Why")}  # fmt: skip
        show_table(missing, columns, context.locale, "panel-coverage", 470, above=330)


def show_scans(context: PageContext, scenes: Sequence[Any]) -> None:
    """The scans that the panel is put together from."""
    signed = context.archive.review().sign_offs()
    found = context.archive.standings_of([str(scene.scene_id) for scene in scenes])
    rows = pd.DataFrame(
        {
            "scene_id": str(scene.scene_id),
            "station": scene.station,
            "captured_at": scene.captured_at,
            "findings": standings_words(found[str(scene.scene_id)]),
            "signed": signed[scene.scene_id].who if scene.scene_id in signed else "–",
            "reason": SEPARATOR.join(map(str, scene.warnings if scene.warnings is not None else ())),
        }
        for scene in scenes
    )
    columns = {"station": _("Station"), "captured_at": _("Scanned"), "findings": _("Findings"),
               "signed": _("Signed off"), "reason": _("Warnings")}  # fmt: skip
    show_table(rows, columns, context.locale, "panel-scans", 300, list(rows["scene_id"]), _open_scene)
    st.caption(_("Select a scan to open its picture."))


def _open_scene(scene: str) -> None:
    go("scene", scene=scene)
