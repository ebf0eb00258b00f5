"""SQL queries that people keep beside the archive (`reviews/queries.json`)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

from pydantic import Field

from metrology.errors import StoreError, UsageError
from storage.archive.files import locked, replacing
from storage.documents import read_json
from storage.models import StrictModel, validate

FORMAT = "flushline-queries/1"
MAX_QUERIES = 200


class QueriesModel(StrictModel):
    """queries.json."""

    format: str = FORMAT
    queries: dict[
        Annotated[str, Field(min_length=1, max_length=80)], Annotated[str, Field(min_length=1, max_length=20_000)]
    ] = Field(default_factory=dict)


class SavedQueries:
    """The saved queries of a store.

    Parameters
    ----------
    root : Path
        The store's folder.
    """

    def __init__(self, root: Path) -> None:
        self.path = Path(root) / "reviews" / "queries.json"

    def read(self) -> dict[str, str]:
        """SQL by name."""
        if not self.path.exists():
            return {}
        return dict(validate(QueriesModel, read_json(self.path, StoreError), self.path, StoreError).queries)

    def save(self, name: str, sql: str | None) -> None:
        """Keep a query under a name, in place of one of that name; None forgets it."""
        name = name.strip()
        try:
            self.path.parent.mkdir(exist_ok=True)
            with locked(self.path.parent / ".lock"):
                queries = self.read()
                if sql is None:
                    queries.pop(name, None)
                else:
                    queries[name] = sql
                if len(queries) > MAX_QUERIES:
                    raise UsageError(f"queries: found {len(queries)}, expected at most {MAX_QUERIES}; forget one first")
                document = {"format": FORMAT, "queries": queries}
                validate(QueriesModel, document, self.path, UsageError)
                with replacing(self.path) as partial:
                    partial.write_text(json.dumps(document, indent=1, ensure_ascii=False), encoding="utf-8")
        except OSError as problem:
            raise StoreError(f'{self.path}: found "{problem.strerror}", expected it to be writable') from None
