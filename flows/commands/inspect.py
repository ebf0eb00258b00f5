"""flushline inspect: one or many scenes into a store."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `inspect`."""
    parser = commands.add_parser(
        "inspect",
        parents=[common],
        help="inspect scenes and keep what is found",
        description="Inspects scene folders and stores the results. Exit code 0: all stored, 1: some failed and the "
        "others are stored, 2: none could be inspected and the store is as it was.",
    )
    parser.add_argument("scenes", type=Path, nargs="+", metavar="SCENE", help="scene folder")
    parser.add_argument("--store", type=Path, required=True, metavar="DIR")
    parser.add_argument(
        "--rig", type=Path, metavar="FILE", help="rig file; without it the store's rig that a scene names"
    )
    parser.add_argument("--panel-spec", type=Path, metavar="FILE", help="tolerances (TOML); without it example limits")
    parser.add_argument("--settings", type=Path, metavar="FILE", help="settings of the steps (TOML)")
    parser.add_argument(
        "--server", action="store_true", help="run as a Prefect flow, starting a server where none is set up"
    )
    parser.add_argument(
        "--overlays", type=Path, metavar="DIR", help="write each overlay here, too, before its scene is stored"
    )
    parser.add_argument(
        "--no-panel", action="store_true", help="do not put the panels of these scenes together in the end"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Inspect the scenes."""
    from flows.inspect_many import Inputs, inspect_many

    return inspect_many(
        Inputs(
            options.scenes,
            options.store,
            options.rig,
            options.panel_spec,
            options.settings,
            not options.no_panel,
            options.overlays,
        ),
        use_server=options.server,
        debug=options.debug,
    )
