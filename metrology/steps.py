"""The steps of an inspection, declared once in their order: what is timed, said and retried follows from here.

Functions are named "module:function" and loaded where they are run. docs/flows.md says how to add a step.
"""

from __future__ import annotations

from dataclasses import dataclass

from metrology.kinds import KINDS


@dataclass(frozen=True)
class Step:
    """A step."""

    name: str
    """Its wall time is `seconds_NAME` in the table `scenes`, and in the manifest."""
    function: str
    progress: str
    """What the command line says while it runs."""
    tags: tuple[str, ...] = ("metrology",)
    """"io" reads or writes files, so it is tried again where a disk or a network failed; "metrology" computes; "store"
    publishes."""
    kept: bool = True
    """Whether its time has a column. That of publishing cannot be in what is published."""


STEPS = (
    Step("load", "tasks.steps:load", "checking", ("io",)),
    Step("reconstruct", "tasks.steps:reconstruct_scene", "reconstructing", ("io", "metrology")),
    Step("detect_rivets", "tasks.steps:detect_rivets", "finding rivets"),
    Step("check_rig", "tasks.steps:check_rig", "checking the rig"),
    Step("detect_seams", "tasks.steps:detect_seams", "finding seams"),
    Step("measure_rivets", "tasks.steps:measure_rivets", "measuring rivets"),
    Step("measure_seams", "tasks.steps:measure_seams", "measuring seams"),
    *(Step(f"measure_{kind.table}", kind.measure, f"measuring {kind.many}") for kind in KINDS if kind.measure),
    Step("register", "tasks.steps:register", "recognising the panel", ("io", "metrology")),
    Step("judge", "tasks.steps:judge", "judging"),
    Step("overlay", "tasks.steps:draw_overlay", "drawing the overlay"),
    Step("publish", "tasks.steps:publish", "storing", ("io", "store"), kept=False),
)
"""In the order in which they begin."""

TIMED = tuple(step.name for step in STEPS if step.kept)
"""Names of the steps whose time has a column."""
PROGRESS = {step.name: step.progress for step in STEPS}
