"""flushline export: a scene, a panel, an aircraft or a query in the formats of other people's systems."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `export`."""
    parser = commands.add_parser(
        "export",
        parents=[common],
        help="files for others: AS9102, Q-DAS, QIF, XLSX, E57 and more",
        description="Writes a scene, the newest scans of a panel or of all panels of an aircraft, or the rows of a "
        "query, in each format that is asked for. docs/exports.md says what goes where.",
    )
    parser.add_argument("scene_id", nargs="?", metavar="SCENE_ID", help="as the table scenes has it")
    parser.add_argument("--aircraft", metavar="SERIAL", help="all its panels, or the one given with --panel")
    parser.add_argument("--panel", metavar="PANEL")
    parser.add_argument("--query", metavar="SQL", help="rows of a query: as xlsx, csv or parquet")
    parser.add_argument("--store", type=Path, required=True, metavar="DIR")
    parser.add_argument(
        "--format",
        action="append",
        required=True,
        metavar="FORMAT",
        dest="formats",
        help="as9102, qdas, qif, xlsx, csv, parquet, e57, las, ply, pcd, glb or stl; may be given several times",
    )
    parser.add_argument("--out", required=True, metavar="TARGET", help="folder, or a URI such as s3://bucket/prefix")
    parser.add_argument(
        "--name", default="query", metavar="NAME", help="begins names of a query's files (default query)"
    )
    parser.add_argument(
        "--decimal",
        choices=("point", "comma"),
        default="point",
        help="of numbers in CSV; comma for German spreadsheets, with semicolons between cells (default point)",
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Write the files."""
    from flows.export import Wanted, export_query, export_subject, formats_for, subjects
    from flows.progress import progress_bar
    from metrology.errors import UsageError
    from storage.archive.store import Store
    from storage.documents import printable

    if Path(options.name).name != options.name:
        raise UsageError(f"--name: found {printable(options.name)!r}, expected a name without folders")
    wanted = Wanted(options.scene_id, options.aircraft, options.panel, options.query)
    formats = formats_for(options.formats, wanted)
    store = Store(options.store)
    if wanted.query is not None:
        for file in export_query(wanted.query, options.name, formats, store, options.out, options.decimal):
            print(file)
        return 0
    found = subjects(store, wanted)
    with progress_bar() as progress:
        bar = progress.add_task("exporting", total=len(found))
        for read in found:
            subject = read()
            progress.update(bar, description=f"exporting {printable(subject.name)}")
            for file in export_subject(subject, formats, store, options.out, options.decimal):
                print(file)
            progress.advance(bar)
    return 0
