"""flushline capture check: what cameras took, before it is measured."""

from __future__ import annotations

import argparse
from pathlib import Path

from flows.code_options import add_code_options


def add_check(actions: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `capture check`."""
    check = actions.add_parser(
        "check",
        parents=[common],
        help="whether frames are fit to be measured, and what to change",
        description="Judges exposure, modulation, noise and the projector's linearity of each folder of frames. Exit "
        "code 0: good, or could be improved; 1: not usable; 2: bad input.",
    )
    check.add_argument("frames", type=Path, nargs="+", metavar="FRAMES", help="scene folders, or folders of frames")
    check.add_argument("--pattern", help="names of the frames as for `scene new`: '{camera}_{frame}.png'")
    check.add_argument("--gray-pattern", help="Gray code beside such fringes: '{camera}/g{bit}.png'")
    check.add_argument("--sequence", nargs="+", help="what {frame} runs through: fringes gray white black skip:N")
    check.add_argument("--left", metavar="NAME", help="what {camera} is of the left camera")
    check.add_argument("--cameras", choices=("turns", "halves"), help="how both share {frame}, without {camera}")
    check.add_argument(
        "--labels", nargs="+", default=[], help="what {count} is of each count, in the order of --counts"
    )
    check.add_argument("--axis", choices=("x", "y"), default="x", help="x: fringes change along columns (default)")
    add_code_options(check)
    check.set_defaults(run=run_check)


def run_check(options: argparse.Namespace) -> int:
    """Say of each folder what is good and what to change."""
    from flows.capture_check import check_frames
    from flows.cli import EXIT_BAD_INPUT, EXIT_DONE, EXIT_SOME_FAILED, print_error
    from metrology.errors import FlushlineError

    verdicts = []
    for folder in options.frames:
        try:
            said, lines = check_frames(folder, options)
        except FlushlineError as problem:
            if options.debug:
                raise
            print_error(str(problem))
            continue
        verdicts.append(said)
        print("\n".join([f"{folder}: {said}", *(f"  {line}" for line in lines)]))
    if not verdicts:
        return EXIT_BAD_INPUT
    return EXIT_SOME_FAILED if "not usable" in verdicts or len(verdicts) < len(options.frames) else EXIT_DONE
