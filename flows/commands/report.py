"""flushline report: a scene or a panel as one HTML page, and its rows as CSV."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from storage.archive.schema import Table


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `report`."""
    parser = commands.add_parser(
        "report",
        parents=[common],
        help="a scene or a panel as one HTML page",
        description="Writes pictures, values, verdicts and what they rest on as one page that needs nothing else: of a "
        "scene, or of a panel: as it is assembled, else station by station.",
    )
    parser.add_argument("scene_id", nargs="?", metavar="SCENE_ID", help="as the table scenes has it")
    parser.add_argument("--aircraft", metavar="SERIAL", help="with --panel: a whole panel")
    parser.add_argument("--panel", metavar="PANEL")
    parser.add_argument("--stations", action="store_true", help="a panel station by station, with their pictures")
    parser.add_argument("--store", type=Path, required=True, metavar="DIR")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="HTML")
    parser.add_argument("--csv", action="store_true", help="write FILE-rivets.csv and its like beside it")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Write the report."""
    from metrology.errors import UsageError
    from metrology.results import PanelKey
    from storage.archive import Store
    from storage.archive.schema import OF_KIND, PANEL_OF_KIND
    from storage.report import (
        assembled_page,
        assembled_record,
        is_assembled,
        panel_page,
        panel_record,
        scene_page,
        scene_record,
    )

    store = Store(options.store)
    if options.scene_id and not (options.aircraft or options.panel):
        scene = scene_record(store, options.scene_id)
        text, of_kinds, tables = scene_page(scene), [scene.of_kind], OF_KIND
    elif options.aircraft and options.panel and not options.scene_id:
        key = PanelKey(options.aircraft, options.panel)
        if is_assembled(store, key) and not options.stations:
            assembled = assembled_record(store, key)
            text, of_kinds, tables = assembled_page(assembled), [assembled.of_kind], PANEL_OF_KIND
        else:
            panel = panel_record(store, options.aircraft, options.panel)
            text, of_kinds, tables = panel_page(panel), [scene.of_kind for scene in panel.scenes], OF_KIND
    else:
        raise UsageError("report: expected a SCENE_ID, or --aircraft SERIAL and --panel PANEL")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(text, encoding="utf-8")
    print(options.out)
    if options.csv:
        _write_csv(options.out, of_kinds, tables)
    return 0


def _write_csv(
    page: Path, of_kinds: Sequence[Mapping[str, Sequence[Mapping[str, Any]]]], tables: Mapping[str, Table]
) -> None:
    """The rows of every kind beside the page."""
    from metrology.kinds import KINDS
    from storage.report import rows_csv
    from storage.spreadsheet import ENCODING

    for kind in KINDS:
        table = tables[kind.name]
        rows = [row for of_kind in of_kinds for row in of_kind[kind.name]]
        path = page.with_name(f"{page.stem}-{table.name}.csv")
        path.write_text(rows_csv(rows, [column.name for column in table.columns]), encoding=ENCODING, newline="")
        print(path)
