"""What people decided as tables for SQL: `decisions`, every entry of the review log, and `dispositions`, the last."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

from metrology.errors import StoreError
from metrology.kinds import KINDS

if TYPE_CHECKING:
    import duckdb
    import pyarrow as pa

    from storage.review import Review

_KINDS = " or ".join(kind.name for kind in KINDS)
_IDS = ", or ".join("@".join(kind.id_columns) for kind in KINDS)
DECISIONS_COLUMNS = {
    "number": "counts the entries of the review log",
    "at": "when it was decided (UTC)",
    "who": "who decided",
    "action": "disposition, close, undo or sign-off",
    "scene_id": "the scene",
    "run_id": "the run of the scene that was shown",
    "feature_kind": f"{_KINDS}; NULL for a sign-off",
    "feature_id": f"{_IDS}; of a stretch COURSE@FROM-TO",
    "disposition": "use as is, rework, repair, scrap, re-scan",
    "comment": "what they said",
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
    "open_work": "whether rework, repair or re-scan was asked for and is not done",
    "closed_by": "who closed the work, where a person did",
    "closed_because": "why they closed it",
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
    if "dispositions" in named:
        last = reviewed_features(connection, review)
        connection.register("dispositions", last.select(list(DISPOSITIONS_COLUMNS)))


def decisions(review: Review) -> pa.Table:
    """Every entry, the first one first."""
    import pyarrow as pa

    types = {"number": pa.int64(), "at": pa.timestamp("us", "UTC")}
    return pa.table(
        {
            name: pa.array([getattr(entry, name) for entry in review.entries], types.get(name, pa.string()))
            for name in DECISIONS_COLUMNS
        }
    )
