"""Tables that are not in the index but follow from what lies beside it; a query that names one gets it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import duckdb

_DECISIONS, _RIGS, _LIMITS = {"decisions", "dispositions", "marks"}, {"rigs", "verifications"}, {"limits"}
_NAMED = re.compile(rf"\b({'|'.join([*_DECISIONS, *_RIGS, *_LIMITS])})\b", re.IGNORECASE)


def register_tables(connection: duckdb.DuckDBPyConnection, root: Path, sql: str) -> None:
    """Make what people decided, rigs and limits known to a connection where `sql` names them."""
    named = {name.lower() for name in _NAMED.findall(sql)}
    if named & _DECISIONS:
        from storage.archive.decision_tables import register_decisions

        register_decisions(connection, root, named)
    if named & _RIGS:
        from storage.evidence.rig_tables import register_rigs

        register_rigs(connection, root, named)
    if named & _LIMITS:
        from storage.archive.limit_tables import register_limits

        register_limits(connection, root)
