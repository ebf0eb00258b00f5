"""The table of decisions, the same in SQLite and PostgreSQL.

A row holds the document of an entry as it was written; all else that is asked for is made from it by the database
itself. Triggers refuse to change or remove a row, and to add one that does not follow on the last one.
"""

from __future__ import annotations

from typing import Any

from sqlalchemy import (
    DDL,
    Column,
    Computed,
    Double,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    event,
)
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.expression import ColumnElement

from storage.review_entries import SHOWN_NUMBERS
from storage.review_file import FIRST

SQLITE, POSTGRESQL = "sqlite", "postgresql"


class _Said(ColumnElement[Any]):
    """A part of the document.

    Parameters
    ----------
    path : str
        With a dot between keys.
    kind : "text", "number" or None
        What it must be, else there is nothing; None takes it as it is.
    """

    inherit_cache = True

    def __init__(self, path: str, kind: str | None = None, default: str | None = None) -> None:
        self.path, self.kind, self.default = path, kind, default


@compiles(_Said, SQLITE)
def _said_in_sqlite(element: _Said, *_: Any, **__: Any) -> str:
    value = f"json_extract(document, '$.{element.path}')"
    if element.kind:
        kinds = {"text": "('text')", "number": "('integer', 'real')"}[element.kind]
        value = f"CASE WHEN json_type(document, '$.{element.path}') IN {kinds} THEN {value} END"
    return value if element.default is None else f"coalesce({value}, '{element.default}')"


@compiles(_Said, POSTGRESQL)
def _said_in_postgresql(element: _Said, *_: Any, **__: Any) -> str:
    path = f"'{{{element.path.replace('.', ',')}}}'"
    value = f"document::jsonb #>> {path}"
    if element.kind:
        kind, cast = {"text": ("string", ""), "number": ("number", "::double precision")}[element.kind]
        value = f"CASE WHEN jsonb_typeof(document::jsonb #> {path}) = '{kind}' THEN ({value}){cast} END"
    return value if element.default is None else f"coalesce({value}, '{element.default}')"


def _said(name: str, path: str | None = None, default: str | None = None, **more: Any) -> Column[Any]:
    return Column(name, Text, Computed(_Said(path or name, default=default), persisted=True), **more)


DECISIONS = Table(
    "decisions",
    MetaData(),
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("document", Text, nullable=False),
    Column("checksum", String(64), nullable=False, unique=True),
    _said("format"),
    _said("decided_at", "at"),
    _said("who"),
    _said("action"),
    _said("scene_id"),
    _said("run_id"),
    _said("feature_kind"),
    _said("feature_id"),
    _said("disposition"),
    _said("comment", default=""),
    Column("decided_verdict", Text, Computed(_Said("shown.decision", "text"), persisted=True)),
    *(
        Column(f"decided_{name}", Double, Computed(_Said(f"shown.{name}", "number"), persisted=True))
        for name in SHOWN_NUMBERS
    ),
    _said("previous", unique=True),
    Index("decisions_of_scene", "scene_id", "number"),
    Index("decisions_by_action", "action", "number"),
)
"""In the order of `storage.review_entries.Entry`."""

_NEVER = "an entry of the review log is never changed or removed"
_NEXT = "an entry of the review log has to follow on the last one"
_SQLITE_DDL = (
    *(
        f"CREATE TRIGGER decisions_no_{what.lower()} BEFORE {what} ON decisions "
        f"BEGIN SELECT RAISE(ABORT, '{_NEVER}'); END"
        for what in ("UPDATE", "DELETE")
    ),
    f"""CREATE TRIGGER decisions_in_order BEFORE INSERT ON decisions
    WHEN NEW.number IS NOT coalesce((SELECT max(number) FROM decisions), 0) + 1
        OR json_extract(NEW.document, '$.number') IS NOT NEW.number
        OR json_extract(NEW.document, '$.previous')
            IS NOT coalesce((SELECT checksum FROM decisions ORDER BY number DESC LIMIT 1), '{FIRST}')
    BEGIN SELECT RAISE(ABORT, '{_NEXT}'); END""",
)
_POSTGRESQL_DDL = (
    f"""CREATE FUNCTION decisions_stay() RETURNS trigger LANGUAGE plpgsql AS
    $$ BEGIN RAISE EXCEPTION '{_NEVER}'; END $$""",
    "CREATE TRIGGER decisions_no_change BEFORE UPDATE OR DELETE OR TRUNCATE ON decisions "
    "FOR EACH STATEMENT EXECUTE FUNCTION decisions_stay()",
    f"""CREATE FUNCTION decisions_follow() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
    IF NEW.number IS DISTINCT FROM coalesce((SELECT max(number) FROM decisions), 0) + 1
        OR (NEW.document::jsonb ->> 'number') IS DISTINCT FROM NEW.number::text
        OR (NEW.document::jsonb ->> 'previous')
            IS DISTINCT FROM coalesce((SELECT checksum FROM decisions ORDER BY number DESC LIMIT 1), '{FIRST}')
    THEN RAISE EXCEPTION '{_NEXT}'; END IF; RETURN NEW; END $$""",
    "CREATE TRIGGER decisions_in_order BEFORE INSERT ON decisions FOR EACH ROW EXECUTE FUNCTION decisions_follow()",
)
for _dialect, _statements in ((SQLITE, _SQLITE_DDL), (POSTGRESQL, _POSTGRESQL_DDL)):
    for _statement in _statements:
        event.listen(DECISIONS, "after_create", DDL(_statement).execute_if(dialect=_dialect))
