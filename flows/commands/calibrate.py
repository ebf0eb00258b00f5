"""flushline calibrate: cameras and projector from pictures of a board."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

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
    parser.add_argument("capture", type=Path, metavar="CAPTURE", help="capture folder, or its calibration.json")
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
    for line in describe(result):
        print(line)
    print(f"rig: {options.out}")
    print(f"report: {report}")
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
