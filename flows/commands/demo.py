"""flushline demo: simulate a panel, inspect it, show what was found."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `demo`."""
    parser = commands.add_parser(
        "demo",
        parents=[common],
        help="simulate a panel, inspect it, show what was found",
        description="Renders a scan of a virtual panel, inspects it and prints what was found beside what is true.",
    )
    parser.add_argument("--out", type=Path, default=Path("demo"), metavar="DIR", help="default: ./demo")
    parser.add_argument("--keep", action="store_true", help="use the scan that an earlier demo rendered there")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the demonstration."""
    from flows.demo import run_demo

    return run_demo(options.out, options.keep)
