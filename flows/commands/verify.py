"""flushline verify: whether a rig measures an artefact as its certificate says."""

from __future__ import annotations

import argparse
from pathlib import Path

from flows.commands.language import add_language, wording_in


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `verify`."""
    parser = commands.add_parser(
        "verify",
        parents=[common],
        help="whether a rig measures an artefact as its certificate says",
        description="Measures an artefact (plane, spheres, rivet plate, step plate, gap plate, board), compares it "
        "with its certificate, judges by the limits stated, and keeps result and report in the store. "
        "Exit code 0: the rig passed; 1: it did not; 2: bad input, nothing is kept.",
    )
    parser.add_argument(
        "scans", type=Path, nargs="+", metavar="SCANS", help="scene folders, one per position; of a board its capture"
    )
    parser.add_argument("--artefact", type=Path, required=True, metavar="FILE", help="artefact (TOML)")
    parser.add_argument("--rig", type=Path, required=True, metavar="FILE", help="rig file")
    parser.add_argument("--store", type=Path, required=True, metavar="DIR")
    parser.add_argument("--settings", type=Path, metavar="FILE", help="settings of the steps (TOML)")
    parser.add_argument("--operator", default="", help="who scanned, where the scans do not say so")
    parser.add_argument("--place", default="", help="where it was done")
    parser.add_argument("--temperature", type=float, metavar="C", help="of the air, °C")
    add_language(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Verify the rig."""
    from flows.cli import EXIT_DONE, EXIT_SOME_FAILED
    from flows.progress import progress_bar
    from flows.verify import Conditions, Request, verify
    from storage.archive import Store
    from storage.documents import printable
    from storage.wording import written_in
    from tasks.settings import load_settings

    conditions = Conditions(options.operator, options.place, options.temperature)
    request = Request(
        options.scans, options.artefact, options.rig, Store(options.store), load_settings(options.settings), conditions
    )
    with progress_bar() as progress, written_in(wording_in(options.language)):
        bar = progress.add_task("", total=len(options.scans))
        model, path = verify(
            request, lambda done, what: progress.update(bar, completed=done, description=printable(what))
        )
    for measure in model.measures:
        if measure.limit is not None or measure.value is None:
            value = (
                measure.note if measure.value is None else f"{measure.value:+.4f} ± {measure.u95:.4f} {measure.unit}"
            )
            limit = "" if measure.limit is None else f" (permitted {measure.limit:g})"
            print(printable(f"{measure.name} of {measure.of}: {value}{limit}: {measure.decision}"))
    for warning in model.warnings:
        print(printable(f"warning: {warning}"))
    print(printable(f"rig {model.rig_id}: {model.verdict}{f'; {model.reason}' if model.reason else ''}"))
    print(f"report: {path.with_suffix('.html')}")
    return EXIT_DONE if model.held else EXIT_SOME_FAILED
