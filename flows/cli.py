"""The command line `flushline`. Nothing heavy is imported before a command needs it."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence

from metrology.errors import FlushlineError
from storage.documents import printable

EXIT_DONE, EXIT_SOME_FAILED, EXIT_BAD_INPUT = 0, 1, 2
_INTERRUPTED = 130

COMMANDS = (
    "demo",
    "inspect",
    "calibrate",
    "rig",
    "scene",
    "capture",
    "simulate",
    "study",
    "patterns",
    "overlay",
    "report",
    "trace",
    "measure",
    "verify",
    "artefact",
    "panel",
    "query",
    "export",
    "deliver",
    "run",
    "serve",
    "archive",
    "dashboard",
)
"""Modules of flows.commands, in the order of the help."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code: 0 done, 1 some scenes failed, 2 bad input or usage."""
    options = build_parser().parse_args(arguments)
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")  # what OpenCV would say about a bad image, we say in one line
    # Our matrices are small: a second thread of BLAS finds nothing to do and burns the processor while it waits.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        return int(options.run(options))
    except FlushlineError as problem:
        if options.debug:
            raise
        print_error(str(problem))
        return EXIT_BAD_INPUT
    except BrokenPipeError:
        # Whoever read our output has seen enough.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_DONE
    except KeyboardInterrupt:
        print_error("interrupted")
        return _INTERRUPTED
    except Exception as problem:
        if options.debug:
            raise
        print_error(unexpected(problem))
        return EXIT_BAD_INPUT


def build_parser() -> argparse.ArgumentParser:
    """The parser of all commands."""
    parser = argparse.ArgumentParser(
        prog="flushline",
        description="Measures rivet flushness and seam step and gap of aircraft skins from fringe-projection scans.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--debug", action="store_true", help="show where an error comes from")
    for name in COMMANDS:
        importlib.import_module(f"flows.commands.{name}").add_parser(commands, common)
    return parser


def print_error(text: str) -> None:
    """One line on stderr."""
    print(f"error: {printable(text.strip())}", file=sys.stderr)


def unexpected(problem: Exception) -> str:
    """A bug or a surprise of the machine, in one line."""
    if isinstance(problem, OSError) and problem.strerror:
        expected = next((text for kind, text in _EXPECTED.items() if isinstance(problem, kind)), "it to work")
        return f'{problem.filename or "machine"}: found "{problem.strerror}", expected {expected}'
    said = " ".join(str(problem).split())
    return f"unexpected {type(problem).__name__}: {said}; --debug shows where"


_EXPECTED: dict[type[OSError], str] = {
    PermissionError: "to be allowed to",
    FileExistsError: "no such file, or a folder",
    FileNotFoundError: "it to exist",
    NotADirectoryError: "a folder",
    IsADirectoryError: "a file",
}


def counted(count: int, thing: str) -> str:
    """Such as "1 run" or "2 runs"."""
    return f"{count} {thing}{'' if count == 1 else 's'}"


class _Version(argparse.Action):
    """Looks the version up only when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object, **__: object) -> None:
        from importlib.metadata import version

        print(f"flushline {version('flushline')}")
        parser.exit()


if __name__ == "__main__":
    sys.exit(main())
