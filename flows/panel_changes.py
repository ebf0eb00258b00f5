"""What changed on a panel since an earlier assembly, in lines for a person."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from metrology.assembly.rows import CHANGES
from metrology.errors import StoreError
from metrology.kinds import BY_NAME
from metrology.results import PanelKey
from storage.archive import Store
from storage.archive.panel_changes import compared, earlier_shifts, runs_of_panel
from storage.archive.panel_rework import rework_sql
from storage.archive.rows import named_rows
from storage.archive.work import register
from storage.documents import utc_text
from storage.review import ReviewLog

Row = Mapping[str, Any]


def counted_changes(rows: Sequence[Row]) -> list[str]:
    """How many findings changed how since the assembly before, in one line; none where there was no other."""
    if not rows:
        return []
    counts = Counter(row["change"] for row in rows)
    since = utc_text(rows[0]["before_captured_at"])
    return [f"  since {since}: " + ", ".join(f"{counts[change]} {change}" for change in CHANGES if counts[change])]


def changes_lines(store: Store, key: PanelKey, since: str | None = None) -> list[str]:
    """What became of each finding of a panel, and of the work that was decided.

    Parameters
    ----------
    since : str, optional
        Begins the time of an earlier assembly; by default the last one of an earlier shift.
    """
    runs = runs_of_panel(store, key)
    if not runs:
        raise StoreError(
            f"{store.root}: found no assembled panel {key}, expected one: 'flushline panel assemble' first"
        )
    *earlier, now = runs
    found = [run for run in earlier if utc_text(run.captured_at).startswith(since)] if since else None
    before = next(reversed(earlier_shifts(now, runs) if found is None else found), None)
    if before is None:
        known = ", ".join(utc_text(run.captured_at) for run in earlier) or "an earlier assembly: there is none"
        raise StoreError(f"{key}: found no assembly {f'of {since}' if since else 'before'}, expected one of {known}")
    rows = [asdict(row) for row in compared(now, before)]
    lines = [f"panel {key} since {utc_text(before.captured_at)}: {len(rows)} findings"]
    for change in CHANGES:
        lines += [f"  {change}: {_said(row)}" for row in rows if row["change"] == change]
    return lines + [_rework_said(row) for row in _rework(store, key)]


def _said(row: Row) -> str:
    quantity = next(q for q in BY_NAME[row["feature_kind"]].quantities if q.name == row["quantity"])

    def measured(value: float | None, u95: float | None) -> str:
        u95_said = "" if u95 is None else f" ± {u95:.3f}"
        return "not measured" if value is None else f"{value:+.3f}{u95_said} {quantity.unit}"

    difference = row["difference"]
    parts = [
        f"{quantity.said} {measured(row['value'], row['value_u95'])}",
        f"before {measured(row['before_value'], row['before_u95'])}",
        *([f"difference {measured(difference, row['difference_u95'])}"] if difference is not None else []),
        *([row["reason"]] if row["reason"] else []),
    ]
    return f"{BY_NAME[row['feature_kind']].subject} {row['feature_id']}: {', '.join(parts)}"


def _rework(store: Store, key: PanelKey) -> list[dict[str, Any]]:
    with contextlib.closing(store.connect()) as connection:
        scenes = connection.execute(
            "SELECT scene_id FROM scenes WHERE aircraft_serial = ? AND panel = ?", [key.aircraft_serial, key.panel]
        ).fetchall()
        register(connection, ReviewLog(store.root).of_scenes([scene for (scene,) in scenes]))
        return named_rows(connection, rework_sql(), [key.aircraft_serial, key.panel])


def _rework_said(row: Row) -> str:
    comment = f" ({row['comment']})" if row["comment"] else ""
    where = row["panel_feature"] or f"{row['name']} of {row['station']}"
    decided = f"decided by {row['who']} {row['decided_at']:%Y-%m-%d}"
    return f"  {row['disposition']} of {where}, {decided}{comment}: {row['state']}"
