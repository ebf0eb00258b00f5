"""The review as files: CSV for spreadsheets, and one self-contained HTML page."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import pandas as pd

from dashboard.data import Archive
from dashboard.findings import feature_of, feature_words, standings_words
from dashboard.locale import Locale
from dashboard.margins import about_the_verdict, with_margins
from dashboard.palette import decision_words, quantity_words
from dashboard.pictures import data_uri
from dashboard.scenes import find_feature, load_features, load_scene_row, surroundings
from dashboard.words import N_, _, speak
from metrology.errors import FlushlineError
from metrology.kinds import BY_NAME
from metrology.verdicts import SEVERITIES
from storage.archive.work import Standing
from storage.review import Feature, ReviewLog
from storage.review_details import Numbers
from storage.spreadsheet import ENCODING, harmless
from storage.templates import rendered

_MOST_PICTURES = 60
_HEADS = (
    N_("Aircraft"), N_("Panel"), N_("Station"), N_("Feature"), N_("Value, mm"), N_("± U95, mm"), N_("Verdict"),
    N_("Why"), N_("State"), N_("Disposition"),
)  # fmt: skip


def csv_report(rows: pd.DataFrame, locale: Locale) -> bytes:
    """Rows as CSV for a person's spreadsheet (German: semicolons and decimal commas), times in ISO 8601 (UTC)."""
    german = locale.style == "de"
    shown = rows.copy()
    for place in range(rows.shape[1]):
        column = rows.iloc[:, place]  # by place: a query may give two columns one name
        if isinstance(column.dtype, pd.DatetimeTZDtype):
            shown.isetitem(place, column.dt.strftime("%Y-%m-%dT%H:%M:%SZ"))
        elif not pd.api.types.is_numeric_dtype(column.dtype):
            shown.isetitem(place, [harmless(value) for value in column])
    shown.columns = pd.Index([harmless(str(name)) for name in shown.columns])
    text = shown.to_csv(index=False, sep=";" if german else ",", decimal="," if german else ".", lineterminator="\r\n")
    return text.encode(ENCODING)


def html_report(rows: pd.DataFrame, archive: Archive, locale: Locale, title: str, spoken: str) -> bytes:
    """Findings as one HTML page in a language, with pictures of the first ones, dispositions and traceability."""
    speak(spoken)  # made when it is asked for, which is no run of the page
    shown = about_the_verdict(with_margins(archive, rows)).to_dict("records")
    findings = [_finding(row, archive, locale, i < _MOST_PICTURES) for i, row in enumerate(shown)]
    page = rendered(
        "dashboard",
        "review.html",
        title=title + ": " + _("Tolerance review"),
        language=spoken,
        colours={name: look.paper for name, look in SEVERITIES.items() if name},
        findings=findings,
        heads=[_(head) for head in _HEADS],
        summary=_summary(rows, archive, locale),
    )
    return page.encode()


def _summary(rows: pd.DataFrame, archive: Archive, locale: Locale) -> list[str]:
    standings = standings_words(Standing(feature_of(row), row.state) for row in rows.itertuples())
    made = f"{locale.time(datetime.now(UTC))} ({locale.zone})"
    return [
        _("{n} findings ({standings}) · made {made}", n=len(rows), standings=standings, made=made),
        _(
            "Limits: {limits} · Flushline {versions} · decided after ISO 14253-1 with the uncertainty U95",
            limits=_names(rows["panel_spec"]), versions=_names(rows["software_version"]),
        ),
        _("The review log ends with {entry}", entry=ReviewLog(archive.root).head()),
    ]  # fmt: skip


def _names(values: pd.Series) -> str:
    return ", ".join(sorted({str(name) for name in values.dropna()})) or _("not stated")


def _finding(row: dict[str, Any], archive: Archive, locale: Locale, picture: bool) -> dict[str, str]:
    """What the template says of one finding."""
    decided = ""
    if not pd.isna(row["disposition"]):
        decided = f"{_(row['disposition'])}, {row['who']}, {locale.time(row['decided_at'])}"
        numbers = Numbers(**{name: row[name] for name in Numbers.model_fields if isinstance(row[name], str)})
        decided += "".join(f", {_(name)} {number}" for name, number in numbers.given.items())
    if not pd.isna(row["signed_by"]):
        decided += " (" + _("signed off by {who}", who=row["signed_by"]) + ")"
    if not pd.isna(row["closed_by"]):
        decided += "; " + _("work closed by {who}: {reason}", who=row["closed_by"], reason=row["closed_because"])
    return {
        **{name: str(row[name]) for name in ("aircraft_serial", "panel", "station")},
        "feature_id": feature_words(str(row["feature_id"]), locale),
        "state": _(str(row["state"])),
        "picture": _picture(row, archive) if picture else "",
        "value": _value(row, locale),
        "u95": locale.number(row["u95_mm"]),
        "verdict": decision_words(row["decision"]),
        "reason": "" if pd.isna(row["reason"]) else locale.reason(row["reason"]),
        "decided": decided,
        "severity": row["severity"] if row["severity"] in SEVERITIES and row["severity"] else "",
    }


def _value(row: dict[str, Any], locale: Locale) -> str:
    """What the verdict is about; its name where that is not the first quantity of its kind."""
    first, *others = BY_NAME[row["feature_kind"]].quantities
    value = locale.number(row["value_mm"], sign=True)
    other = next((quantity for quantity in others if quantity.name == row["quantity"] != first.name), None)
    return f"{quantity_words(other.name)} {value} {other.unit}" if other else value


def _picture(row: dict[str, Any], archive: Archive) -> str:
    """The surroundings of a finding as a URI; "" where the store does not hold its picture."""
    try:
        scene = load_scene_row(archive, str(row["scene_id"]))
        if scene is None:
            return ""
        features = load_features(archive, scene)
        measured = find_feature(features, Feature(row["feature_kind"], str(row["feature_id"])))
        part = surroundings(archive, scene, measured)
        return "" if part is None else data_uri(part)
    except (FlushlineError, ValueError, TypeError):
        return ""
