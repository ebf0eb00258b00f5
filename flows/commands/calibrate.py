"""flushline calibrate: cameras and projector from pictures of a board."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from flows.code_options import add_code_options, both_fringe_models

if TYPE_CHECKING:
    from flows.calibrate import Calibrated


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser], common: argparse.ArgumentParser) -> None:
    """Add `calibrate`."""
    parser = commands.add_parser(
        "calibrate",
        parents=[common],
        help="cameras and projector from pictures of a board",
        description="Calibrates both cameras and the projector from a calibration capture and writes the rig file with "
        "its uncertainty, and a report beside it. Poses that do not fit are refused and named.",
    )
    parser.add_argument(
        "capture",
        type=Path,
        metavar="CAPTURE",
        help="capture folder or its calibration.json; pictures; points",
    )
    cameras = parser.add_argument_group("pictures of other programs")
    cameras.add_argument(
        "--pictures", metavar="PATTERN", help="of the board: '{camera}_{frame}.jpg'; with a code, '{pose}/{frame}.png'"
    )
    cameras.add_argument("--board", metavar="BOARD", help="such as chessboard:9x6:25 (inner corners, mm)")
    cameras.add_argument("--left", metavar="NAME", help="what {camera} is of the left camera")
    cameras.add_argument("--projector", metavar="WxH", help="a projector of this size showed a code along both axes")
    cameras.add_argument("--sequence", nargs="+", default=(), help="what {frame} runs through: x y white black skip:N")
    cameras.add_argument("--points", action="store_true", help="CAPTURE is a list of points: CSV, JSON, MAT or NPZ")
    cameras.add_argument("--size", metavar="WxH", help="of the images that the points were found in")
    add_code_options(parser, both_axes=True)
    parser.add_argument("--out", type=Path, required=True, metavar="RIG", help="rig file to write (JSON)")
    parser.add_argument("--report", type=Path, metavar="FILE", help="HTML; by default beside the rig file")
    parser.add_argument("--id", metavar="ID", help="the rig's id; by default the capture's, or one made of its date")
    parser.add_argument(
        "--server", action="store_true", help="run as a Prefect flow, starting a server where none is set up"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Calibrate and say how well."""
    from flows.calibrate import calibrate_capture
    from flows.prefect_server import runs_on_server
    from flows.progress import progress_bar

    if options.pictures and options.projector:
        return _with_code(options)
    if options.pictures or options.points:
        return _cameras(options)
    report = options.report or options.out.with_suffix(".html")
    if runs_on_server(options.server):
        from flows.prefect_flows import calibrate_flow

        result = calibrate_flow(str(options.capture), str(options.out), str(report), options.id)
    else:
        with progress_bar(counted=False) as progress:
            bar = progress.add_task("reading", total=1.0)
            result = calibrate_capture(
                options.capture,
                options.out,
                report,
                options.id,
                on_step=lambda done, text: progress.update(bar, completed=done, description=text),
            )
    return _say(result, options.out, report)


def _with_code(options: argparse.Namespace) -> int:
    """Calibrate one camera or two and the projector from pictures in which it showed a code on the board."""
    from flows.calibrate import calibrate_loaded
    from flows.commands.rig import parse_size
    from flows.progress import progress_bar
    from storage.board_pictures import parse_board
    from storage.capture_names import named_capture

    size, board, shown = parse_size(options.projector), parse_board(options.board), both_fringe_models(options)
    capture, notes = named_capture(
        options.capture, options.pictures, board, size, shown, options.sequence, options.left
    )
    report = options.report or options.out.with_suffix(".html")
    with progress_bar(counted=False) as progress:
        bar = progress.add_task("reading", total=1.0)
        result = calibrate_loaded(
            capture,
            options.out,
            report,
            options.id,
            on_step=lambda done, text: progress.update(bar, completed=done, description=text),
        )
    return _say(result, options.out, report, notes)


def _cameras(options: argparse.Namespace) -> int:
    """Calibrate the cameras alone and say how well."""
    from flows.calibrate_cameras import calibrate_pictures, calibrate_points
    from flows.commands.rig import parse_size
    from metrology.errors import UsageError
    from storage.board_pictures import parse_board

    notes: list[str] = []
    if options.points:
        if not options.size:
            raise UsageError("--points: found no --size, expected the images' width and height such as 1624x1234")
        result = calibrate_points(options.capture, parse_size(options.size), options.out, options.id)
    else:
        board = parse_board(options.board)
        result, notes = calibrate_pictures(
            options.capture, options.pictures, board, options.left, options.out, options.id
        )
    return _say(result, options.out, options.out.with_suffix(".html"), [f"note: {note}" for note in notes])


def _say(result: Calibrated, out: Path, report: Path, notes: Sequence[str] = ()) -> int:
    for line in [*describe(result), *(f"  {note}" for note in notes), f"rig: {out}", f"report: {report}"]:
        print(line)
    return 0


def describe(result: Calibrated) -> list[str]:
    """The calibration in a few lines."""
    calibration = result.calibration
    used = [use for use in calibration.poses if use.used]
    rms = ", ".join(f"{name} {value:.4f} px" for name, value in calibration.rms_px.items())
    lines = [
        f"{result.rig.id}: {len(used)} of {len(calibration.poses)} poses, "
        f"{sum(use.features for use in used)} features, {sum(use.outliers for use in used)} outliers",
        f"  reprojection RMS: {rms}",
    ]
    if calibration.board_layout is not None:
        lines.append(f"  ChArUco board: {calibration.board_layout} layout (OpenCV changed it in 4.6)")
    if calibration.field is not None:
        field = calibration.field
        lines.append(
            f"  uncertainty (95 %) at {field.distance_mm:.0f} mm, at most: depth {field.depth_u95_mm.max():.4f} mm, "
            f"height {field.height_u95_mm.max():.5f} mm, overlay {field.overlay_u95_mm.max():.4f} mm"
        )
    return lines + [f"  warning: {warning}" for warning in calibration.warnings]
