"""Recording what people decide: about what the archive still shows, and about nothing else.

Whoever decides says what was on the screen. While the store's lock is held no other run can take its place, so what
is compared here is still true when the review log has the entry.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import duckdb

from metrology.errors import OutdatedError, UsageError
from metrology.kinds import BY_NAME, HOLE, RIVET, Kind
from storage.archive import snapshot
from storage.archive.anchors import SIGNED_MANIFEST, manifest_checksum
from storage.archive.bundles import Bundles
from storage.archive.files import locked
from storage.archive.layout import Layout
from storage.archive.rows import named_rows
from storage.archive.work import OPEN_WORK, UNRESOLVED, features_sql, standings, stretches_sql
from storage.documents import utc_text
from storage.review import Disposition, Entry, Feature, Review, ReviewLog, ShownFinding, ShownScene
from storage.review_details import Numbers, Signature
from storage.review_entries import POSITIONS, SHOWN_OF_POSITION

_MOST_NAMED = 5
MARKED = (RIVET, HOLE)
"""Kinds of which a person may mark one as false."""


def shown_finding(
    connection: duckdb.DuckDBPyConnection, review: Review, scene_id: str, feature: Feature
) -> ShownFinding | None:
    """A finding as the archive has it, with what was decided about it; None where there is no such feature.

    `values` also names the newest scan of the finding's station, so that a decision about a scan which another one
    replaced meanwhile is named.
    """
    newest = """(SELECT max_by(n.scene_id, n.captured_at) FROM scenes n WHERE n.aircraft_serial = s.aircraft_serial
        AND n.panel = s.panel AND n.station = s.station) AS newest_scan"""
    sql = f"""SELECT s.run_id, s.panel_spec, s.software_version, s.rig_id, s.config_hash, f.* EXCLUDE (feature_kind),
        {newest} FROM ({_one_sql(BY_NAME[feature.kind], feature)}) f JOIN scenes s USING (scene_id)"""
    rows = named_rows(connection, sql, [scene_id, feature.id])
    if not rows:
        return None
    values = {name: _plain(value) for name, value in rows[0].items()}
    run_id = str(values.pop("run_id"))
    shown = ShownFinding(values.pop("scene_id"), run_id, feature, values)
    last = review.last_about(scene_id, *shown.features)
    return replace(shown, last_entry=last.number if last else 0)


def _one_sql(kind: Kind, feature: Feature) -> str:
    """The finding that a feature names; a stretch with each of its positions."""
    of_scene = features_sql(kind, "scene_id = ?")
    if not feature.is_stretch:
        return f"SELECT * EXCLUDE (at_mm, beyond_mm, stretch) FROM ({of_scene}) WHERE feature_id = ?"
    parts = f"list({{{', '.join(f'{name!r}: {name}' for name in SHOWN_OF_POSITION)}}} ORDER BY at_mm) AS {POSITIONS}"
    return stretches_sql(f"(FROM ({of_scene}) WHERE stretch = ?)", parts)


def dispose(
    root: Path, who: str, shown: Sequence[ShownFinding], disposition: Disposition, comment: str = "",
    numbers: Numbers | None = None,
) -> list[Entry]:  # fmt: skip
    """Record what shall happen with findings; refused as a whole where one of them is not as it was shown."""
    with _as_shown(Layout(root), shown):
        return ReviewLog(root).dispose(who, shown, disposition, comment, numbers)


def close_work(root: Path, who: str, shown: Sequence[ShownFinding], reason: str) -> list[Entry]:
    """Record why open work is done; refused as a whole where one of the findings is not as it was shown."""
    with _as_shown(Layout(root), shown):
        return ReviewLog(root).close(who, shown, reason)


def undo(root: Path, who: str, shown: Sequence[ShownFinding], reason: str) -> list[Entry]:
    """Record why the last decision about findings is undone; refused where one of them is not as it was shown."""
    with _as_shown(Layout(root), shown):
        return ReviewLog(root).undo(who, shown, reason)


def mark_false(root: Path, who: str, shown: ShownFinding, reason: str) -> Entry:
    """Record that no fastener is where the software found one; refused where it is not as it was shown."""
    kind = BY_NAME[shown.feature.kind]
    if kind not in MARKED:
        raise UsageError(f"mark: found a {kind.subject}, expected a {' or a '.join(k.subject for k in MARKED)}")
    with _as_shown(Layout(root), [shown]) as connection:
        return ReviewLog(root).mark_false(who, shown, reason, _pixel(connection, kind, shown) if connection else None)


def mark_missed(root: Path, who: str, shown: ShownScene, note: str, pixel: tuple[float, float] | None = None) -> Entry:
    """Record that a fastener was missed; refused where another run has taken the place of the one that was shown."""
    with _held(Layout(root)) as connection:
        if connection:
            _check_run(connection, shown)
        return ReviewLog(root).mark_missed(who, shown, note, pixel)


def unmark(root: Path, who: str, scene_id: str, number: int, reason: str) -> Entry:
    """Take a mark back, which is named by the number of its entry, and say why."""
    return ReviewLog(root).unmark(who, scene_id, number, reason)


def _pixel(connection: duckdb.DuckDBPyConnection, kind: Kind, shown: ShownFinding) -> tuple[float, float] | None:
    """Where a feature is in its scan's picture; None where it was not seen there."""
    sql = f"SELECT u_px, v_px FROM {kind.table} WHERE scene_id = ? AND {kind.id_sql} = ?"
    found = connection.execute(sql, [shown.scene_id, shown.feature.id]).fetchone()
    if found is None or any(value is None or not math.isfinite(value) for value in found):
        return None
    return float(found[0]), float(found[1])


def sign_off(root: Path, who: str, shown: ShownScene, comment: str = "") -> Entry:
    """Close a scene of a store; see `sign_off_all`."""
    return sign_off_all(root, who, [shown], comment)[0]


def sign_off_all(
    root: Path, who: str, shown: Sequence[ShownScene], comment: str = "", signature: Signature | None = None
) -> list[Entry]:
    """Close scenes of a store, all of them or none.

    Refused where another run has taken the place of one that was shown, where something was decided since, or where
    a finding waits or has open work.
    """
    layout, log = Layout(root), ReviewLog(root)
    with _held(layout) as connection:
        if connection:
            shown = [_ready(connection, layout, log, scene) for scene in shown]
        return log.sign_off_all(who, shown, comment, signature)


def _ready(connection: duckdb.DuckDBPyConnection, layout: Layout, log: ReviewLog, shown: ShownScene) -> ShownScene:
    """A scene that may be signed off, with the checksum of its run's manifest."""
    _check_run(connection, shown)
    _check_resolved(connection, log.of_scenes(same_place(connection, shown.scene_id)), shown.scene_id)
    signed = {SIGNED_MANIFEST: manifest_checksum(Bundles(layout), shown.scene_id, shown.run_id)}
    return replace(shown, values={**shown.values, **signed})


def same_place(connection: duckdb.DuckDBPyConnection, scene_id: str) -> list[str]:
    """All scans of a scan's station, itself included: what was decided about them decides how its findings stand."""
    rows = connection.execute(
        "SELECT s.scene_id FROM scenes s JOIN scenes t USING (aircraft_serial, panel, station) WHERE t.scene_id = ?",
        [scene_id],
    ).fetchall()
    return [str(scene) for (scene,) in rows]


@contextlib.contextmanager
def _held(layout: Layout) -> Iterator[duckdb.DuckDBPyConnection | None]:
    """Hold the archive as it is; None where nothing was ever published."""
    if not layout.archive.exists():
        yield None
        return
    snapshot.make_usable(layout)
    with locked(layout.lock), contextlib.closing(snapshot.connect(layout, mend=False)) as connection:
        yield connection


@contextlib.contextmanager
def _as_shown(layout: Layout, shown: Sequence[ShownFinding]) -> Iterator[duckdb.DuckDBPyConnection | None]:
    with _held(layout) as connection:
        for finding in shown:
            now = shown_finding(connection, Review(), finding.scene_id, finding.feature) if connection else None
            if change := _change(finding, now):
                raise OutdatedError(f"{finding.scene_id} {finding.feature.id}: {change}; look at it as it is now first")
        yield connection


def _change(shown: ShownFinding, now: ShownFinding | None) -> str | None:
    """What became of a finding since it was shown; None where it is as it was."""
    if now is None:
        return "found it no more in the archive, expected it as it was shown"
    if now.run_id != shown.run_id:
        return f"found that its scan was inspected again (run {now.run_id}), expected run {shown.run_id}"
    if now.values.get("newest_scan") != shown.values.get("newest_scan"):
        return f"found a newer scan of its station ({now.values.get('newest_scan')}), expected none"
    differing = [name for name, value in now.values.items() if shown.values.get(name) != value]
    if differing:
        name = differing[0]
        return f"found {name} {now.values[name]}, expected {shown.values.get(name)} as it was shown"
    return None


def _check_run(connection: duckdb.DuckDBPyConnection, shown: ShownScene) -> None:
    newest = connection.execute("SELECT run_id FROM scenes WHERE scene_id = ?", [shown.scene_id]).fetchall()
    if not newest:
        raise OutdatedError(f"{shown.scene_id}: found it no more in the archive, expected the scene that was shown")
    if newest[0][0] != shown.run_id:
        raise OutdatedError(
            f"{shown.scene_id}: found that it was inspected again (run {newest[0][0]}), expected run {shown.run_id}; "
            "look at the new result first"
        )


def _check_resolved(connection: duckdb.DuckDBPyConnection, review: Review, scene_id: str) -> None:
    left = [standing for standing in standings(connection, review, scene_id) if standing.state in UNRESOLVED]
    if left:
        named = ", ".join(
            f"{s.feature.id} ({'open work' if s.state == OPEN_WORK else 'no disposition'})" for s in left[:_MOST_NAMED]
        )
        more = f" and {len(left) - _MOST_NAMED} more" if len(left) > _MOST_NAMED else ""
        raise UsageError(f"{scene_id}: found {named}{more}, expected every finding decided and all work done")


def _plain(value: object) -> Any:
    """A value as JSON has it."""
    if isinstance(value, datetime):
        return utc_text(value)
    if isinstance(value, list):
        return [_plain(each) for each in value]
    if isinstance(value, dict):
        return {name: _plain(each) for name, each in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value
