"""The archive: immutable bundles that hold the truth, and an index of them that anyone can query."""

from storage.archive.store import Store

__all__ = ["Store"]
