"""flushline capture: patterns on a second screen, two cameras, a scene folder."""

from __future__ import annotations

import argparse
from datetime import UTC, datetime
from pathlib import Path

from flows.code_options import add_code_options
from flows.commands.capture_check import add_check

_NEEDED = ("rig", "out", "cameras", "left", "aircraft", "panel", "station")


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `capture` and `capture check`."""
    parser = commands.add_parser(
        "capture",
        parents=[common],
        help="take a scan: patterns on a second screen, GenICam cameras",
        description="Finds the exposures that the skin needs, shows every pattern and takes it with all cameras, takes "
        "again what was dropped, checks order and content, and writes a scene folder. Cancelled, it leaves nothing.",
    )
    parser.add_argument("--rig", type=Path, help="rig file: sizes of cameras and projector, its id")
    parser.add_argument("--out", type=Path, metavar="SCENE", help="the scene folder to write")
    parser.add_argument("--cameras", metavar="DRIVER:…", help="harvester:PRODUCER.cti")
    parser.add_argument("--left", metavar="SERIAL")
    parser.add_argument("--right", metavar="SERIAL", help="none: one camera and the projector")
    parser.add_argument("--trigger", choices=("software", "hardware"), default="software")
    parser.add_argument(
        "--screen-at", type=int, nargs=2, default=(0, 0), metavar=("X", "Y"), help="its upper left corner"
    )
    parser.add_argument("--settle", type=float, default=0.1, metavar="S", help="from drawing to light (default 0.1)")
    parser.add_argument("--exposures", type=float, nargs="+", default=(), metavar="MS", help="by default found")
    parser.add_argument("--aircraft", metavar="SERIAL")
    parser.add_argument("--panel")
    parser.add_argument("--station")
    parser.add_argument("--operator")
    parser.add_argument("--axis", choices=("x", "y"), default="x", help="x: fringes change along columns (default)")
    add_code_options(parser)
    parser.set_defaults(run=run)
    actions = parser.add_subparsers(title="actions", metavar="ACTION", help="without one, a scan is taken")
    add_check(actions, common)


def run(options: argparse.Namespace) -> int:
    """Open what takes the scan, take it, give all back."""
    from flows.capture.acquire import Order, capture
    from flows.capture.devices import open_cameras
    from flows.capture.screen import TkScreen
    from flows.code_options import fringe_model
    from metrology.errors import UsageError
    from metrology.results import SceneKey
    from storage.rig import load_rig

    missing = [f"--{name}" for name in _NEEDED if getattr(options, name) is None]
    if missing:
        raise UsageError(f"capture: found no {', '.join(missing)}, expected them to take a scan")
    rig, code = load_rig(options.rig), fringe_model(options).code
    projector = rig.with_projector()
    key = SceneKey(options.aircraft, options.panel, options.station, datetime.now(UTC).replace(microsecond=0))
    serials = {"left": options.left} | ({"right": options.right} if options.right else {})
    order = Order(key, rig, code, tuple(options.exposures), operator=options.operator)
    cameras = open_cameras(options.cameras, serials, options.trigger == "hardware")
    try:
        screen = TkScreen(
            (projector.width, projector.height), options.screen_at[0], options.screen_at[1], options.settle
        )
        try:
            capture(options.out, order, cameras, screen)
        finally:
            screen.close()
    finally:
        cameras.close()
    print(f"scene: {options.out}")
    return 0
