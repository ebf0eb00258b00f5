"""The projector's code on the command line: what `patterns` writes and `scene new` reads."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from metrology.fringe import Axis, FringeCode
    from storage.scene_models import FringeModel


def add_code_options(parser: argparse.ArgumentParser, both_axes: bool = False) -> None:
    """Steps and counts of a code, and what else it may have; for codes along both axes some take two numbers."""
    group = parser.add_argument_group("code", "what the projector showed")
    group.add_argument("--steps", type=int, nargs="+", default=(4,), help="phase steps, or one number per count")
    counts, across = ((), "none") if both_axes else ((70, 64, 59), "70 64 59")
    group.add_argument("--counts", type=_count, nargs="*", default=counts, help=f"fringes across (default {across})")
    if both_axes:
        group.add_argument("--counts-y", type=int, nargs="*", help="those along y, where they are others")
    group.add_argument("--periods", type=int, nargs="+", metavar="PX", help="periods in projector pixels, not counts")
    group.add_argument("--over", type=int, metavar="PX", help="projector pixels that counts and stripes are over")
    group.add_argument(
        "--direction", type=int, choices=(1, -1), default=1, help="-1: the phase falls from step to step"
    )
    group.add_argument("--offset", type=float, nargs="+", default=[0.0], metavar="RAD", help="phase at the border")
    stripes = "Gray code of so many stripes after the fringes"
    if both_axes:
        group.add_argument("--gray", type=int, nargs=2, metavar=("X", "Y"), help=f"{stripes}, along x and y")
    else:
        group.add_argument("--gray", type=int, metavar="STRIPES", help=stripes)
    group.add_argument("--inverse", action="store_true", help="each Gray-code frame is followed by its inverse")
    group.add_argument("--inverse-first", action="store_true", help="each inverse comes before its frame")
    group.add_argument("--references", action="store_true", help="an all-white and an all-black frame come last")
    group.add_argument("--lsb", action="store_true", help="Gray code begins with the finest stripes")
    group.add_argument("--binary", action="store_true", help="the stripes' bits count in plain binary, not Gray code")
    group.add_argument(
        "--shift", type=float, default=0.0, metavar="STRIPES", help="by which the stripes' borders lie later"
    )


def _count(text: str) -> int:
    """A number of fringes; what `scene guess` left open is named."""
    if not text.isdigit():
        left_open = ", which scene guess left open" if text.startswith("COUNT") else ""
        raise argparse.ArgumentTypeError(f"found {text!r}{left_open}, expected how many fringes the projector showed")
    return int(text)


def fringe_model(options: argparse.Namespace) -> FringeModel:
    """The code as scene.json has it; SceneError where it contradicts itself."""
    from pathlib import Path

    from metrology.errors import UsageError
    from storage.models import validate
    from storage.scene_models import FringeModel

    periods = tuple(options.periods or ())
    if periods and (options.over or len(periods) == 1):
        options.counts, periods = _counts_of(periods, options.over), ()
    counts = () if periods else tuple(options.counts)
    columns = counts or periods
    document: dict[str, object] = {"axis": options.axis, "counts": counts, "direction": options.direction}
    document["steps"] = options.steps[0] if len(options.steps) == 1 else tuple(options.steps)
    document["periods_px"] = periods
    if options.over:
        document["size_px"] = options.over
    if any(options.offset):
        document["phase_offset_rad"] = options.offset[0] if len(options.offset) == 1 else tuple(options.offset)
    if options.gray:
        document["gray"] = {
            "stripes": options.gray,
            "inverse": options.inverse or options.inverse_first,
            "inverse_first": options.inverse_first,
            "references": options.references,
            "first": "lsb" if options.lsb else "msb",
            "binary": options.binary,
            "shift": options.shift,
        }
    elif any((options.inverse, options.inverse_first, options.references, options.lsb, options.binary, options.shift)):
        names = "--inverse, --inverse-first, --references, --lsb, --binary or --shift"
        raise UsageError(f"found {names}, expected them with --gray")
    if not columns:
        document.pop("steps")
    model = validate(FringeModel, document, Path("code"), UsageError)
    model.code  # noqa: B018 - refuses what no projector can show
    return model


def _counts_of(periods: tuple[int, ...], over: int | None) -> tuple[int, ...]:
    """Fringes over so many projector pixels; UsageError where that is no whole number of them."""
    from metrology.errors import UsageError

    if not over or min(periods) < 1 or any(over % period for period in periods):
        raise UsageError(
            f"--periods {' '.join(map(str, periods))}: found --over {over or 'nowhere'}, expected a multiple of the "
            "periods not below the projector's width (height), which fringes and stripes are counted over: "
            "18 px on 1024: --periods 18 --over 1026 --gray 114 (stripes of 9 px)"
        )
    return tuple(over // period for period in periods)


def both_fringe_models(options: argparse.Namespace) -> dict[Axis, FringeModel]:
    """The codes along both axes as calibration.json has them."""
    stripes = options.gray or (None, None)
    own = {
        "x": {"axis": "x", "gray": stripes[0]},
        "y": {
            "axis": "y",
            "gray": stripes[1],
            "counts": options.counts if options.counts_y is None else options.counts_y,
        },
    }
    return {axis: fringe_model(argparse.Namespace(**vars(options) | said)) for axis, said in own.items()}  # type: ignore[misc]


def frame_names(code: FringeCode) -> list[str]:
    """Names of the frames in Flushline's order."""
    names = [
        f"{code.axis}_count{code.counts[k]:03d}_step{step + 1}"
        for k, step in zip(code.count_of, code.step_of, strict=True)
    ]
    if code.gray:
        bits = range(code.gray.bits)
        signs = ("", "_inverse") if code.gray.inverse else ("",)
        names += [f"{code.axis}_gray{bit}{sign}" for bit in bits for sign in signs]
        names += ["gray_white", "gray_black"] if code.gray.references else []
    return names
