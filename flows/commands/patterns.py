"""flushline patterns: the images that the projector must show."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `patterns`."""
    parser = commands.add_parser(
        "patterns",
        parents=[common],
        help="the images that the projector must show",
        description="Writes one 8-bit PNG per fringe frame, named by count and step, in the order of scene.json, "
        "and the projector's white and black for calibration.",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--size", type=int, nargs=2, default=(1280, 800), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--axis", choices=("x", "y"), default="x", help="x: fringes change along columns (default)")
    parser.add_argument("--steps", type=int, default=4, help="phase steps per count (default 4)")
    parser.add_argument("--counts", type=int, nargs="+", default=(70, 64, 59), help="fringes across (default 70 64 59)")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Write the patterns."""
    import numpy as np

    from metrology.errors import UsageError
    from metrology.fringe import FringeCode
    from storage.frames import write_frame

    width, height = options.size
    if not (0 < width <= 16384 and 0 < height <= 16384):
        raise UsageError(f"--size: found {width} {height}, expected 1 to 16384 pixels each")
    code = FringeCode(options.axis, options.steps, tuple(options.counts))
    frames = np.rint(255 * code.patterns(width, height)).astype(np.uint8)
    options.out.mkdir(parents=True, exist_ok=True)
    names = [f"{options.axis}_count{n:03d}_step{i + 1}.png" for n in code.counts for i in range(code.steps)]
    for name, frame in zip(names, frames, strict=True):
        write_frame(options.out / name, frame)
    for name, level in (("white.png", 255), ("black.png", 0)):
        write_frame(options.out / name, np.full((height, width), level, np.uint8))
    print(f"{len(names)} fringe patterns, white and black in {options.out}")
    return 0
