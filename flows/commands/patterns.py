"""flushline patterns: the images that the projector must show."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from flows.code_options import add_code_options

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from storage.scene_models import FringeModel


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `patterns`."""
    parser = commands.add_parser(
        "patterns",
        parents=[common],
        help="the images that the projector must show",
        description="Writes one 8-bit PNG per fringe frame, named by count and step, in the order of scene.json, "
        "and the projector's white and black for calibration. With --recommend it only says which fringe counts suit a "
        "projector and a camera's noise.",
    )
    task = parser.add_mutually_exclusive_group(required=True)
    task.add_argument("--out", type=Path, metavar="DIR", help="write the images there")
    task.add_argument(
        "--recommend",
        type=float,
        nargs=2,
        metavar=("NOISE", "MODULATION"),
        help="rank fringe counts for a sample's noise and the fringe amplitude where the skin is darkest, grey levels",
    )
    parser.add_argument("--size", type=int, nargs=2, default=(1280, 800), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--axis", choices=("x", "y"), default="x", help="x: fringes change along columns (default)")
    add_code_options(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Write the patterns, or recommend their counts."""
    return _recommend(options) if options.recommend else _write(options)


def _recommend(options: argparse.Namespace) -> int:
    from rich.console import Console
    from rich.table import Table

    from metrology.fringe_choice import recommend_counts

    noise, modulation = options.recommend
    size = options.size[0 if options.axis == "x" else 1]
    table = Table("counts", "σ [projector px]", "wrong orders", "margin [rad]", "heterodyne")
    for choice in recommend_counts(size, noise, modulation, steps=options.steps[0], counts=len(options.counts)):
        table.add_row(
            " ".join(map(str, choice.counts)),
            f"{choice.sigma_px:.4f}",
            f"{choice.slip_probability:.1e}",
            f"{choice.margin_rad:.3f}",
            "yes" if choice.heterodyne else "no",
        )
    Console().print(table)
    return 0


def _write(options: argparse.Namespace) -> int:
    import json

    import numpy as np

    from flows.code_options import frame_names, fringe_model
    from metrology.errors import UsageError
    from storage.frames import write_frame

    width, height = options.size
    if not (0 < width <= 16384 and 0 < height <= 16384):
        raise UsageError(f"--size: found {width} {height}, expected 1 to 16384 pixels each")
    shown = fringe_model(options)
    code = shown.code
    frames = np.rint(255 * _images(shown, width, height)).astype(np.uint8)
    options.out.mkdir(parents=True, exist_ok=True)
    names = frame_names(code)
    listed = np.argsort(shown.ordered(range(code.frames)))  # as it is shown, from Flushline's own order
    for place, frame in enumerate(listed):
        number = f"{place:03d}_" if _out_of_order(shown) else ""
        write_frame(options.out / f"{number}{names[frame]}.png", frames[frame])
    document = shown.model_dump(mode="json", exclude_defaults=True)
    (options.out / "fringe.json").write_text(json.dumps(document), encoding="utf-8")
    for name, level in (("white.png", 255), ("black.png", 0)):
        write_frame(options.out / name, np.full((height, width), level, np.uint8))
    print(f"{len(names)} patterns, white and black in {options.out}; fringe.json there says what scene.json is to say")
    return 0


def _images(shown: FringeModel, width: int, height: int) -> NDArray[np.float64]:
    """(frames, height, width) values from 0 to 1, in Flushline's order."""
    from metrology.binary_code import binary_from_gray

    code = shown.code
    images = code.patterns(width, height)
    if not (shown.gray and shown.gray.binary):
        return images
    lines = images[:, 0] if code.axis == "x" else images[:, :, 0]
    turned = binary_from_gray(lines, code)
    return turned[:, None, :].repeat(height, 1) if code.axis == "x" else turned[:, :, None].repeat(width, 2)


def _out_of_order(shown: FringeModel) -> bool:
    """Whether the patterns are shown in another order than that of their names."""
    return shown.direction < 0 or bool(shown.gray and (shown.gray.first == "lsb" or shown.gray.inverse_first))
