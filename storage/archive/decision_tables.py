"""What people decided as tables for SQL.

`decisions` has every entry of the review log, `dispositions` the last of each feature, `marks` the fasteners that a
person marked as false or missed.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrology.errors import StoreError
from metrology.kinds import KINDS
from storage.review_details import CONFIRMATIONS

if TYPE_CHECKING:
    import duckdb
    import pyarrow as pa

    from storage.review import Entry, Review

Row = Mapping[str, Any]
_KINDS = " or ".join(kind.name for kind in KINDS)
_IDS = ", or ".join("@".join(kind.id_columns) for kind in KINDS)
_NUMBERS_COLUMNS = {
    "concession": "number of the concession or NCR",
    "part_number": "number of the part that the work needs",
    "work_order": "number of the work order",
}
DECISIONS_COLUMNS = {
    "number": "counts the entries of the review log",
    "at": "when it was decided (UTC)",
    "who": "who decided",
    "action": "disposition, close, undo, sign-off, mark or unmark",
    "scene_id": "the scene",
    "run_id": "the run of the scene that was shown",
    "feature_kind": f"{_KINDS}; NULL for a sign-off",
    "feature_id": f"{_IDS}; of a stretch COURSE@FROM-TO",
    "disposition": "use as is, rework, repair, scrap, re-scan",
    "comment": "what they said",
    **_NUMBERS_COLUMNS,
    "role": "of a sign-off, the role in which they signed",
    "meaning": "of a sign-off, what the signature says",
    "confirmed": f"of a sign-off, how sure it is who signed: {'; '.join(CONFIRMATIONS)}",
    "document": "the whole entry as JSON, with what was shown",
    "checksum": "SHA-256 of the document, which the next entry names",
}
DISPOSITIONS_COLUMNS = {
    "scene_id": "the scene",
    "feature_kind": _KINDS,
    "feature_id": _IDS,
    "decided_at": "when the last disposition was recorded (UTC)",
    "disposition": "use as is, rework, repair, scrap, re-scan",
    "who": "who decided",
    "comment": "what they said",
    **_NUMBERS_COLUMNS,
    "open_work": "whether rework, repair or re-scan was asked for and is not done",
    "closed_by": "who closed the work, where a person did",
    "closed_because": "why they closed it",
}
MARKS_COLUMNS = {
    "number": "counts the entries of the review log",
    "at": "when it was marked (UTC)",
    "who": "who marked it",
    "mark": "false (no fastener is there) or missed",
    "scene_id": "the scene",
    "run_id": "the run of the scene that was shown",
    "feature_kind": "of a false one, its kind",
    "feature_id": "of a false one, its id",
    "u_px": "column in the scan's picture",
    "v_px": "row in the scan's picture",
    "comment": "what they said",
    "holds": "whether nobody took the mark back",
    "taken_back_by": "who took it back",
    "taken_back_at": "when it was taken back (UTC)",
    "taken_back_because": "why they took it back",
}


def register_decisions(connection: duckdb.DuckDBPyConnection, root: Path, named: Collection[str]) -> None:
    """Make those of the tables that are named known to a connection; refused where the log cannot be trusted."""
    from storage.archive.work import reviewed_features
    from storage.review import ReviewLog

    review = ReviewLog(root).read()
    if review.problem:
        raise StoreError(review.problem)
    if "decisions" in named:
        connection.register("decisions", decisions(review))
    if "marks" in named:
        connection.register("marks", marks(review))
    if "dispositions" in named:
        last = reviewed_features(connection, review)
        connection.register("dispositions", last.select(list(DISPOSITIONS_COLUMNS)))


def decisions(review: Review) -> pa.Table:
    """Every entry, the first one first."""
    return _table([_decision(entry) for entry in review.entries], DECISIONS_COLUMNS)


def marks(review: Review) -> pa.Table:
    """Every mark of a false or missed fastener, the first one first."""
    return _table([_marked(entry, back) for entry, back in review.marks()], MARKS_COLUMNS)


def _decision(entry: Entry) -> Row:
    signature = entry.signature
    numbers = dict(zip(_NUMBERS_COLUMNS, entry.numbers.columns, strict=True))
    signed = signature.model_dump() if signature else dict.fromkeys(("role", "meaning", "confirmed"))
    beside = {**numbers, **signed}
    return {name: beside[name] if name in beside else getattr(entry, name) for name in DECISIONS_COLUMNS}


def _marked(entry: Entry, back: Entry | None) -> Row:
    mark = entry.mark
    beside = {
        "mark": mark and mark.kind,
        "u_px": mark and mark.u_px,
        "v_px": mark and mark.v_px,
        "holds": back is None,
        "taken_back_by": back and back.who,
        "taken_back_at": back and back.at,
        "taken_back_because": back and back.comment,
    }
    return {name: beside[name] if name in beside else getattr(entry, name) for name in MARKS_COLUMNS}


def _table(rows: Sequence[Row], columns: Collection[str]) -> pa.Table:
    import pyarrow as pa

    moment = pa.timestamp("us", "UTC")
    types = {
        "number": pa.int64(), "at": moment, "taken_back_at": moment, "u_px": pa.float64(), "v_px": pa.float64(),
        "holds": pa.bool_(),
    }  # fmt: skip
    return pa.table({name: pa.array([row[name] for row in rows], types.get(name, pa.string())) for name in columns})
