"""flushline report: a scene or a panel as one HTML page, and its rows as CSV."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `report`."""
    parser = commands.add_parser(
        "report",
        parents=[common],
        help="a scene or a panel as one HTML page",
        description="Writes pictures, values, verdicts and what they rest on as one page that needs nothing else: of a "
        "scene, or of the newest scans of a panel's stations.",
    )
    parser.add_argument("scene_id", nargs="?", metavar="SCENE_ID", help="as the table scenes has it")
    parser.add_argument("--aircraft", metavar="SERIAL", help="with --panel: a whole panel")
    parser.add_argument("--panel", metavar="PANEL")
    parser.add_argument("--store", type=Path, required=True, metavar="DIR")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="HTML")
    parser.add_argument("--csv", action="store_true", help="write FILE-rivets.csv and its like beside it")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Write the report."""
    from metrology.errors import UsageError
    from metrology.kinds import KINDS
    from storage.archive import Store
    from storage.archive.schema import OF_KIND
    from storage.report import SceneRecord, panel_page, panel_record, rows_csv, scene_page, scene_record
    from storage.spreadsheet import ENCODING

    store = Store(options.store)
    scenes: tuple[SceneRecord, ...]
    if options.scene_id and not (options.aircraft or options.panel):
        scenes = (scene_record(store, options.scene_id),)
        text = scene_page(scenes[0])
    elif options.aircraft and options.panel and not options.scene_id:
        panel = panel_record(store, options.aircraft, options.panel)
        text, scenes = panel_page(panel), panel.scenes
    else:
        raise UsageError("report: expected a SCENE_ID, or --aircraft SERIAL and --panel PANEL")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(text, encoding="utf-8")
    print(options.out)
    if options.csv:
        for kind in KINDS:
            table, rows = OF_KIND[kind.name], [row for scene in scenes for row in scene.of_kind[kind.name]]
            path = options.out.with_name(f"{options.out.stem}-{table.name}.csv")
            path.write_text(rows_csv(rows, [column.name for column in table.columns]), encoding=ENCODING, newline="")
            print(path)
    return 0
