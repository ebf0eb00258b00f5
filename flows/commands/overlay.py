"""flushline overlay: the image to project for a scene, or those of a whole panel."""

from __future__ import annotations

import argparse
from pathlib import Path

from flows.commands.language import add_language, wording_in


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `overlay`."""
    parser = commands.add_parser(
        "overlay",
        parents=[common],
        help="the projector image of an inspected scene",
        description="Writes the image to project for a scene, or a folder with those of the newest scans of a panel's "
        "stations and an index page.",
    )
    parser.add_argument("scene_id", nargs="?", metavar="SCENE_ID", help="as the table scenes has it")
    parser.add_argument("--aircraft", metavar="SERIAL", help="with --panel: a whole panel")
    parser.add_argument("--panel", metavar="PANEL")
    parser.add_argument("--store", type=Path, required=True, metavar="DIR")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="PATH", help="PNG, or SVG by its ending; a folder for a panel"
    )
    parser.add_argument(
        "--names", action="store_true",
        help="drawn anew, with the names that features have in their assembled panel, or else on their scan",
    )  # fmt: skip
    parser.add_argument(
        "--work", action="store_true", help="drawn anew, with names: only rework, repair and re-scan that is open"
    )
    add_language(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Copy the overlays out of the store."""
    from metrology.errors import UsageError

    if options.aircraft and options.panel and not options.scene_id:
        if options.names or options.work:
            raise UsageError("overlay: found --names or --work with a whole panel, expected them with a SCENE_ID")
        return _panel(options)
    if not options.scene_id or options.aircraft or options.panel:
        raise UsageError("overlay: expected a SCENE_ID, or --aircraft SERIAL and --panel PANEL")
    if options.out.suffix.lower() not in (".png", ".svg"):
        raise UsageError(f"overlay: found the ending {options.out.suffix!r} of {options.out}, expected .png or .svg")
    return _one(options)


def _one(options: argparse.Namespace) -> int:
    from storage.archive.store import Store
    from storage.report.redrawn import encoded, overlay_file, redrawn_overlay
    from storage.wording import written_in

    store, suffix = Store(options.store), options.out.suffix.lower()
    with written_in(wording_in(options.language)):
        anew = options.names or options.work
        drawn = (
            encoded(redrawn_overlay(store, options.scene_id, options.work), suffix)
            if anew
            else overlay_file(store, options.scene_id, suffix)
        )
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_bytes(drawn)
    print(options.out)
    return 0


def _panel(options: argparse.Namespace) -> int:
    from storage.archive.store import Store
    from storage.report import panel_record
    from storage.report.overlays import write_overlays
    from storage.wording import written_in

    store = Store(options.store)
    with written_in(wording_in(options.language)):
        print(write_overlays(store, panel_record(store, options.aircraft, options.panel), options.out))
    return 0
