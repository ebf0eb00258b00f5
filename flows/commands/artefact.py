"""flushline artefact: an artefact to be made: description, drawing, print, simulation."""

from __future__ import annotations

import argparse
from pathlib import Path

NAMES = ("plane", "ball-bar", "rivet-plate", "step-plate", "gap-plate", "board")


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `artefact`."""
    parser = commands.add_parser(
        "artefact",
        parents=[common],
        help="an artefact to make: description, drawing, simulation",
        description="Writes an artefact's description (TOML, to be completed with its certificate), its drawing (DXF "
        "and SVG) or the board's print (SVG), and a simulation of its scans. The drawings are ours, and free to copy.",
    )
    parser.add_argument("name", choices=NAMES, metavar="NAME", help=", ".join(NAMES))
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Write the files."""
    from flows.artefact import write_artefact

    for path in write_artefact(options.name, options.out):
        print(path)
    return 0
