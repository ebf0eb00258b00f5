"""What a disk or a stranger does to a store."""

from __future__ import annotations

from pathlib import Path

import duckdb

from storage.archive import Store


def spoil(path: Path) -> None:
    """Flip the bits of one byte in the middle of a file."""
    path.chmod(0o644)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)


def forge(store: Store, sql: str) -> None:
    """Change the published index behind Flushline's back."""
    path = store.layout.archive.resolve()
    path.chmod(0o644)
    with duckdb.connect(str(path)) as connection:
        connection.execute(sql)
