"""The review as files: CSV for spreadsheets, and one self-contained HTML page."""

from __future__ import annotations

import html
from datetime import UTC, datetime
from typing import Any

import pandas as pd

from dashboard.data import Archive
from dashboard.findings import feature_of
from dashboard.habits import Habits, with_minus
from dashboard.palette import DECISION_MARKS
from dashboard.pictures import around, data_uri, load_picture
from dashboard.scenes import find_feature, load_features, load_scene_row
from metrology.errors import FlushlineError
from metrology.verdicts import SEVERITIES
from storage.archive.work import Standing, said
from storage.review import Feature, ReviewLog
from storage.spreadsheet import ENCODING, harmless

_CROP_PX = 60
_MOST_PICTURES = 60
_STYLE = f"""
body {{font: 14px/1.45 system-ui, sans-serif; margin: 2rem; color: #222}}
table {{border-collapse: collapse}} td, th {{border-bottom: 1px solid #ccc; padding: 4px 10px; text-align: left}}
td.n {{text-align: right; font-variant-numeric: tabular-nums}}
img {{height: 64px; display: block}}
{" ".join(f".{name} {{border-left: 6px solid {look.paper}}}" for name, look in SEVERITIES.items() if name)}
@media print {{body {{margin: 0}} tr {{break-inside: avoid}}}}
"""


def csv_report(rows: pd.DataFrame, habits: Habits) -> bytes:
    """Rows as CSV for a person's spreadsheet (German: semicolons and decimal commas), times in ISO 8601 (UTC)."""
    german = habits.style == "de"
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


def html_report(rows: pd.DataFrame, archive: Archive, habits: Habits, title: str) -> bytes:
    """Findings as one HTML page with pictures of the first ones, dispositions and traceability."""
    body = "\n".join(_row(row, archive, habits, i < _MOST_PICTURES) for i, row in enumerate(rows.to_dict("records")))
    limits = ", ".join(sorted({str(name) for name in rows["panel_spec"].dropna()})) or "not stated"
    versions = ", ".join(sorted({str(name) for name in rows["software_version"].dropna()})) or "not stated"
    heads = (
        "",
        "Aircraft",
        "Panel",
        "Station",
        "Feature",
        "Height / step, mm",
        "± U95, mm",
        "Verdict",
        "Why",
        "State",
        "Disposition",
    )
    titles = "".join(f"<th>{head}</th>" for head in heads)
    made = f"{habits.time(datetime.now(UTC))} ({habits.zone})"
    page = f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{_text(title)}: tolerance review</title>
<style>{_STYLE}</style></head><body>
<h1>{_text(title)}: tolerance review</h1>
<p>{len(rows)} findings ({_text(said(_standings(rows)))}) · made {_text(made)} from {_text(archive.root)}<br>
Limits: {_text(limits)} · Flushline {_text(versions)} · decisions by ISO 14253-1 with the guard band U95<br>
The review log ends with {_text(ReviewLog(archive.root).head())}</p>
<table><thead><tr>{titles}</tr></thead><tbody>
{body}
</tbody></table></body></html>
"""
    return page.encode()


def _standings(rows: pd.DataFrame) -> list[Standing]:
    return [Standing(feature_of(row), row.state) for row in rows.itertuples()]


def _row(row: dict[str, Any], archive: Archive, habits: Habits, picture: bool) -> str:
    decided = ""
    if not pd.isna(row["disposition"]):
        decided = f"{row['disposition']}, {row['who']}, {habits.time(row['decided_at'])}"
    if not pd.isna(row["signed_by"]):
        decided += f" (signed off by {row['signed_by']})"
    if not pd.isna(row["closed_by"]):
        decided += f"; work closed by {row['closed_by']}: {row['closed_because']}"
    reason = "" if pd.isna(row["reason"]) else with_minus(row["reason"])
    cells = [
        f"<td>{_picture(row, archive) if picture else ''}</td>",
        *(f"<td>{_text(row[name])}</td>" for name in ("aircraft_serial", "panel", "station", "feature_id")),
        f'<td class="n">{_text(habits.number(row["value_mm"], sign=True))}</td>',
        f'<td class="n">{_text(habits.number(row["u95_mm"]))}</td>',
        f"<td>{_text(DECISION_MARKS.get(row['decision'], row['decision']))}</td><td>{_text(reason)}</td>",
        f"<td>{_text(row['state'])}</td><td>{_text(decided)}</td>",
    ]
    severity = row["severity"] if row["severity"] in SEVERITIES and row["severity"] else ""
    return f'<tr class="{severity}">{"".join(cells)}</tr>'


def _picture(row: dict[str, Any], archive: Archive) -> str:
    try:
        scene = load_scene_row(archive, str(row["scene_id"]))
        if scene is None:
            return ""
        features = load_features(archive, scene)
        measured = find_feature(features, Feature(row["feature_kind"], str(row["feature_id"])))
        if measured is None:
            return ""
        picture = load_picture(archive.file(scene.preview_path))
        part = around(picture, float(measured.u_px), float(measured.v_px), _CROP_PX * picture.shape[1] / 1624 + 10)
        return f'<img src="{data_uri(part)}" alt="">'
    except (FlushlineError, ValueError, TypeError):
        return ""


def _text(value: object) -> str:
    return html.escape(str(value))
