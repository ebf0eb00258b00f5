"""flushline run: inspect what is new in an inbox, now."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from flows.inbox_job import InboxJob, Way


def add_inbox_arguments(parser: argparse.ArgumentParser, compact: bool) -> None:
    """What an inbox is inspected with, here and in `serve`.

    Parameters
    ----------
    compact : bool
        Whether the tables are compacted where nothing else is said.
    """
    parser.add_argument("--inbox", type=Path, required=True, metavar="DIR", help="folder of scene folders")
    parser.add_argument("--store", type=Path, required=True, metavar="DIR")
    parser.add_argument(
        "--rig", type=Path, metavar="FILE", help="rig file; without it the store's rig that a scene names"
    )
    parser.add_argument("--panel-spec", type=Path, metavar="FILE", help="tolerances (TOML); without it the store's")
    parser.add_argument("--settings", type=Path, metavar="FILE", help="settings of the steps (TOML)")
    parser.add_argument(
        "--settle",
        type=float,
        default=30.0,
        metavar="S",
        help="leave folders changed less than S seconds ago (default 30)",
    )
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="scenes at a time (default 1)")
    parser.add_argument(
        "--runner",
        choices=("processes", "threads", "dask"),
        default="processes",
        help="what runs scenes side by side; threads and dask need a Prefect server",
    )
    parser.add_argument(
        "--compact",
        action=argparse.BooleanOptionalAction,
        default=compact,
        help=f"write the tables as Parquet when something was inspected (default {'yes' if compact else 'no'})",
    )
    parser.add_argument("--dask-address", metavar="TCP", help="scheduler of a Dask cluster, such as tcp://host:8786")


def inbox_job(options: argparse.Namespace) -> InboxJob:
    """The job that the arguments describe."""
    from flows.inbox_job import InboxJob

    return InboxJob(
        options.inbox,
        options.store,
        options.rig,
        options.panel_spec,
        options.settings,
        options.settle,
        options.compact,
    )


def way_to_run(options: argparse.Namespace) -> Way:
    """How the arguments want scenes run side by side."""
    from flows.inbox_job import Way

    return Way(options.runner, options.workers, options.dask_address)


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `run`."""
    parser = commands.add_parser(
        "run",
        parents=[common],
        help="inspect what is new in an inbox, now",
        description="Inspects the scenes of an inbox that the store does not hold yet with these settings and rig. "
        "Broken ones go to INBOX/quarantine with the reason beside them. Exit code 0: all well, 1: some were broken "
        "or failed.",
    )
    add_inbox_arguments(parser, compact=False)
    parser.add_argument(
        "--server", action="store_true", help="run as a Prefect flow, starting a server where none is set up"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Inspect the inbox."""
    from flows.inbox_command import run_inbox

    return run_inbox(inbox_job(options), way_to_run(options), options.server)
