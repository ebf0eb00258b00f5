"""The projector's code on the command line: what `patterns` writes and `scene new` reads."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from metrology.fringe import FringeCode
    from storage.scene import FringeModel


def add_code_options(parser: argparse.ArgumentParser) -> None:
    """What a code may have beside axis, steps and counts."""
    group = parser.add_argument_group("code", "what other programs show differently")
    group.add_argument("--periods", type=int, nargs="+", metavar="PX", help="periods in projector pixels, not counts")
    group.add_argument("--over", type=int, metavar="PX", help="projector pixels that the counts are counted over")
    group.add_argument(
        "--direction", type=int, choices=(1, -1), default=1, help="-1: the phase falls from step to step"
    )
    group.add_argument("--offset", type=float, nargs="+", default=[0.0], metavar="RAD", help="phase at the border")
    group.add_argument("--gray", type=int, metavar="STRIPES", help="Gray code of so many stripes after the fringes")
    group.add_argument("--inverse", action="store_true", help="each Gray-code frame is followed by its inverse")
    group.add_argument("--references", action="store_true", help="an all-white and an all-black frame come last")
    group.add_argument("--lsb", action="store_true", help="Gray code begins with the finest stripes")
    group.add_argument(
        "--shift", type=float, default=0.0, metavar="STRIPES", help="by which the stripes' borders lie later"
    )


def fringe_model(options: argparse.Namespace) -> FringeModel:
    """The code as scene.json has it; SceneError where it contradicts itself."""
    from pathlib import Path

    from metrology.errors import UsageError
    from storage.models import validate
    from storage.scene import FringeModel

    counts = () if options.periods else tuple(options.counts)
    columns = counts or options.periods or ()
    document: dict[str, object] = {"axis": options.axis, "counts": counts, "direction": options.direction}
    document["steps"] = options.steps[0] if len(options.steps) == 1 else tuple(options.steps)
    document["periods_px"] = tuple(options.periods or ())
    if options.over:
        document["size_px"] = options.over
    if any(options.offset):
        document["phase_offset_rad"] = options.offset[0] if len(options.offset) == 1 else tuple(options.offset)
    if options.gray:
        document["gray"] = {
            "stripes": options.gray,
            "inverse": options.inverse,
            "references": options.references,
            "first": "lsb" if options.lsb else "msb",
            "shift": options.shift,
        }
    elif options.inverse or options.references or options.lsb or options.shift:
        raise UsageError("found --inverse, --references, --lsb or --shift, expected them with --gray STRIPES")
    if not columns:
        document.pop("steps")
    model = validate(FringeModel, document, Path("code"), UsageError)
    model.code  # noqa: B018 - refuses what no projector can show
    return model


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
