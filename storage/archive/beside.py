"""What the tables say that are not in the index but follow from what lies beside it, for those who describe them.

Who only asks for one of them by name need not load them all: see `storage.archive.tables_beside`.
"""

from __future__ import annotations

from collections.abc import Mapping

from storage.archive.decision_tables import DECISIONS_COLUMNS, DISPOSITIONS_COLUMNS, MARKS_COLUMNS
from storage.archive.limit_tables import LIMITS_COLUMNS
from storage.archive.schema import Column, Table
from storage.evidence.rig_tables import RIGS_COLUMNS, VERIFICATIONS_COLUMNS


def _table(name: str, comment: str, columns: Mapping[str, str]) -> Table:
    return Table(name, comment, tuple(Column(column, "", meaning) for column, meaning in columns.items()))


TABLES_BESIDE = (
    _table("decisions", "Everything that people decided, from the first entry on", DECISIONS_COLUMNS),
    _table("dispositions", "The last disposition of each feature that has one", DISPOSITIONS_COLUMNS),
    _table("limits", "Each limit of the specifications that scans and panels were judged by", LIMITS_COLUMNS),
    _table("marks", "Fasteners that people marked as false or missed", MARKS_COLUMNS),
    _table("rigs", "Each calibration with its last verification, and what is due when", RIGS_COLUMNS),
    _table("verifications", "Each measure of each verification of a rig", VERIFICATIONS_COLUMNS),
)
"""Types of their columns are not told."""
