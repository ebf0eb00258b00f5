"""flushline measure: lengths in a scan, against those that are published."""

from __future__ import annotations

import argparse
import math
from pathlib import Path


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `measure`."""
    parser = commands.add_parser(
        "measure",
        parents=[common],
        help="lengths in a scan: between points, spheres, faces, on a board",
        description="Measures lengths in scans and says how far they are off what is stated: nothing else tells the "
        "scale of an imported rig. Exit code 0: all within --within or U95; 1: not all; 2: bad input. U95 is that of "
        "the points' noise. With a certificate and a verdict that is kept: flushline verify.",
    )
    parser.add_argument("scenes", type=Path, nargs="+", metavar="SCENE")
    parser.add_argument("--rig", type=Path, required=True, metavar="RIG")
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument(
        "--points",
        type=_pixel,
        nargs="+",
        metavar="U,V",
        help="distances from each pixel of the left image to the next",
    )
    what.add_argument(
        "--spheres", type=_size, metavar="MM", help="diameters of spheres of about this one, from left to right, and "
        "distances of their centres",
    )  # fmt: skip
    what.add_argument(
        "--faces", type=_box, nargs="+", metavar="U,V,W,H", help="steps from the face in each box of the left image to "
        "the face in the next",
    )  # fmt: skip
    what.add_argument("--board", metavar="BOARD", help="such as chessboard:9x6:25, as `calibrate` has it")
    parser.add_argument("--picture", metavar="FILE", help="in the scan's folder, that shows the board; else the frames")
    parser.add_argument(
        "--expected", type=_number, nargs="+", default=[], metavar="MM", help="lengths, as they are said"
    )
    parser.add_argument(
        "--within", type=_size, default=0.2, metavar="%", help="by how many per cent they may be off (default 0.2)"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Measure in every scan."""
    from flows.cli import EXIT_BAD_INPUT, EXIT_DONE, EXIT_SOME_FAILED
    from flows.measure import checked
    from metrology.errors import UsageError
    from storage.rig import load_rig

    for name in ("points", "faces"):
        if getattr(options, name) and len(getattr(options, name)) < 2:
            raise UsageError(f"--{name}: found one, expected two or more: lengths lie between them")
    measured, held = checked(options.scenes, load_rig(options.rig), options)
    if not measured:
        return EXIT_BAD_INPUT
    return EXIT_DONE if held == len(options.scenes) else EXIT_SOME_FAILED


def _number(text: str) -> float:
    return _parts(text, "a number", 1)[0]


def _size(text: str) -> float:
    value = _number(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"found {text!r}, expected more than 0")
    return value


def _pixel(text: str) -> tuple[float, float]:
    return _parts(text, "column and row such as 812,617", 2)  # type: ignore[return-value]


def _box(text: str) -> tuple[int, int, int, int]:
    return tuple(int(part) for part in _parts(text, "column, row, width, height such as 100,80,60,40", 4))  # type: ignore[return-value]


def _parts(text: str, expected: str, count: int) -> tuple[float, ...]:
    try:
        parts = tuple(float(part) for part in text.split(","))
    except ValueError:
        parts = ()
    if len(parts) != count or not all(map(math.isfinite, parts)):
        raise argparse.ArgumentTypeError(f"found {text!r}, expected {expected}")
    return parts
