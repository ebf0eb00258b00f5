"""The overlays of a whole panel: a folder with one picture per station and a page that leads to them."""

from __future__ import annotations

from pathlib import Path

from storage.archive import Store
from storage.report.markup import badge, moment, page
from storage.report.record import PanelRecord
from storage.report.redrawn import overlay_file
from storage.report.verdicts import gravest
from storage.wording import _, named

INDEX = "index.html"


def write_overlays(store: Store, record: PanelRecord, folder: Path) -> Path:
    """Write the overlays of a panel's newest scans as PNG and SVG, and an index page.

    Returns
    -------
    Path
        The index page.
    """
    folder.mkdir(parents=True, exist_ok=True)
    cards = []
    for scene in record.scenes:
        station = scene.scene["station"]
        for suffix in (".png", ".svg"):
            (folder / f"{station}{suffix}").write_bytes(overlay_file(store, str(scene.scene["scene_id"]), suffix))
        cards.append(
            {
                "station": station,
                "verdict": badge(gravest(scene.features)),
                "captured": moment(scene.scene["captured_at"]),
                "outside": [named(str(name)) for name in scene.manifest.get("outside_overlay") or []],
            }
        )
    index = folder / INDEX
    title = _("Overlays of {aircraft} {panel}", aircraft=record.aircraft_serial, panel=record.panel)
    index.write_text(page("overlays.html", title, cards=cards), encoding="utf-8")
    return index
