"""flushline overlay: the image to project for a scene."""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `overlay`."""
    parser = commands.add_parser("overlay", parents=[common], help="the projector image of an inspected scene")
    parser.add_argument("scene_id", metavar="SCENE_ID", help="as the table scenes has it")
    parser.add_argument("--store", type=Path, required=True, metavar="DIR")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="PNG, or SVG by its ending")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Copy the overlay out of the scene's bundle."""
    from metrology.errors import StoreError
    from storage.archive.store import Store

    overlay = Store(options.store).paths(options.scene_id).overlay
    source = overlay.with_suffix(".svg") if options.out.suffix.lower() == ".svg" else overlay
    if not source.is_file():
        raise StoreError(f"{source}: found no such file, expected the scene's overlay; the bundle is damaged")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, options.out)
    print(options.out)
    return 0
