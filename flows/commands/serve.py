"""flushline serve: a Prefect deployment that inspects an inbox every night, and whenever it is asked to."""

from __future__ import annotations

import argparse


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `serve`."""
    from flows.commands.run import add_inbox_arguments

    parser = commands.add_parser(
        "serve",
        parents=[common],
        help="inspect an inbox every night and on demand (Prefect)",
        description="Serves the deployment inspect_inbox/NAME until it is stopped: runs by the schedule, and when "
        "someone starts it in Prefect's pages or by 'prefect deployment run inspect_inbox/NAME'. Needs a Prefect "
        "server.",
    )
    add_inbox_arguments(parser, compact=True)
    parser.add_argument("--cron", default="0 2 * * *", help="when, as cron has it (default '0 2 * * *': two at night)")
    parser.add_argument("--timezone", metavar="ZONE", help="of the schedule, such as Europe/Berlin (default UTC)")
    parser.add_argument("--name", default="nightly", help="of the deployment (default nightly)")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Serve until stopped."""
    from flows.commands.run import inbox_job, way_to_run
    from flows.prefect_server import configured_api, provide_home, server_problem
    from metrology.errors import UsageError

    job, way = inbox_job(options), way_to_run(options)
    if options.timezone:
        _check_timezone(options.timezone)
    api = configured_api()
    if not api:
        raise UsageError(
            "serve: found no Prefect server configured, expected PREFECT_API_URL of a running 'prefect server start'"
        )
    if problem := server_problem(api):
        raise UsageError(f"serve: {problem} ('prefect server start')")
    provide_home()
    from flows.prefect_inbox import serve

    return serve(job, way, options.cron, options.timezone, options.name)


def _check_timezone(name: str) -> None:
    from zoneinfo import ZoneInfo

    from metrology.errors import UsageError

    try:
        ZoneInfo(name)
    except (KeyError, ValueError, OSError):  # unknown, a path, a folder of zones
        raise UsageError(
            f"--timezone: found {name!r}, expected the name of a time zone, such as Europe/Berlin or UTC"
        ) from None
