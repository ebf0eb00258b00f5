"""flushline simulate: scene folders with known truth from a virtual rig and panel."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `simulate`."""
    parser = commands.add_parser(
        "simulate",
        parents=[common],
        help="scene folders with truth.json from a virtual rig and panel",
        description="Renders the scenes of a simulation specification (TOML) and writes their rig beside them, and a "
        "calibration capture where the specification has a [calibration] table.",
    )
    parser.add_argument(
        "spec", metavar="SPEC", help="TOML file, or the name of a specification that ships with Flushline"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Render the scenes."""
    from flows.progress import progress_bar
    from flows.simulate import simulate_capture, simulate_folders
    from simulator.spec import read_spec, shipped_spec

    is_name = Path(options.spec).name == options.spec and not options.spec.endswith(".toml")
    spec = shipped_spec(options.spec) if is_name else read_spec(Path(options.spec))
    with progress_bar(counted=False) as progress:
        bar = progress.add_task("starting", total=1.0)
        folders, rig = simulate_folders(
            spec, options.out, lambda done, what: progress.update(bar, completed=done, description=what)
        )
        capture = None
        if spec.calibration:
            progress.update(bar, completed=0.0, description="calibration capture")
            capture = simulate_capture(
                spec, options.out, lambda done, what: progress.update(bar, completed=done, description=what)
            )
    for folder in folders:
        print(folder)
    print(f"rig: {rig}")
    if capture:
        print(f"calibration capture: {capture}")
    return 0
