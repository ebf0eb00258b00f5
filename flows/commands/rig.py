"""flushline rig: check a rig against scenes, find its projector, exchange it with other programs."""

from __future__ import annotations

import argparse
import math
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from metrology.cloud import Reconstruction


_SCALE = "scale: as the files say; no scan tells it, flushline measure does by anything of known size"


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `rig check`, `rig import`, `rig fit-projector` and `rig export`."""
    parser = commands.add_parser("rig", help="check a rig against scenes; import and export OpenCV files")
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    check = actions.add_parser(
        "check",
        parents=[common],
        help="whether a rig still fits scenes",
        description="Tells from scenes whether the rig still is what its calibration says. Exit code 0: it is, or is "
        "warned of; 1: refused by at least one scene; 2: bad input.",
    )
    check.add_argument("rig", type=Path, metavar="RIG")
    check.add_argument("scenes", type=Path, nargs="+", metavar="SCENE")
    check.set_defaults(run=run_check)
    load = actions.add_parser("import", parents=[common], help="a rig file from another program's calibration")
    load.add_argument(
        "files", type=Path, nargs="+", metavar="FILE", help="of OpenCV, MATLAB, Kalibr, ROS and others; COLMAP's folder"
    )
    load.add_argument("--out", type=Path, required=True, metavar="RIG")
    load.add_argument("--id", required=True, metavar="ID")
    load.add_argument("--size", type=parse_size, metavar="WxH", help="camera images, where the files do not tell")
    load.add_argument("--right-size", type=parse_size, metavar="WxH", help="of the right camera, where it differs")
    load.add_argument("--unit", help="of the translations: mm, cm, m, in, or millimetres of one")
    load.add_argument(
        "--names",
        type=_given_name,
        nargs="+",
        default=[],
        metavar="M1=NAME",
        help="what M1, D1, M2, D2, R, T are called, where their names do not tell",
    )
    load.add_argument("--projector-size", type=parse_size, metavar="WxH", help="where the files tell only its lens")
    load.add_argument(
        "--calibrated-at",
        metavar="TIME",
        help="ISO 8601 with zone; by default when the newest of the files was written",
    )
    load.add_argument("--projector-of", type=Path, metavar="RIG", help="rig file to take the projector from")
    load.set_defaults(run=run_import)
    fit = actions.add_parser(
        "fit-projector",
        parents=[common],
        help="find the projector of a rig from scans",
        description="Finds the projector of a rig whose cameras are calibrated, from scans of anything with depth, and "
        "writes the rig with it. Fringes along both axes tell all of it; along one, its columns or its rows.",
    )
    fit.add_argument("scenes", type=Path, nargs="+", metavar="SCENE")
    fit.add_argument("--rig", type=Path, required=True, metavar="RIG", help="rig file with the cameras")
    fit.add_argument("--size", type=parse_size, metavar="WxH", help="of the projector; by default of the rig's own one")
    fit.add_argument("--out", type=Path, required=True, metavar="RIG", help="rig file to write")
    fit.add_argument("--id", metavar="ID", help="the rig's new id; by default the one it has")
    fit.set_defaults(run=run_fit)
    save = actions.add_parser("export", parents=[common], help="an OpenCV FileStorage file from a rig file")
    save.add_argument("rig", type=Path, metavar="RIG")
    save.add_argument("--out", type=Path, required=True, metavar="FILE", help="its ending chooses XML, YAML or JSON")
    save.set_defaults(run=run_export)


def run_check(options: argparse.Namespace) -> int:
    """Check the rig by every scene."""
    from flows.cli import EXIT_BAD_INPUT, EXIT_DONE, EXIT_SOME_FAILED, print_error
    from metrology.errors import FlushlineError
    from storage.rig import load_rig
    from tasks.rig_check import check_scene

    rig = load_rig(options.rig)
    refused = checked = 0
    for folder in options.scenes:
        try:
            health, cloud = check_scene(rig, folder)
        except FlushlineError as problem:
            if options.debug:
                raise
            print_error(str(problem))
            continue
        checked += 1
        refused += health.verdict == "refused"
        print(
            f"{folder}: {health.verdict}; epipolar RMS {_pixels(health.epipolar_rms_px)} "
            f"(systematic {_pixels(health.epipolar_drift_px)}, {health.n} patches), "
            f"projector {_pixels(health.projector_rms_px)} ({health.projector_n} blocks)"
        )
        if health.reason:
            print(f"  {health.reason}")
        if health.verdict == "unjudged":
            print("  without texture, cameras exchanged or another calibration look the same: scan print or grain once")
        if rig.projector is None and health.epipolar_drift_px is not None and health.verdict != "refused":
            print(f"  {_not_told(cloud, health.epipolar_drift_px)}")
    if checked == 0:
        return EXIT_BAD_INPUT
    return EXIT_SOME_FAILED if refused or checked < len(options.scenes) else EXIT_DONE


def _not_told(cloud: Reconstruction, drift_px: float) -> str:
    """What a scan of two cameras does not show of their rig."""
    from metrology.rig_health import HealthSettings
    from metrology.rig_hidden import hidden_errors

    said = {one.name: one for one in hidden_errors(cloud, max(HealthSettings().epipolar_floor_px, drift_px))}
    yaw, focal = said.get("yaw"), said.get("focal lengths")
    parts = [f"a yaw below {math.degrees(yaw.amount):.2g}° (lengths {yaw.lengths:.1%} off)"] if yaw else []
    parts += [f"both focal lengths off by up to {focal.amount:.1%} (lengths {focal.lengths:.1%})"] if focal else []
    parts.append("a wrong distance between the cameras (all lengths)")
    return f"not shown by this scan: {', '.join(parts)}; flushline measure tells by anything of known size"


def run_import(options: argparse.Namespace) -> int:
    """Read other programs' files, write a rig file."""
    from dataclasses import replace

    from metrology.rig import PROJECTOR_OF
    from metrology.rig_plausibility import rig_facts
    from storage.documents import utc_text
    from storage.opencv_rig import READ_OTHERWISE, load_opencv_rig
    from storage.rig import load_rig, save_rig

    other = load_rig(options.projector_of) if options.projector_of else None
    moment = _calibrated_at(options)
    rig = load_opencv_rig(
        options.files,
        options.id,
        utc_text(moment.replace(microsecond=0)),
        options.size,
        options.unit,
        other.projector if other else None,
        options.projector_size,
        options.right_size,
        dict(options.names),
    )
    if other and rig.projector is other.projector:
        rig = replace(rig, extra={**rig.extra, PROJECTOR_OF: other.id})
    save_rig(rig, options.out)
    if said := rig.extra.get(READ_OTHERWISE):
        print(f"note: {said}")
    print("\n".join([*rig_facts(rig), _SCALE, str(options.out)]))
    return 0


def _calibrated_at(options: argparse.Namespace) -> datetime:
    """As it is said, or when the newest of the files was written; now, where there is none of them."""
    from metrology.errors import UsageError
    from metrology.moments import moment_of

    if options.calibrated_at:
        try:
            return moment_of(options.calibrated_at)
        except ValueError as problem:
            raise UsageError(f"--calibrated-at: found {problem}, expected ISO 8601 with zone") from None
    written = [path.stat().st_mtime for path in options.files if path.exists()]
    return datetime.fromtimestamp(int(max(written)), UTC) if written else datetime.now(UTC)


def run_fit(options: argparse.Namespace) -> int:
    """Fit the projector to the scans, write the rig with it."""
    from flows.fit_projector import describe_fit, fit_to_scenes
    from storage.rig import load_rig, save_rig

    rig, fitted = fit_to_scenes(load_rig(options.rig), options.scenes, options.size, options.id)
    save_rig(rig, options.out)
    for line in [*describe_fit(fitted), f"rig: {options.out}"]:
        print(line)
    return 0


def run_export(options: argparse.Namespace) -> int:
    """Read a rig file, write OpenCV's."""
    from storage.opencv_rig import save_opencv_rig
    from storage.rig import load_rig

    save_opencv_rig(load_rig(options.rig), options.out)
    print(options.out)
    return 0


def parse_size(text: str) -> tuple[int, int]:
    """Width and height, such as 1624x1234."""
    match = re.fullmatch(r"(\d+)[xX×](\d+)", text)
    if not match:
        raise argparse.ArgumentTypeError(f"found {text!r}, expected width and height such as 1624x1234")
    return int(match[1]), int(match[2])


def _given_name(text: str) -> tuple[str, str]:
    """What a value is, and what it is called, such as M1=CM1."""
    key, equals, name = text.partition("=")
    if not (key and equals and name):
        raise argparse.ArgumentTypeError(f"found {text!r}, expected such as M1=CM1")
    return key, name


def _pixels(value: float | None) -> str:
    return "not measurable" if value is None else f"{value:.4f} px"
