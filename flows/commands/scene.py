"""flushline scene: scene folders from other programs' frames, and what the frames say of their code."""

from __future__ import annotations

import argparse
from datetime import UTC, datetime
from pathlib import Path

from flows.code_options import add_code_options


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `scene new` and `scene guess`."""
    parser = commands.add_parser("scene", help="make scene folders of other programs' frames")
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    new = actions.add_parser(
        "new",
        parents=[common],
        help="write scene.json for a folder of frames",
        description="Finds the frames by their names, finds out what the code's conventions are, writes scene.json and "
        "a picture of what was understood. Frames that contradict each other are refused.",
    )
    new.add_argument("folder", type=Path, metavar="FOLDER")
    new.add_argument("--pattern", required=True, help="such as '{camera}/f{count}_{step}.png', '{camera}_{frame}.bmp'")
    new.add_argument("--gray-pattern", help="Gray code beside such fringes: '{camera}/g{bit}.png'")
    new.add_argument("--sequence", nargs="+", help="what {frame} runs through: fringes gray white black skip:N")
    new.add_argument("--left", metavar="NAME", help="what {camera} is of the left camera")
    new.add_argument("--labels", nargs="+", default=[], help="what {count} is of each count, in the order of --counts")
    new.add_argument("--rig", required=True, metavar="ID")
    new.add_argument("--aircraft", default="TRIAL", metavar="SERIAL")
    new.add_argument("--panel", default="P1")
    new.add_argument("--station", default="S1")
    new.add_argument("--captured-at", default=None, metavar="TIME", help="ISO 8601 with zone; by default the files'")
    new.add_argument("--axis", choices=("x", "y"), default="x", help="x: fringes change along columns (default)")
    new.add_argument("--as-declared", action="store_true", help="keep offsets, direction and borders as they are given")
    new.add_argument("--sheet", type=Path, metavar="PNG", help="picture of what was understood; by default in FOLDER")
    add_code_options(new)
    new.set_defaults(run=run_new)
    guess = actions.add_parser("guess", parents=[common], help="what the frames of a scene say of their code")
    guess.add_argument("folder", type=Path, metavar="SCENE")
    guess.set_defaults(run=run_guess)


def run_new(options: argparse.Namespace) -> int:
    """Find the frames, find the code's conventions, write scene.json and the contact sheet."""
    from flows.code_options import fringe_model
    from flows.new_scene import describe_scene, frames_by_name, new_scene

    shown = fringe_model(options)
    listed, notes = frames_by_name(options, shown.code)
    captured = options.captured_at or datetime.fromtimestamp(
        max(path.stat().st_mtime for path in listed["left"]), UTC
    ).isoformat(timespec="seconds")
    key = (options.aircraft, options.panel, options.station, captured)
    made = new_scene(options.folder, key, options.rig, shown, listed, guess=not options.as_declared)
    for line in [*dict.fromkeys(notes), *made]:
        print(line)
    for line in describe_scene(options.folder, options.sheet or options.folder / "contact-sheet.png"):
        print(line)
    return 0


def run_guess(options: argparse.Namespace) -> int:
    """Say what each camera's frames tell."""
    from flows.new_scene import guess_lines, guesses
    from storage.scene import MANIFEST, load_manifest

    model = load_manifest(options.folder / MANIFEST)
    paths = {
        camera: [options.folder / path for path in getattr(model.frames, camera)[0]] for camera in ("left", "right")
    }
    for line in guess_lines(guesses(model.fringe.code, paths)):
        print(line)
    return 0
