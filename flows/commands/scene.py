"""flushline scene: scene folders from other programs' frames or clouds, and what the frames say of their code."""

from __future__ import annotations

import argparse
from datetime import UTC, datetime
from pathlib import Path

from flows.code_options import add_code_options

SEQUENCE = "what {frame} or {path} runs through: fringes fringes-by-step gray inverse white black skip:N"


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `scene new`, `scene from-cloud` and `scene guess`."""
    parser = commands.add_parser("scene", help="make scene folders of other programs' frames and clouds")
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    new = actions.add_parser(
        "new",
        parents=[common],
        help="write scene.json for a folder of frames",
        description="Finds the frames by their names, finds out what the code's conventions are, writes scene.json and "
        "a picture of what was understood. Frames that contradict each other are refused.",
    )
    new.add_argument("folder", type=Path, metavar="FOLDER")
    new.add_argument(
        "--pattern", required=True, help="such as '{camera}/f{count}_{step}.png'; of one camera without {camera}"
    )
    new.add_argument("--gray-pattern", help="Gray code beside such fringes: '{camera}/g{bit}.png'")
    new.add_argument(
        "--sequence",
        nargs="+",
        help=SEQUENCE,
    )
    new.add_argument(
        "--exposures", type=float, nargs="+", metavar="TIME", help="of the {exposure}s; by default as they are named"
    )
    new.add_argument("--left", metavar="NAME", help="what {camera} is of the left camera")
    new.add_argument("--cameras", choices=("turns", "halves"), help="how both share {frame}, without {camera}")
    new.add_argument("--labels", nargs="+", default=[], help="what {count} is of each count, in the order of --counts")
    new.add_argument("--rig", required=True, metavar="ID")
    _add_key_options(new)
    new.add_argument("--axis", choices=("x", "y"), default="x", help="x: fringes change along columns (default)")
    new.add_argument("--as-declared", action="store_true", help="keep offsets, direction and borders as they are given")
    new.add_argument("--replace", action="store_true", help="in place of another scene.json that is there already")
    new.add_argument("--sheet", type=Path, metavar="PNG", help="picture of what was understood; by default in FOLDER")
    add_code_options(new)
    new.set_defaults(run=run_new)
    _add_from_cloud(actions, common)
    guess = actions.add_parser(
        "guess",
        parents=[common],
        help="what the frames of a folder, or of a scene, say of their code",
        description="Of a folder of frames: which names they have, what they show, and the `scene new` that fits. Of a "
        "scene folder: the conventions of its code, as its frames tell them.",
    )
    guess.add_argument("folder", type=Path, metavar="FOLDER")
    guess.set_defaults(run=run_guess)


def _add_key_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--aircraft", default="TRIAL", metavar="SERIAL")
    parser.add_argument("--panel", default="P1")
    parser.add_argument("--station", default="S1")
    parser.add_argument("--captured-at", default=None, metavar="TIME", help="ISO 8601 with zone; by default the files'")


def _add_from_cloud(
    actions: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser
) -> None:
    parser = actions.add_parser(
        "from-cloud",
        parents=[common],
        help="write a scene folder of another scanner's cloud",
        description="Reads an organised cloud (PLY, PCD, E57, npz) or a depth map with its picture, finds the camera "
        "in whose pixels it lies, and writes a scene folder. Points without an order are laid on a grid.",
    )
    parser.add_argument("file", type=Path, metavar="CLOUD")
    parser.add_argument("--out", type=Path, required=True, metavar="SCENE", help="the scene folder to write")
    parser.add_argument("--picture", type=Path, help="of the cloud's pixels; by default the points' own brightness")
    parser.add_argument(
        "--rig", type=Path, help="rig file whose left camera took the picture; with a projector, if any"
    )
    parser.add_argument(
        "--intrinsics", type=float, nargs="+", default=(), metavar="PX", help="fx fy cx cy, then k1 k2 p1 p2 k3"
    )
    parser.add_argument(
        "--grid", type=int, nargs=2, metavar=("COLUMNS", "ROWS"), help="where the file does not tell it"
    )
    parser.add_argument("--unit", help="mm, m, or so many mm; by default m for E57, else mm")
    parser.add_argument("--sigma", type=float, metavar="MM", help="standard deviation of the depths, where it is known")
    parser.add_argument("--operator")
    parser.add_argument("--replace", action="store_true", help="in place of a scene that is there already")
    _add_key_options(parser)
    parser.set_defaults(run=run_from_cloud)


def run_from_cloud(options: argparse.Namespace) -> int:
    """Read the cloud, find its camera, write the scene."""
    from flows.cloud_scene import CloudOrder, new_cloud_scene
    from metrology.errors import SceneError, UsageError
    from metrology.moments import moment_of
    from metrology.results import SceneKey
    from storage.documents import check_regular_file
    from storage.scene_models import MANIFEST

    manifest = options.out / MANIFEST
    if manifest.exists() and not options.replace:
        raise SceneError(f"{manifest}: found a scene there already, expected none: --replace writes it anew")
    units = {"mm": 1.0, "m": 1000.0, "in": 25.4, None: None}
    try:
        mm = units[options.unit] if options.unit in units else float(options.unit)
        captured = moment_of(options.captured_at) if options.captured_at else None
    except ValueError as problem:
        raise UsageError(
            f"found {problem}, expected --unit as mm, m, in or a number, --captured-at as ISO 8601"
        ) from None
    file = check_regular_file(options.file, SceneError)
    captured = captured or datetime.fromtimestamp(int(file.st_mtime), UTC)
    order = CloudOrder(
        options.file,
        options.picture,
        options.rig,
        tuple(options.intrinsics),
        (options.grid[1], options.grid[0]) if options.grid else None,
        mm,
        options.sigma,
    )
    key = SceneKey(options.aircraft, options.panel, options.station, captured)
    for line in new_cloud_scene(options.out, key, order, options.operator):
        print(line)
    return 0


def run_new(options: argparse.Namespace) -> int:
    """Find the frames, find the code's conventions, write scene.json and the contact sheet."""
    from flows.code_options import fringe_model
    from flows.contact_sheet import describe_scene
    from flows.new_scene import exposure_times, frames_by_name, new_scene, untold_labels
    from storage.scene_names import SHEET

    shown = fringe_model(options)
    listed, notes = frames_by_name(options, shown.code)
    captured = options.captured_at or datetime.fromtimestamp(
        max(path.stat().st_mtime for path in listed["left"][0]), UTC
    ).isoformat(timespec="seconds")
    key = (options.aircraft, options.panel, options.station, captured)
    times = exposure_times(options)
    labels = untold_labels(options, shown.code)
    guess = not options.as_declared
    made = new_scene(options.folder, key, options.rig, shown, listed, guess, times, labels, options.replace)
    for line in [*dict.fromkeys(notes), *made]:
        print(line)
    for line in describe_scene(options.folder, options.sheet or options.folder / SHEET):
        print(line)
    return 0


def run_guess(options: argparse.Namespace) -> int:
    """Say what each camera's frames tell; of a folder without scene.json, what it seems to hold."""
    from flows.folder_guess import guess_folder
    from flows.new_scene import guess_lines, guesses
    from storage.scene import load_manifest
    from storage.scene_models import MANIFEST

    if options.folder.is_dir() and not (options.folder / MANIFEST).exists():
        print("\n".join(guess_folder(options.folder)))
        return 0
    model = load_manifest(options.folder / MANIFEST)
    paths: dict[str, list[list[Path]]] = {
        camera: [[options.folder / path for path in paths] for paths in getattr(model.frames, camera)]
        for camera in model.frames.cameras
    }
    for line in guess_lines(guesses(model.fringe.code, paths)):
        print(line)
    return 0
