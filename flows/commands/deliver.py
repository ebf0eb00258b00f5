"""flushline deliver: tell web-hooks, folders and object storage what is new in a store."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `deliver`."""
    parser = commands.add_parser(
        "deliver",
        parents=[common],
        help="tell others what is new: web-hooks, folders, object storage",
        description="Delivers what is new to the targets of STORE/deliveries.toml, and tries again what waits; runs "
        "over an inbox do so by themselves. Exit code 0: all is delivered, 1: something waits or was given up.",
    )
    parser.add_argument("--store", type=Path, required=True, metavar="DIR")
    parser.add_argument("--again", action="store_true", help="try also what was given up, and do not wait")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Deliver."""
    from flows.cli import EXIT_DONE, EXIT_SOME_FAILED, print_error
    from flows.deliver import deliver
    from metrology.errors import UsageError
    from storage.archive.store import Store
    from storage.export.deliveries import CONFIGURATION, Record, load_targets

    store = Store(options.store)
    root = store.existing().root
    if not load_targets(root):
        raise UsageError(f"{root / CONFIGURATION}: found no targets, expected some; docs/exports.md shows them")
    if options.again:
        Record(root).revive()
    found = deliver(store)
    for problem in found.problems:
        print_error(problem)
    print(f"{found.sent} delivered, {found.waiting} waiting, {found.dead} given up")
    return EXIT_SOME_FAILED if found.waiting or found.dead else EXIT_DONE
