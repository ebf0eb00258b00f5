"""What the values of an export rest on, scan by scan, as a sheet of a workbook."""

from __future__ import annotations

from storage.archive.store import Store
from storage.evidence.chain import scene_links, sign_off_link, sources_of
from storage.export.subject import Subject
from storage.export.workbook import Sheet, SheetColumn

_COLUMNS = (
    SheetColumn("scene_id"),
    SheetColumn("link", meaning="of the chain from a value back to the calibration"),
    SheetColumn("missing", meaning="whether the link is not there"),
    SheetColumn("what it is", meaning="of a missing link: why, and what would close it"),
)


def traceability_sheet(subject: Subject, store: Store) -> Sheet:
    """The chain of every scan of a subject, as `flushline trace` prints it."""
    rows = [
        (found.scene["scene_id"], link.name, "missing" if link.missing else "", link.said)
        for found in sources_of(store, [scene.row for scene in subject.scenes])
        for link in (*scene_links(found), sign_off_link(found))
    ]
    return Sheet("traceability", _COLUMNS, rows)
