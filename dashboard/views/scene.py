"""Scene: one scan with everything that was found on it, and close-ups of what is clicked."""

from __future__ import annotations

import json
from functools import partial
from typing import Any

import pandas as pd
import streamlit as st

from dashboard.address import one_of, put
from dashboard.deciding import ask_who, say_outcome
from dashboard.deviation import FieldDeviation, field_deviation
from dashboard.figures.scene import SceneFeatures, cloud_figure, deviation_map, scene_figure
from dashboard.findings import feature_from_parameter, feature_parameter, standings_words
from dashboard.frame import PageContext, link, plain
from dashboard.marking import add_marks, add_places, offer_mark_false, offer_mark_missed, place_clicked, show_marks
from dashboard.picking import clickable_chart
from dashboard.pictures import load_picture
from dashboard.reasons import SEPARATOR
from dashboard.reports import offer_report
from dashboard.scenes import (
    find_feature,
    load_features,
    load_scene_row,
    worst_feature,
)
from dashboard.views.feature import absent, close_up
from dashboard.views.overlay import show_overlay
from dashboard.words import N_, _
from metrology.errors import FlushlineError
from metrology.kinds import HOLE, KINDS, RIVET, Kind
from storage.archive.views import NEWEST_FIRST
from storage.cloud import StoredCloud
from storage.report import scene_report
from storage.review import Feature
from storage.wording import capital

TITLE = N_("Scan")
_MAP_POINTS = 120_000
_CLOUD_POINTS = (30_000, 100_000, 300_000)
_EXAGGERATIONS = (1, 10, 50, 100)
_HEIGHT = 500


def render(context: PageContext) -> None:
    """Show the page."""
    scene_id = str(st.query_params.get("scene") or "") or _newest(context)
    row = load_scene_row(context.archive, scene_id)
    if row is None:
        st.warning(_("There is no scan {name} in this store.", name=plain(scene_id)))
        link("archive", _("Find a scan in the archive"), icon=":material/inventory_2:")
        return
    features = load_features(context.archive, row)
    named = st.query_params.get("feature")
    chosen = feature_from_parameter(named)
    unknown = chosen is not None and find_feature(features, chosen) is None
    if chosen is None or unknown:
        chosen = worst_feature(features)
    _headline(context, row)
    if unknown:
        st.caption(_("This scan has no {name}; the gravest finding is shown instead.", name=plain(named)))
    left, right = st.columns([11, 9])
    with left:
        _views(context, row, features, chosen)
    with right:
        if chosen is None:
            st.info(_("Nothing was found on this scan."))
        else:
            close_up(context, row, features, chosen)


def _newest(context: PageContext) -> str:
    rows = context.archive.rows(f"SELECT scene_id FROM scenes ORDER BY {NEWEST_FIRST}, scene_id LIMIT 1")
    return str(rows["scene_id"].iloc[0]) if len(rows) else ""


def _counts(context: PageContext, row: Any) -> str:
    """What was found, by kind: rivets and seams always, of the other kinds what there is."""
    counted = []
    for kind in (kind for kind in KINDS if kind.counts):
        column = kind.counts[0].column
        number = getattr(row, column)
        if kind.by_design or (pd.notna(number) and number):
            counted.append(f"{_(column.removeprefix('n_'))}: {context.locale.whole(number)}")
    return ", ".join(counted)


def _headline(context: PageContext, row: Any) -> None:
    signed = context.archive.review().sign_offs().get(row.scene_id)
    with st.container(horizontal=True, vertical_alignment="center"):
        where = {name: plain(getattr(row, name)) for name in ("panel", "station")}
        st.markdown(f"**{plain(row.aircraft_serial)} · " + _("panel {panel} · station {station}", **where) + "**")
        st.caption(
            _(
                "scanned {time} · {counts} · rig {rig}",
                time=context.locale.time(row.captured_at),
                counts=_counts(context, row),
                rig=plain(row.rig_id),
            )
        )
        if standings := context.archive.standings(str(row.scene_id)):
            st.caption(_("findings: {standings}", standings=standings_words(standings)))
        if row.rig_verdict in ("unjudged", "warning"):
            st.badge(
                _("rig not judged") if row.rig_verdict == "unjudged" else _("rig: warning"),
                icon=":material/help:",
                color="orange",
            )
        if signed:
            note = "" if signed.run_id == row.run_id else " (" + _("an earlier run") + ")"
            st.badge(_("signed off by {who}", who=plain(signed.who)) + note, icon=":material/lock:", color="green")
        link(
            "review",
            _("Review"),
            ":material/fact_check:",
            aircraft=row.aircraft_serial,
            panel=row.panel,
            scene=row.scene_id,
        )
    if warnings := _texts(row.warnings):
        said = context.locale.reason(SEPARATOR.join(warnings))
        st.markdown(f":small[:orange[:material/warning:] {plain(said)}]")


def _views(context: PageContext, row: Any, features: SceneFeatures, chosen: Feature | None) -> None:
    names = [N_("Picture"), N_("Deviation map"), N_("3-D"), N_("Overlay"), N_("Table"), N_("Marks"), N_("Files")]
    view = st.segmented_control(_("View"), names, format_func=_, label_visibility="collapsed", **one_of("view", names))
    show = {
        "Deviation map": _deviation,
        "3-D": _cloud_view,
        "Overlay": show_overlay,
        "Files": _files,
    }
    if view == "Marks":
        _marks(context, row, features, chosen)
    elif view == "Table":
        _table(context, row, features, chosen)
    elif view in show:
        show[view](context, row)
    else:
        _picture(context, row, features, chosen)


def _picture(context: PageContext, row: Any, features: SceneFeatures, chosen: Feature | None) -> None:
    picture = load_picture(context.archive.file(row.preview_path))
    fig = scene_figure(picture, features, chosen, context.locale, _HEIGHT)
    add_marks(fig, context.archive.review().standing_marks(str(row.scene_id)))
    clickable_chart(
        fig, "picture", partial(_choose, row.scene_id), {"scrollZoom": True, "displaylogo": False}, above=310
    )
    st.caption(_("Click a feature for its close-up; scroll to zoom, drag to move."))


def _marks(context: PageContext, row: Any, features: SceneFeatures, chosen: Feature | None) -> None:
    """The picture with what people marked, and the forms that mark a false or a missed fastener."""
    scene_id = str(row.scene_id)
    say_outcome(context, scene_id)
    picture = load_picture(context.archive.file(row.preview_path))
    fig = scene_figure(picture, features, chosen, context.locale, _HEIGHT - 140, values=False)
    add_places(fig, *picture.shape)
    add_marks(fig, context.archive.review().standing_marks(scene_id))
    clickable_chart(fig, "marks", partial(_mark_or_choose, scene_id), {"scrollZoom": True, "displaylogo": False}, 450)
    st.caption(_("Click a fastener to say that it is none, or the place where one was missed."))
    with st.container(horizontal=True, vertical_alignment="center"):
        ask_who(context, 150)
        if chosen is not None:
            offer_mark_false(context, context.archive.shown(scene_id, chosen))
    offer_mark_missed(context, row, *picture.shape)
    show_marks(context, scene_id)


def _mark_or_choose(scene_id: str, named: str) -> None:
    """Take over the place that was clicked; show the close-up where that was a feature."""
    if not place_clicked(scene_id, named):
        _choose(scene_id, named)


def _choose(scene_id: str, feature: str) -> None:
    """Show the close-up of a feature that was clicked."""
    put(scene=scene_id, feature=feature)


def _deviation(context: PageContext, row: Any) -> None:
    field = _field(context, row, _MAP_POINTS)
    if field is None:
        st.info(_("This scan has too few points for a map."))
        return
    st.plotly_chart(deviation_map(field, context.locale, _HEIGHT), key="map", config={"displaylogo": False})
    st.caption(_("Height above a smooth surface through the whole picture, mm; grey where there is no point."))


def _cloud_view(context: PageContext, row: Any) -> None:
    first, second = st.columns(2)
    most = first.selectbox(_("Points"), _CLOUD_POINTS, format_func=context.locale.whole, key="points")
    relief = second.selectbox(
        _("Relief"), _EXAGGERATIONS, index=2, format_func=lambda factor: f"× {factor}", key="relief"
    )
    field = _field(context, row, int(most))
    if field is None:
        st.info(_("This scan has too few points to show."))
        return
    st.plotly_chart(cloud_figure(field, float(relief), context.locale, _HEIGHT - 60), key="cloud")
    st.caption(_("Thinned out so that it turns smoothly; the whole cloud is under Files."))


@st.cache_data(max_entries=6, show_spinner=False)
def _field_of(_cloud: StoredCloud, path: str, most: int) -> FieldDeviation | None:
    return field_deviation(_cloud, most)


def _field(context: PageContext, row: Any, most: int) -> FieldDeviation | None:
    return _field_of(context.archive.cloud(row.cloud_path), str(row.cloud_path), most)


def _table(context: PageContext, row: Any, features: SceneFeatures, chosen: Feature | None) -> None:
    from dashboard.tables import show_table

    at = feature_parameter(chosen) if chosen else None
    for kind in KINDS:
        rows = features[kind.name]
        if kind is not RIVET and rows.empty:
            continue
        show_table(
            rows,
            {"feature_id": capital(_(kind.subject)), **_columns(kind)},
            context.locale,
            key=kind.table,
            height=220 if kind.is_course else 270,
            names=[feature_parameter(Feature(kind.name, str(name))) for name in rows["feature_id"]],
            picked=partial(_choose, row.scene_id),
            at=at,
        )


def _columns(kind: Kind) -> dict[str, str]:
    """What the table of a kind has beside its names, with headings."""
    columns: dict[str, str] = {}
    for quantity in kind.quantities:
        of_which = f" {_(quantity.said)}" if columns else ""
        unit = f", {quantity.unit}" if quantity.unit else ""
        columns[quantity.column] = f"{capital(_(quantity.said))}{unit}"
        columns[quantity.u95_column] = f"± U95{of_which}{unit}"
    if kind is RIVET:
        columns["diameter_mm"] = _("Ø, mm")
    if kind is HOLE:
        columns = {"kind": _("Kind"), **columns, "countersink_diameter_mm": _("Countersink Ø, mm")}
    return {**columns, "decision": _("Verdict"), "reason": _("Why")}


def _files(context: PageContext, row: Any) -> None:
    locale = context.locale
    facts = {
        _("Scan"): row.scene_id,
        _("Inspection"): row.run_id,
        _("Inspected"): locale.time(row.processed_at),
        _("Operator"): row.operator,
        _("Rig"): _("{rig} (checksum {checksum})", rig=row.rig_id, checksum=row.rig_hash),
        _("Software"): f"Flushline {row.software_version}",
        _("Settings"): row.config_hash,
        _("Limits"): row.panel_spec,
        _("Points"): _(
            "{n} ({share} of the picture)", n=locale.whole(row.n_points), share=locale.percent(row.valid_fraction)
        ),
        _("Noise of a point"): f"{locale.number(row.sigma_z_median_mm, 4)} mm",
        _("Rig fit"): _(
            "{verdict}: cameras {cameras} px, projector {projector} px",
            verdict=_("not judged") if absent(row.rig_verdict) else _(str(row.rig_verdict)),
            cameras=locale.number(row.epipolar_rms_px),
            projector=locale.number(row.projector_rms_px, 4),
        ),
        _("Folder"): row.bundle_path,
    }
    rows = [(name, "–" if absent(value) else str(value)) for name, value in facts.items()]
    st.dataframe(pd.DataFrame(rows, columns=[_("What"), _("Value")]), hide_index=True, height=458)
    with st.container(horizontal=True):
        for label, path, kind in (
            (_("Cloud (Parquet)"), row.cloud_path, "application/octet-stream"),
            (_("Picture"), row.preview_path, "image/png"),
            (_("Rig"), f"{row.bundle_path}/rig.json", "application/json"),
            (_("Manifest"), f"{row.bundle_path}/manifest.json", "application/json"),
        ):
            _download(context, label, path, kind, row.scene_id)
    store, scene_id = context.archive.store, str(row.scene_id)
    offer_report(scene_id, context.locale, lambda words: scene_report(store, scene_id, words))


def _download(context: PageContext, label: str, path: object, kind: str, scene_id: str) -> None:
    try:
        file = context.archive.file(path)
    except FlushlineError:
        st.button(label, disabled=True, help=_("The file is not in the store any more."), key=f"no {label}")
        return
    # Read when it is asked for: a cloud has 10 MB.
    st.download_button(label, file.read_bytes, f"{scene_id}_{file.name}", kind, on_click="ignore", key=f"get {label}")


def _texts(values: object) -> list[str]:
    if isinstance(values, str):
        try:
            values = json.loads(values)
        except ValueError:
            return [str(values)]
    return [str(value) for value in values] if hasattr(values, "__iter__") else []
