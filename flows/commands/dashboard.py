"""flushline dashboard: the pages for the quality engineer."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `dashboard`."""
    parser = commands.add_parser(
        "dashboard",
        parents=[common],
        help="pages to look at results, review and dispose",
        description="Serves the dashboard of a store until it is stopped. Without a configured log-in it can be "
        "reached from this computer only.",
    )
    parser.add_argument("--store", type=Path, required=True, metavar="DIR")
    parser.add_argument("--port", type=int, default=8501)
    parser.add_argument("--address", default="localhost", help="where to listen; other than localhost needs a log-in")
    parser.add_argument(
        "--settings", type=Path, metavar="FILE", help="roles, numbers and dates; default: dashboard.toml in the store"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Serve the dashboard."""
    from dashboard.launch import LOOPBACK, check_address, login_is_configured, serve
    from dashboard.settings import read_settings
    from metrology.errors import UsageError
    from storage.archive.store import Store

    if not 0 < options.port < 65536:
        raise UsageError(f"--port: found {options.port}, expected 1 … 65535")
    Store(options.store).existing()
    read_settings(options.store, options.settings)
    login = login_is_configured(Path.cwd())
    check_address(options.address, login)
    if options.address in LOOPBACK and not login:
        print("no log-in is configured: the dashboard can be reached from this computer only", file=sys.stderr)
    print(f"dashboard of {options.store}: http://{options.address}:{options.port}", file=sys.stderr)
    serve(options.store, options.port, options.address, options.settings)
