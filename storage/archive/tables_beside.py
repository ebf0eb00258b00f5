"""Tables that are not in the index but follow from what lies beside it; a query that names one gets it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import duckdb


def register_tables(connection: duckdb.DuckDBPyConnection, root: Path, sql: str) -> None:
    """Make what people decided, and the rigs with their verifications, known to a connection where `sql` names them."""
    from storage.archive.decision_tables import register_decisions
    from storage.evidence.rig_tables import register_rigs

    register_decisions(connection, root, sql)
    register_rigs(connection, root, sql)
