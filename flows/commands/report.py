"""flushline report: a scene or a panel as PDF or one HTML page, and its rows as CSV."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flows.commands.language import add_language, wording_in

if TYPE_CHECKING:
    from storage.archive import Store
    from storage.archive.schema import Table
    from storage.report import Report


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `report`."""
    parser = commands.add_parser(
        "report",
        parents=[common],
        help="a scene or a panel as PDF or one HTML page",
        description="Writes pictures, values, verdicts and what they rest on as PDF, or as one HTML page that needs "
        "nothing else: of a scene, or of a panel: as it is assembled, else station by station. "
        "'flushline report verify FILE' says whether a report is as it was written, and with --store whether the store "
        "says the same.",
    )
    parser.add_argument(
        "what", nargs="*", metavar="SCENE_ID | verify FILE", help="a scene, as the table scenes has it; or a report"
    )
    parser.add_argument("--aircraft", metavar="SERIAL", help="with --panel: a whole panel")
    parser.add_argument("--panel", metavar="PANEL")
    parser.add_argument("--stations", action="store_true", help="a panel station by station, with their pictures")
    parser.add_argument("--store", type=Path, metavar="DIR")
    parser.add_argument("--out", type=Path, metavar="FILE", help=".pdf, else HTML")
    add_language(parser)
    parser.add_argument("--csv", action="store_true", help="write FILE-rivets.csv and its like beside it")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Write a report, or verify one."""
    from metrology.errors import UsageError
    from storage.archive import Store

    what: list[str] = options.what
    if what[:1] == ["verify"]:
        return _verify(options, what[1:])
    if options.store is None or options.out is None:
        raise UsageError("report: found no --store DIR or no --out FILE, expected both")
    report = _report(options, Store(options.store))
    written = report.file(options.out.suffix)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_bytes(written)
    print(options.out)
    if options.csv:
        _write_csv(options.out, report.of_kinds, report.tables)
    return 0


def _report(options: argparse.Namespace, store: Store) -> Report:
    from metrology.errors import UsageError
    from metrology.results import PanelKey
    from storage.report import panel_report, scene_report

    if len(options.what) == 1 and not (options.aircraft or options.panel):
        return scene_report(store, options.what[0], wording_in(options.language))
    if options.aircraft and options.panel and not options.what:
        return panel_report(
            store, PanelKey(options.aircraft, options.panel), options.stations, wording_in(options.language)
        )
    raise UsageError("report: expected a SCENE_ID, or --aircraft SERIAL and --panel PANEL, or verify FILE")


def _verify(options: argparse.Namespace, files: list[str]) -> int:
    from metrology.errors import UsageError
    from storage.archive import Store
    from storage.report import verify

    if len(files) != 1 or options.out or options.aircraft or options.panel:
        raise UsageError(f"report verify: found {len(files)} files or further options, expected one FILE and --store")
    print(verify(Path(files[0]), Store(options.store) if options.store else None))
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
