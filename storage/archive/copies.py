"""Whether the frames of a scan are stored under other names: no two scans have the same, to the last bit."""

from __future__ import annotations

import contextlib

from storage.archive.layout import Layout


def scenes_of_frames(layout: Layout, frames_digest: str | None, but: str) -> tuple[str, ...]:
    """Ids of stored scenes with these frames, the newest first.

    Parameters
    ----------
    frames_digest : str or None
        Names the frames (`storage.scan_identity`); None where nothing does.
    but : str
        Id of the scene that is not to be named.
    """
    import duckdb

    from storage.archive import snapshot

    if frames_digest is None or not layout.archive.exists():
        return ()
    with contextlib.closing(snapshot.connect(layout)) as connection:
        try:
            found = connection.execute(
                "SELECT scene_id FROM scenes WHERE frames_digest = ? AND scene_id <> ? ORDER BY captured_at DESC",
                [frames_digest, but],
            ).fetchall()
        except duckdb.BinderException:  # an index of an older version has no such column
            return ()
    return tuple(scene for (scene,) in found)
