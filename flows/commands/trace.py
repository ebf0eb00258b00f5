"""flushline trace: everything that a stored value rests on."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `trace`."""
    parser = commands.add_parser(
        "trace",
        parents=[common],
        help="everything that a stored value rests on",
        description="Prints the chain of a value: scene, frames, rig, calibration, verification, software, settings, "
        "specification, limits, decision, sign-off. Exit code 0: whole; 1: a link is missing, and named.",
    )
    parser.add_argument("feature", metavar="FEATURE", help="SCENE_ID/FEATURE_ID, or FEATURE_ID of a newest scan")
    parser.add_argument("--store", type=Path, required=True, metavar="DIR")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Print the chain."""
    from flows.cli import EXIT_DONE, EXIT_SOME_FAILED
    from storage.archive import Store
    from storage.documents import printable
    from storage.evidence.chain import missing, trace

    links = trace(Store(options.store), options.feature)
    width = max(len(link.name) for link in links)
    for link in links:
        print(printable(f"{link.name:<{width}}  {'MISSING: ' if link.missing else ''}{link.said}"))
    gaps = missing(links)
    print(f"the chain lacks: {', '.join(gaps)}" if gaps else "the chain is whole")
    return EXIT_SOME_FAILED if gaps else EXIT_DONE
